"""A server for the modules that need no settings of their own, and a session on it."""

import pytest

from http_servers import RunningServer


@pytest.fixture(scope="module")
def server():
    with RunningServer() as running:
        yield running


@pytest.fixture(scope="module")
def room(server):
    """The session `room`, for modules whose tests share one."""
    server.open()
