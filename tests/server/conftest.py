"""A server for the modules that need no settings of their own."""

import pytest

from http_servers import RunningServer


@pytest.fixture(scope="module")
def server():
    with RunningServer() as running:
        yield running
