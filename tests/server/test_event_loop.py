"""What keeps the event loop free: no request waits for a thread of the framework, and large answers are not joined."""

import asyncio
import inspect
import pkgutil
from importlib import import_module

from fastapi.routing import APIRoute

from roomlight_server import routes
from roomlight_server.answers.parts_response import PartsResponse
from roomlight_server.app import create_app
from roomlight_server.base.settings import ServerSettings


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
    parts, sent = [b"head", bytes(2**20), b"tail"], []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.disconnect"}

    response = PartsResponse(parts, "application/x-test")
    asyncio.run(response({"type": "http"}, receive, send))
    begin, *bodies = sent
    headers = dict(begin["headers"])
    assert (begin["status"], headers[b"content-type"]) == (200, b"application/x-test")
    assert headers[b"content-length"] == str(sum(map(len, parts))).encode()
    assert all(body["body"] is part for body, part in zip(bodies, parts, strict=False))
    assert [(body["more_body"], len(body["body"])) for body in bodies[len(parts) :]] == [(False, 0)]
