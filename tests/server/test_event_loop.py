"""What keeps the event loop free: no request waits for a thread of the framework, and large answers are not joined."""

import asyncio
import gc
import inspect
import pkgutil
import sys
import threading
from importlib import import_module
from unittest.mock import AsyncMock

from fastapi.routing import APIRoute

from roomlight_server import routes
from roomlight_server.answers.parts_response import PartsResponse
from roomlight_server.app import create_app
from roomlight_server.base.settings import ServerSettings
from roomlight_server.transport.watchdog import frame_of


def calls_of(dependant):
    """Return the functions that the framework calls for a request, of an endpoint and its dependencies."""
    return [dependant.call, *(call for each in dependant.dependencies for call in calls_of(each))]


def api_routes():
    """Return the routes of the server: its routers', and the application's own."""
    modules = [import_module(f"{routes.__name__}.{each.name}") for each in pkgutil.iter_modules(routes.__path__)]
    routers = [create_app(ServerSettings()), *(module.router for module in modules if hasattr(module, "router"))]
    found = [route for router in routers for route in router.routes]
    return [route for route in found if isinstance(route, APIRoute)]


def test_no_request_waits_for_a_thread_of_the_framework():
    """Two dependencies that were not async took each request to a thread pool and back, twice."""
    paths = {route.path for route in api_routes()}
    assert {"/v1/sessions/{session_id}/frames/{index}", "/v1/sessions/{session_id}/probes", "/readyz"} <= paths
    for route in api_routes():
        for call in calls_of(route.dependant):
            assert inspect.iscoroutinefunction(call) or inspect.isasyncgenfunction(call), (route.path, call)


def test_parts_of_an_answer_are_sent_without_joining_them():
    parts, send = [b"head", bytes(2**20), b"tail"], AsyncMock()
    response = PartsResponse(parts, "application/x-test")
    asyncio.run(response({"type": "http"}, AsyncMock(), send))
    begin, *bodies = [call.args[0] for call in send.await_args_list]
    headers = dict(begin["headers"])
    assert (begin["status"], headers[b"content-type"]) == (200, b"application/x-test")
    assert headers[b"content-length"] == str(sum(map(len, parts))).encode()
    assert all(body["body"] is part for body, part in zip(bodies, parts, strict=False))
    assert [(body["more_body"], len(body["body"])) for body in bodies[len(parts) :]] == [(False, 0)]


def test_no_garbage_is_collected_while_the_interpreter_lists_its_threads():
    """Python 3.11 stopped for good there, when the event loop was late: python/cpython#106883."""
    own, phases, before = inspect.unwrap(frame_of).__code__, [], gc.get_threshold()

    def collected(phase, _):
        if sys._getframe(1).f_code is own:
            phases.append(phase)

    gc.callbacks.append(collected)
    gc.set_threshold(1)
    try:
        frame = frame_of(threading.get_ident())
    finally:
        gc.set_threshold(*before)
        gc.callbacks.remove(collected)
    assert frame is not None
    assert gc.isenabled()
    assert not phases
