"""Light that is solved fast, a room of such light, and small views."""

import pytest

import stub_rooms
from fixture_rooms import lit_room
from roomlight_generator.sequences import render
from roomlight_generator.sequences.walk import phone_intrinsics
from roomlight_generator.transport import patches


@pytest.fixture(scope="module")
def few_rays():
    """Light solved with few rays."""
    with pytest.MonkeyPatch.context() as patch:
        for name, rays in (("GATHER_RAYS", 4), ("FIRST_RAYS", 4), ("SEED_RAYS", 2048)):
            patch.setattr(patches, name, rays)
        yield


@pytest.fixture(scope="module")
def coarse_room(few_rays):
    """A room whose light is solved with few rays."""
    del few_rays
    return lit_room(1)


@pytest.fixture
def no_workers():
    """Datasets are made in this process."""
    with stub_rooms.without_workers():
        yield


@pytest.fixture
def small_views(monkeypatch):
    """Frames of 64 x 48 pixels and panoramas of 16 rows."""
    monkeypatch.setattr(render, "PROBE_HEIGHT", 16)
    monkeypatch.setattr(render, "phone_intrinsics", lambda rng: phone_intrinsics(rng, 64, 48))
