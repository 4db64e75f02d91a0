"""`roomlight bench server` on a few small frames: the report is complete and consistent. Speed is not tested."""

import asyncio
import json
from contextlib import ExitStack
from dataclasses import replace
from http.client import HTTPConnection

import pytest
from typer.testing import CliRunner

from roomlight.captures import CaptureOptions, open_capture
from roomlight.errors import ModelError, ServerError
from roomlight.sample import sample_capture
from roomlight.wire.frame_encoding import pack_frame
from roomlight_bench.server.server import ServerBenchOptions, run_server_bench
from roomlight_bench.server.server_load import Load, Phones
from roomlight_bench.server.server_process import ServerProcess, polling_health
from roomlight_bench.server.server_report import Latencies, ServerReport
from roomlight_cli.main import app
from roomlight_client import AsyncClient, ConflictError
from roomlight_client.errors import refusal

TINY = ServerBenchOptions(sessions=(2,), seconds=1.0, fps=4.0, frames=4, model="classical", height=16, passes=1)


@pytest.fixture(scope="module")
def progress() -> list[str]:
    return []


@pytest.fixture(scope="module")
def report(progress: list[str]) -> ServerReport:
    return run_server_bench(TINY, progress=progress.append)


def ordered(latencies: Latencies) -> bool:
    values = [latencies.p50_ms, latencies.p95_ms, latencies.p99_ms, latencies.most_ms]
    known = [value for value in values if value is not None]
    return len(known) == 4 and known[0] > 0 and known == sorted(known)


@pytest.mark.slow
def test_every_row_is_complete_and_consistent(report, progress):
    assert report.model == "classical"
    assert len(report.start_ready_ms) == 1 + len(TINY.sessions)
    for alive_ms, ready_ms in zip(report.start_alive_ms, report.start_ready_ms, strict=True):
        assert 0 < alive_ms <= ready_ms
    assert [row.colour for row in report.overhead] == ["jpeg", "exact"]
    for row in report.overhead:
        assert 0 < row.engine_ms <= row.decoded_ms
        assert row.share == pytest.approx(row.http_ms / row.decoded_ms - 1)
        assert row.share <= row.share_of_engine
    assert [row.sessions for row in report.load] == [2]
    for row in report.load:
        assert row.wanted_fps == 4
        assert 0 <= row.held_fps <= 4
        assert 0 <= row.lost <= 1
        due = round(TINY.seconds * TINY.fps) * row.sessions
        assert row.frame.count == due - round(row.lost * due) > 0
        assert ordered(row.frame)
        assert ordered(row.light)
        assert ordered(row.health)
        assert row.stated_mb > 5  # at least one keyframe each
        assert row.keyframes >= 1
    assert any("2 sessions" in text for text in progress)
    values = json.loads(json.dumps(report.to_json()))
    assert values["load"][0]["frame"]["p99_ms"] == report.load[0].frame.p99_ms
    assert len(values["criteria"]) == 2 + len(TINY.sessions)


@pytest.mark.slow
def test_criteria_are_judged_by_their_limits(report):
    slow = replace(report.overhead[0], engine_ms=10.0, decoded_ms=10.0, http_ms=10.6)
    stuck = replace(report.load[0], health=Latencies.of([1.0, 60.0, 60.0]))
    judged = replace(report, overhead=(slow, replace(slow, http_ms=10.4)), load=(stuck,)).criteria
    assert [criterion.holds for criterion in judged] == [False, True, False]


@pytest.fixture(scope="module")
def server():
    """A server for 64 phones."""
    with replace(TINY, sessions=(64,)).server() as running:
        yield running


@pytest.mark.slow
def test_the_server_takes_the_connections_of_all_phones(server):
    """Two each and those that are opened anew; 64 phones were refused at 128 connections of this address."""
    with ExitStack() as opened:
        for _ in range(3 * 64):
            connection = HTTPConnection("127.0.0.1", server.port)
            opened.callback(connection.close)
            connection.request("GET", "/healthz")
            assert connection.getresponse().status == 200


def test_percentiles_of_nothing_are_none():
    assert Latencies.of([]) == Latencies(0, None, None, None, None)
    assert Latencies.of([3.0]) == Latencies(1, 3.0, 3.0, 3.0, 3.0)


@pytest.mark.slow
def test_a_server_that_cannot_start_is_an_error_with_its_log(untrained_video):
    with pytest.raises(ServerError, match="--max-sessions"), ServerProcess(["--max-sessions", "-1"]):
        pass
    with pytest.raises(ModelError, match="never trained"):
        run_server_bench(replace(TINY, model="video", weights=untrained_video))


@pytest.mark.slow
def test_health_is_polled_from_another_process(server):
    resident = server.resident_bytes()
    assert resident is None or resident > 20e6
    with polling_health(server.port) as end:
        assert min(end()) > 0
    with pytest.raises(ServerError, match="healthz"), polling_health(1) as end:
        end()


@pytest.mark.parametrize("counts", ["", "0", "1,x", "1001"])
def test_numbers_of_sessions_are_checked(counts):
    result = CliRunner().invoke(app, ["bench", "server", "--sessions", counts])
    assert result.exit_code == 2
    assert "--sessions" in result.output


@pytest.mark.slow
def test_refused_frames_are_lost_and_other_errors_raised(server, monkeypatch):
    """A newer frame may overtake an older one on another connection; the server then refuses the older index."""
    answers = {1: ("frame-conflict", 409), 2: ("session-full", 429)}
    run = AsyncClient.run

    async def answered(self, call, *, retry=None):
        kind, status = answers.get(int(call.path.rpartition("/")[2]), ("", 0)) if "/frames/" in call.path else ("", 0)
        if kind:
            raise refusal(status, json.dumps({"type": f"urn:roomlight:problem:{kind}", "status": status}).encode())
        return await run(self, call, retry=retry)

    monkeypatch.setattr(AsyncClient, "run", answered)
    bodies = [
        pack_frame(frame, colour="jpeg") for frame in open_capture(sample_capture(), CaptureOptions(max_frames=1))
    ]

    async def streamed(url, seconds):
        load = Load(1, seconds, 4.0, bodies, (0.0, 0.0, 0.0), "classical", 16)
        async with Phones(url, load) as phones:
            return await phones.stream()

    outcome = asyncio.run(streamed(server.url, 1.0))
    assert outcome.superseded >= 2
    assert outcome.sent == outcome.superseded + len(outcome.frame_ms)
    answers[1] = ("session-failed", 409)
    with pytest.raises(ConflictError, match="session-failed"):
        asyncio.run(streamed(server.url, 1.0))
