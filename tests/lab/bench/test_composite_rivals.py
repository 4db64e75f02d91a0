"""Objects by size and beside Mitsuba, on tiny pictures. Speed is not tested."""

import json

import pytest

from roomlight.compositing.rendering.renderer import PRESETS
from roomlight_bench.compositing.rivals import Effort, RivalReport, Rivalry, run_rivals, run_sizes


def test_every_size_is_timed_in_every_quality():
    sizes = run_sizes(triangles=(100, 400), sides=(8, 12))
    assert [row.triangles for row in sizes] == pytest.approx([100, 400, 400], rel=0.05)
    assert sizes[0].pixels > sizes[2].pixels > 10
    assert all(set(row.render_ms) == set(PRESETS) and min(row.render_ms.values()) >= 0 for row in sizes)
    report = RivalReport(sizes)
    assert report.size_table().row_count == 3
    assert json.loads(json.dumps(report.to_json()))["criteria"] == []


def test_ratios_follow_the_power_law_of_the_errors():
    ours = tuple(Effort(n, 1.0 * n, 1 / n**0.5) for n in (4, 16, 64))
    slower = tuple(Effort(n, 5.0 * n, 1 / n**0.5) for n in (4, 16, 64))
    one = Rivalry("diffuse", ours, {"slow": slower, "equal": ours}, 0.03)
    assert one.time_ratios() == pytest.approx({"slow": 5, "equal": 1})
    assert one.error_ratios() == pytest.approx({"slow": 5**0.5, "equal": 1})
    assert RivalReport(rivals=(one,)).rival_table().row_count == 3


def test_limits_are_on_the_fastest_rival_and_on_the_picture():
    ours = tuple(Effort(n, 1.0 * n, 1 / n**0.5) for n in (4, 16, 64))
    slower = tuple(Effort(n, 5.0 * n, 1 / n**0.5) for n in (4, 16, 64))
    for rivals, difference, expected in (
        ({"slow": slower}, 0.01, [True, True]),
        ({"slow": slower, "equal": ours}, 0.01, [False, True]),
        ({"slow": slower}, 0.03, [True, False]),
    ):
        report = RivalReport(rivals=(Rivalry("diffuse", ours, rivals, difference),))
        assert [one.holds for one in report.criteria()] == expected


@pytest.mark.slow
def test_both_renderers_converge_with_samples():
    pytest.importorskip("mitsuba")
    for row in run_rivals(counts=(4, 64), reference=256, samplers=("multijitter",)):
        assert row.difference < 0.05  # the same picture but for the noise of 256 samples
        for efforts in (row.ours, *row.mitsuba.values()):
            assert efforts[1].error < efforts[0].error < 1
            assert efforts[1].cpu_ms > 0
