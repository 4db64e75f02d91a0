"""Ask a server for its health again and again, from a process of its own: nothing else here delays the answers.

`python -m roomlight_bench.server_health PORT` polls until its standard input ends, then writes the latencies, a JSON
list of milliseconds. It imports the standard library alone.
"""

import http.client
import json
import sys
import threading
import time
from typing import Final

INTERVAL_S: Final = 0.02
"""Between an answer and the next question: 50 a second, so that few blocked moments pass unseen."""


def poll(port: int, ended: threading.Event) -> list[float]:
    """Milliseconds of each answer until `ended`; one at least. Raises OSError where nobody answers."""
    latencies_ms: list[float] = []
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        while True:
            began_s = time.perf_counter()
            connection.request("GET", "/healthz")
            connection.getresponse().read()
            latencies_ms.append(1e3 * (time.perf_counter() - began_s))
            if ended.wait(INTERVAL_S):
                return latencies_ms
    finally:
        connection.close()


def main() -> None:
    """See the module."""
    ended = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    json.dump([round(value, 3) for value in poll(int(sys.argv[1]), ended)], sys.stdout)


if __name__ == "__main__":
    main()
