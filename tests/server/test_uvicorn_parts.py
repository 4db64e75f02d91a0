"""The parts of uvicorn that `roomlight_server.transport` extends although they are not public."""

import inspect
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import Server

from roomlight_server.serving import GracefulServer
from roomlight_server.transport.http_protocol import HttpProtocol
from roomlight_server.transport.stream_protocol import StreamProtocol

ADDED = {"handshake"}
PARTS = {
    HttpToolsProtocol: (
        *("self.pipeline.appendleft", "self.pipeline.pop()", "self.flow.resume_reading()", "self.flow.pause_reading()"),
        *("self.cycle.more_body = False", "self._start_asgi_task(", "self.app_state.copy()", "set_protocol(protocol)"),
        *("self.send_400_response(msg)", "self.url += url"),
    ),
    RequestResponseCycle: (
        "self.flow.resume_reading()",
        "self.on_response()",
        "self.more_body",
        "response_complete",
        "self.response_started",
        "self.disconnected",
    ),
    FlowControl: ("def resume_reading(self)", "self._transport.resume_reading()"),
    WebSocketsSansIOProtocol: (
        *("self.queue: asyncio.Queue", "self.read_paused", "self.frames: list[bytes]", "self.curr_msg_data_type"),
        *("self.conn.receive_data(data)", "def handle_parser_exception", "self.close_sent", "self.handshake_complete"),
    ),
    Server: ("self.servers", "self.lifespan.state", "self._captured_signals", "server.wait_closed()"),
}


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(HttpProtocol, HttpToolsProtocol), (StreamProtocol, WebSocketsSansIOProtocol), (GracefulServer, Server)],
)
def test_methods_that_are_extended_exist(ours, theirs):
    extended = {name for name, value in vars(ours).items() if inspect.isfunction(value) and not name.startswith("_")}
    missing = sorted(name for name in extended - ADDED if not hasattr(theirs, name))
    assert not missing, f"uvicorn {version('uvicorn')} no longer calls these methods of {theirs.__name__}: {missing}"


@pytest.mark.parametrize("theirs", PARTS, ids=lambda each: each.__name__)
def test_parts_that_are_used_exist(theirs):
    source = inspect.getsource(theirs)
    missing = [part for part in PARTS[theirs] if part not in source]
    assert not missing, f"uvicorn {version('uvicorn')}: {theirs.__name__} has changed: {missing}"


def test_the_versions_of_uvicorn_are_bounded_on_both_sides():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))["project"]
    bound = next(Requirement(text) for text in project["dependencies"] if text.startswith("uvicorn"))
    assert {each.operator for each in bound.specifier} == {">=", "<"}, "an untested minor version may have moved parts"
    assert version("uvicorn") in bound.specifier
