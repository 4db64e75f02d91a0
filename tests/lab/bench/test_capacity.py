"""Machines for a number of phones: the arithmetic, and the page that shows it."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from roomlight_bench.server.capacity import Assumptions, CapacityReport, ServiceCost, machines_for
from roomlight_bench.server.replicas import ReplicaBenchOptions, ReplicaReport, ReplicaRow

COST = ServiceCost(frames_per_core_s=10.0, frame_bytes=40e3, state_bytes=4e6, session_bytes=100e6)
ASSUMED = Assumptions(fps=2.0, cores=8, memory_gb=10.0, load=0.5, state_interval_s=10.0)
PAGE = Path(__file__).parents[3] / "docs" / "capacity.md"


def test_the_scarcer_of_time_and_memory_decides():
    found = machines_for(1000, COST, ASSUMED)
    assert (found.by_frames, found.by_memory, found.machines) == (50, 10, 50)
    found = machines_for(1000, COST, replace(ASSUMED, memory_gb=1.0))
    assert (found.by_frames, found.by_memory, found.machines) == (50, 100, 100)
    assert machines_for(1, COST, ASSUMED).machines == 1
    assert machines_for(1000, COST, replace(ASSUMED, ratio=1.5)).by_frames == 75


def test_traffic_is_that_of_all_phones():
    found = machines_for(100, COST, ASSUMED)
    assert found.frame_traffic == pytest.approx(100 * 2 * 40e3)
    assert found.state_traffic == pytest.approx(100 * 4e6 * 2.5 / 10)
    assert machines_for(100, COST, replace(ASSUMED, state_interval_s=0.0)).state_traffic == 0
    rare = replace(ASSUMED, fps=0.01)
    assert machines_for(100, COST, rare).state_traffic == pytest.approx(100 * 4e6 * 0.01)  # no frame, no change


def test_a_report_states_what_was_assumed():
    report = CapacityReport(COST, ASSUMED, (machines_for(1000, COST, ASSUMED),), "classical", 2, None)
    title = str(report.table().title)
    for words in ("10.0 frames/s a core", "2 frames/s a phone", "8 cores", "load 50%", "saved within 10 s"):
        assert words in title
    assert report.to_json()["rows"][0]["machines"] == 50


def test_the_capacity_page_follows_from_its_figures():
    text = PAGE.read_text(encoding="utf-8")
    measured = [float(value) for value in re.findall(r"^\| .* \| ([\d.]+)(?: [kM]B)? \|$", text, re.MULTILINE)]
    per_core, frame_kb, state_mb, session_mb = measured
    cost = ServiceCost(per_core, 1e3 * frame_kb, 1e6 * state_mb, 1e6 * session_mb)
    for phones in (100, 10_000, 1_000_000):
        found = machines_for(phones, cost, Assumptions())
        row = f"| {phones:,} | {found.machines:,} | {found.by_frames:,} | {found.by_memory:,} | "
        assert row in text
        traffic = [
            machines_for(phones, cost, Assumptions(state_interval_s=each)).state_traffic for each in (5.0, 30.0, 300.0)
        ]
        rows = re.findall(rf"^\| {phones:,} \| ([\d.]+) (.B)/s \| ([\d.]+) (.B)/s \| ([\d.]+) (.B)/s \|$", text, re.M)
        units = {"MB": 1e6, "GB": 1e9, "TB": 1e12}
        shown = [float(rows[0][i]) * units[rows[0][i + 1]] for i in (0, 2, 4)]
        assert shown == pytest.approx(traffic, rel=0.03)


def test_replicas_are_compared_with_the_plain_server():
    rows = (ReplicaRow(0, 2.0, 50.0, 20.0, 300.0), ReplicaRow(1, 9.0, 60.0, 15.0, 400.0))
    report = ReplicaReport(rows, ReplicaBenchOptions(), {}, 2, 0.5)
    assert report.overhead == pytest.approx(1.2)
    assert report.to_json()["overhead"] == pytest.approx(1.2)
    assert report.table().row_count == 2
    assert ReplicaReport(rows[:1], ReplicaBenchOptions(), {}, 2, None).overhead is None
