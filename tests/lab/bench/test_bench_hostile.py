"""`roomlight bench hostile` on a few seconds: the report is complete and consistent. Speed is not tested."""

import json
import re

import pytest
from rich.console import Console
from typer.testing import CliRunner

from roomlight_bench.server.hostile import HostileOptions, run_hostile
from roomlight_bench.server.hostile_floods import FLOODS
from roomlight_bench.server.hostile_report import AttackRow, HostileReport
from roomlight_bench.server.server_report import Latencies
from roomlight_cli.main import app


def row(attack, processed, *, p99_ms=300.0, rss=10**9, after=10**9):
    latencies = Latencies(processed, 100.0, 200.0, p99_ms, p99_ms)
    return AttackRow(attack, 10.0, 20, processed, latencies, latencies, rss, 10**9, after, 7, {"200": 3, "429": 4})


def report_of(*attacks, alone=20):
    return HostileReport(row("alone", alone), attacks, 5 * 10**8, 2 * 10**9, 2.0, {"processor": "x"}, 2, 1.5)


def holding(report):
    return [criterion.holds for criterion in report.criteria]


def test_what_is_kept_is_relative_to_the_neighbour_alone():
    report = report_of(row("a", 8), alone=10)
    assert report.kept(report.attacks[0]) == pytest.approx(0.8)
    assert holding(report) == [True, True, True, True]


def test_each_criterion_can_fail():
    assert holding(report_of(row("a", 15))) == [False, True, True, True]
    assert holding(report_of(row("a", 20, p99_ms=1001.0))) == [True, True, False, True]
    assert holding(report_of(row("a", 20, rss=3 * 10**9))) == [True, True, True, False]
    assert holding(report_of(row("a", 20, after=2 * 10**9))) == [True, False, True, True]
    none = AttackRow("a", 10.0, 20, 0, Latencies.of([]), Latencies.of([]), 0, 0, 0, 0, {})
    assert holding(report_of(none)) == [False, True, False, True]


def test_the_report_is_shown_and_written():
    report = report_of(row("a", 19))
    console = Console(width=160, record=True)
    console.print(report.table())
    shown = console.export_text()
    assert re.search(r"a\s+10\s+19 of 20\s+95%\s+100 / 300", shown)
    values = json.loads(json.dumps(report.to_json()))
    assert (values["attacks"][0]["kept"], len(values["criteria"])) == (0.95, 4)


def test_the_table_of_the_documentation_is_written():
    lines = report_of(row("large-answers", 19), row("tall-probes", 15, rss=1_234_000_000)).markdown().splitlines()
    assert lines[2:6] == [
        "| none | 20 of 20 | 100 / 300 | 1,000 |",
        "| 40 posts of ten specular maps of 256 pixels | 95 % | 100 / 300 | 1,000 |",
        "| 16 probes of 512 rows, frames without a pause | 75 % | 100 / 300 | 1,234 |",
        "",
    ]
    assert lines[6] == "Does not hold: tall-probes: keeps 80%."
    assert report_of(row("a", 20)).markdown().endswith("All criteria hold.\n")


def test_an_unknown_attack_is_named():
    result = CliRunner().invoke(app, ["bench", "hostile", "--attack", "poetry"])
    assert result.exit_code != 0
    assert "poetry" in result.output + str(result.exception)


@pytest.mark.slow
def test_attacks_reach_the_server_and_the_neighbour_streams():
    attacks = ("large-headers", "refused-bodies", "hung-up-posts", next(iter(FLOODS)))
    options = HostileOptions(minutes=0.3, model="classical", height=16, attacks=attacks)
    report = run_hostile(options)
    assert [result.attack for result in report.attacks] == list(attacks)
    for each in (report.alone, *report.attacks):
        assert each.due > 0
        assert 0 <= each.processed <= each.due
        assert each.rss_bytes > 0
    assert report.alone.processed > 0
    assert all(result.requests > 0 for result in report.attacks)
