"""What the tests of replays share."""

import pytest


class NoPictures:
    """Film and sheet are compared in one test; elsewhere their spheres would take most of the time."""

    def __init__(self, *_, **__):
        pass

    def add(self, *_):
        pass

    def close(self):
        pass

    def abandon(self, _):
        pass


@pytest.fixture
def no_pictures(monkeypatch):
    monkeypatch.setattr("roomlight_cli.replay.ReplayPictures", NoPictures)
