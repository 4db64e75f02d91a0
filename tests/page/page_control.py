"""A server for the tests of the page in Chromium, and a control server through which the browser's tests drive it."""

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qsl, urlsplit

from http_servers import RunningServer, frame

OPTIONS = {"model": "classical", "height": 48, "reference_exposure": 1.0}


class PageServer:
    """A server that can be started again on its port, with frames of a box room for its sessions.

    Commands are POST requests to `control_url`: `/push?session=NAME&count=N` opens the session where there is none and
    sends its next frames, `/stop` and `/start` the server, `/expire` makes all sessions idle for a day,
    `/state?session=NAME` returns the state of a session, `/scene?session=NAME` its scene, `/clear?session=NAME` removes
    the objects that are kept with it. The server's clock goes `pace` times as fast as ours, and so do recordings.
    """

    def __init__(self, *, pace=1, **settings):
        self._settings = settings
        self._pace, self._passed_s = pace, 0.0
        self._token = (settings.get("tokens") or (None,))[0]
        self._running: RunningServer | None = RunningServer(clock=self._clock, **settings)
        self._control = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())

    def _clock(self):
        return self._pace * time.monotonic() + self._passed_s

    @property
    def running(self):
        assert self._running is not None, "the server is stopped"
        return self._running

    def __enter__(self):
        self.running.__enter__()
        self._settings["port"] = self.running.port
        threading.Thread(target=self._control.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_):
        self._control.shutdown()
        self._control.server_close()
        self.stop()

    @property
    def url(self):
        return f"http://127.0.0.1:{self._settings['port']}"

    @property
    def control_url(self):
        return f"http://127.0.0.1:{self._control.server_address[1]}"

    def push(self, session="room", count="1"):
        last = self.running.open(session, OPTIONS, token=self._token).json["frames"]["last_index"]
        first = 0 if last is None else last + 1
        for index in range(first, first + int(count)):
            answer = self.running.push(index, frame(15 * index), session, token=self._token)
            assert answer.status == 200, answer

    def stop(self):
        if self._running is not None:
            self._running.stop()
        self._running = None

    def start(self):
        self._running = RunningServer(clock=self._clock, **self._settings)
        self._running.__enter__()

    def expire(self):
        self._passed_s += 86_400

    def state(self, session="room"):
        return self.running.state(session, token=self._token)

    def scene(self, session="room"):
        return self.running.call("GET", f"/v1/sessions/{session}/scene", token=self._token).json

    def clear(self, session="room"):
        assert self.running.call("PUT", f"/v1/sessions/{session}/scene", {}, token=self._token).status == 200

    def _handler(self):
        page_server = self
        commands = ("push", "stop", "start", "expire", "state", "scene", "clear")

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                address = urlsplit(self.path)
                name = address.path.strip("/")
                assert name in commands, name
                body = json.dumps(getattr(page_server, name)(**dict(parse_qsl(address.query)))).encode()
                self.send_response(200)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format, *args):
                del format, args

        return Handler
