"""`roomlight bench hostile` on a few seconds: the report is complete and consistent. Speed is not tested."""

import asyncio
import gc
import json
import re
from contextlib import suppress

import pytest
from rich.console import Console
from typer.testing import CliRunner

from roomlight_bench.server import hostile
from roomlight_bench.server.hostile import HostileOptions, run_hostile
from roomlight_bench.server.hostile_client import ATTACKS, FLOODS, Hostile
from roomlight_bench.server.hostile_report import AttackRow, HostileReport
from roomlight_bench.server.server_process import ServerProcess
from roomlight_bench.server.server_report import Latencies
from roomlight_cli.main import app

TOKEN = "a-hostile-token-of-thirty-two-characters"


def row(attack, processed, *, p99_ms=300.0, rss=10**9, after=10**9):
    latencies = Latencies(processed, 100.0, 200.0, p99_ms, p99_ms)
    return AttackRow(attack, 10.0, 20, processed, latencies, latencies, rss, 10**9, after, 7, {"200": 3, "429": 4})


def report_of(*attacks, alone=20, churn=()):
    return HostileReport(row("alone", alone), attacks, churn, 5 * 10**8, 2 * 10**9, 2.0, {"processor": "x"}, 2, 1.5)


def holding(report):
    return [criterion.holds for criterion in report.criteria]


def test_each_criterion_can_fail():
    assert holding(report_of(row("a", 15))) == [False, True, True, True]
    assert holding(report_of(row("a", 20, p99_ms=1001.0))) == [True, True, False, True]
    assert holding(report_of(row("a", 20, rss=3 * 10**9))) == [True, True, True, False]
    assert holding(report_of(row("a", 20, after=2 * 10**9))) == [True, False, True, True]
    none = AttackRow("a", 10.0, 20, 0, Latencies.of([]), Latencies.of([]), 0, 0, 0, 0, {})
    assert holding(report_of(none)) == [False, True, False, True]


def test_the_slope_of_churn_is_judged():
    steady = report_of(row("a", 20), churn=tuple((60.0 * minute, 10**9 + minute % 2) for minute in range(10)))
    growing = report_of(row("a", 20), churn=tuple((60.0 * minute, 10**9 + 2 * 10**7 * minute) for minute in range(10)))
    assert (steady.slope, growing.slope) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.02))
    assert (holding(steady)[-1], holding(growing)[-1]) == (True, False)
    assert report_of(row("a", 20)).slope is None


def test_the_report_is_shown_and_written():
    report = report_of(row("a", 19))
    console = Console(width=160, record=True)
    console.print(*report.tables())
    shown = console.export_text()
    assert re.search(r"a\s+10\s+19 of 20\s+95%\s+100 / 300", shown)
    values = json.loads(json.dumps(report.to_json()))
    assert (values["attacks"][0]["kept"], len(values["criteria"])) == (0.95, 4)


def test_an_unknown_attack_is_named():
    result = CliRunner().invoke(app, ["bench", "hostile", "--attack", "poetry"])
    assert result.exit_code != 0
    assert "poetry" in result.output + str(result.exception)


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_an_attack_on_each_server_is_measured_beside_the_neighbour(monkeypatch):
    monkeypatch.setattr(hostile, "_SETTLE_S", 0.0)  # whether memory returns is judged by the benchmark, not here
    monkeypatch.setattr(hostile, "CHURN_S", 0.5)
    attacks = ("large-headers", "tls-handshakes")
    report = run_hostile(HostileOptions(0.2, 0.001, attacks, model="classical", height=16))
    assert tuple(result.attack for result in report.attacks) == attacks
    for result in (report.alone, *report.attacks):
        assert result.due > 0
        assert 0 <= result.processed <= result.due
        assert 0 < result.rss_bytes <= report.rss_bound_bytes
    assert report.alone.processed > 0
    assert all(result.requests > 0 for result in report.attacks)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")
def test_every_attack_reaches_the_server(tmp_path):
    """Until its first request, in this process and without TLS."""
    (tmp_path / "tokens").write_text(f"{TOKEN}\n")

    async def attack(port, name):
        client = Hostile(port, TOKEN, name)
        work = asyncio.ensure_future(ATTACKS[name](client))
        while not (client.requests or work.done()):
            await asyncio.sleep(0)
        work.cancel()
        with suppress(asyncio.CancelledError):
            await work
        await client.end()
        return client.requests

    with ServerProcess(["--token-file", str(tmp_path / "tokens"), "--model", "classical"]) as server:
        for name in ATTACKS:
            if name.removesuffix("-slow") not in FLOODS or name in FLOODS:
                assert asyncio.run(attack(server.port, name)) > 0, name
    gc.collect()  # connections that attacks left open, whose warnings are of this test
