"""Poll a server's /healthz from a separate process, so that the benchmark's own work does not delay the responses.

`python -m roomlight_bench.server.server_health PORT` polls until its standard input ends, then writes the latencies as
a JSON list of milliseconds.
"""

import http.client
import json
import sys
import threading
import time
from typing import Final

INTERVAL_S: Final = 0.02
"""Pause between a response and the next request: up to 50 requests per second, so that short blocks are noticed."""


def poll(port: int, ended: threading.Event) -> list[float]:
    """Return the latency of each response in milliseconds until `ended` is set, at least one.

    Raises:
        OSError: The server does not respond.
    """
    latencies_ms: list[float] = []
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        while True:
            start_s = time.perf_counter()
            connection.request("GET", "/healthz")
            connection.getresponse().read()
            latencies_ms.append(1e3 * (time.perf_counter() - start_s))
            if ended.wait(INTERVAL_S):
                return latencies_ms
    finally:
        connection.close()


def main() -> None:
    """Poll the port given as the first argument; see the module."""
    ended = threading.Event()

    def wait_for_end_of_input() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait_for_end_of_input, daemon=True).start()
    json.dump([round(value, 3) for value in poll(int(sys.argv[1]), ended)], sys.stdout)


if __name__ == "__main__":
    main()
