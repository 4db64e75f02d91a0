"""Structured logs: one line of JSON per record, also for what native libraries write to standard error."""

import json
import logging
import os
import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final

from roomlight_server.base.request_context import request_id

_STANDARD: Final = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "color_message", "taskName"}
_native = logging.getLogger("roomlight.native")


class JsonLines(logging.Formatter):
    """Formats a record as one line of JSON: time, level, event, id of the request, and the fields passed as `extra`."""

    def format(self, record: logging.LogRecord) -> str:
        """Return one line; JSON escapes line breaks."""
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        line: dict[str, object] = {
            "time": f"{stamp}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "event": record.getMessage(),
        }
        if request_id.get():
            line["request"] = request_id.get()
        line |= {key: value for key, value in record.__dict__.items() if key not in _STANDARD}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def configure_logging(level: str) -> None:
    """Send all logs to standard error, formatted by `JsonLines`.

    The level `debug` concerns RoomLight alone: at this level the WebSocket library logs all headers, tokens included.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    own_level = logging.getLevelNamesMapping()[level.upper()]
    logging.basicConfig(handlers=[handler], level=max(own_level, logging.INFO), force=True)
    logging.getLogger("roomlight").setLevel(own_level)


@contextmanager
def native_lines_logged() -> Generator[None]:
    """Log each line that C code (libjpeg, libpng, OpenCV) writes to file descriptor 2, at debug, inside the context.

    `sys.stderr` continues to write to the previous standard error. Call `configure_logging` inside the context.
    """
    sys.stderr.flush()
    stderr, previous = sys.stderr, os.dup(2)
    reading, writing = os.pipe()
    os.dup2(writing, 2)
    os.close(writing)
    sys.stderr = os.fdopen(previous, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False)
    reader = threading.Thread(target=_log_lines, args=(reading,), name="native-log", daemon=True)
    reader.start()
    try:
        yield
    finally:
        sys.stderr.flush()
        sys.stderr = stderr
        os.dup2(previous, 2)  # closes the last writing end of the pipe, so that the reader ends
        reader.join(timeout=5)  # a child process may still hold the writing end


def _log_lines(descriptor: int) -> None:
    with os.fdopen(descriptor, encoding="utf-8", errors="backslashreplace") as lines:
        for line in lines:
            _native.debug("%s", line.rstrip()[:1000])
