"""The rule by which a model becomes the default, on made-up scores."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from roomlight.metrics import METRICS
from roomlight_cli.console import print_table
from roomlight_evaluation.captures.scores import CaptureScores, CaptureSummary, Track
from roomlight_evaluation.captures.ship_rule import TARGET, TOLERANCE, ShipRule, rule_of, ship_rule_table, write_rule

FRAMES = 31


def track(capture: str, method: str, values: dict[str, float | list[float]], *, frames: int, probe: int = 0) -> Track:
    """One probe's scores: the given metrics, each a constant or a value a frame; all others 1."""
    scores = {"energy": (1.0,) * frames} | {metric.key: (1.0,) * frames for metric in METRICS}
    for key, value in values.items():
        scores[key] = tuple(value) if isinstance(value, list) else (value,) * frames
    scores["smoothness"] = scores["smoothness"][1:]
    return Track(capture, probe, method, tuple(range(frames)), scores)


def rule(*captures: dict[str, float | list[float]], frames: int = FRAMES) -> ShipRule:
    """The rule for a candidate with these scores on captures where both others have 1."""
    return rule_of(scores_of(*captures, frames=frames), "single", "classical")


def scores_of(*captures: dict[str, float | list[float]], frames: int = FRAMES) -> CaptureScores:
    tracks, summaries = list[Track](), list[CaptureSummary]()
    for number, values in enumerate(captures):
        name = f"room-{number}"
        summaries.append(CaptureSummary(name, name, frames=frames, skipped=0, probes=1))
        tracks += [
            track(name, "candidate", values, frames=frames),
            track(name, "reference", {}, frames=frames),
            track(name, "warp and fill", {"log_l2": 2.0, "render_l2": 4.0}, frames=frames),
        ]
    return CaptureScores(tuple(summaries), tuple(tracks))


BETTER: dict[str, float | list[float]] = {"log_l2": 0.8, "render_l2": 0.8}


def test_a_model_that_is_better_everywhere_passes():
    passed = rule(BETTER, BETTER, BETTER)
    assert passed.failures() == []
    assert passed.mean("log_l2").mean == pytest.approx(0.8)
    assert passed.mean_to_warp("log_l2").mean == pytest.approx(0.4)
    assert passed.mean_to_warp("render_l2").mean == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("values", "failures"),
    [
        ({"log_l2": [0.7] * 25 + [TOLERANCE + 0.02] * 6}, ["interval 5 of 5: log-L2 is 1.07 of classical's"]),
        ({"log_l2": [0.7] * 25 + [TOLERANCE - 1e-9] * 6}, []),  # the tolerance itself passes
        ({"render_l2": [1.2] * 7 + [0.5] * 24}, ["interval 1 of 5: glossy sphere is 1.20 of classical's"]),
    ],
)
def test_an_interval_that_is_worse_fails(values, failures):
    assert rule(BETTER, BETTER | values).failures() == [f"room-1, {line}" for line in failures]


def test_no_gain_on_the_mean_fails():
    failures = rule({"log_l2": 0.9, "render_l2": 0.8}).failures()
    assert failures == [f"mean over captures: log-L2 is 0.900 of classical's, above {TARGET}"]


def test_the_worst_comes_first():
    early, late = [1.1] * 7 + [0.2] * 24, [0.2] * 25 + [3.0] * 6
    failures = rule(BETTER | {"log_l2": early}, BETTER | {"log_l2": late}).failures()
    assert [line.split(":")[0] for line in failures] == ["room-1, interval 5 of 5", "room-0, interval 1 of 5"]


def test_the_mean_is_over_captures_not_frames():
    found = rule({"log_l2": 0.5, "render_l2": 0.5}, {"log_l2": 1.0, "render_l2": 1.0})
    mean = found.mean("log_l2")
    assert mean.mean == pytest.approx(0.75)
    assert mean.low == pytest.approx(0.5)
    assert mean.high == pytest.approx(1.0)


def test_short_captures_name_the_right_interval():
    """Two frames fill the first and the last of the five intervals or some two of them; the others have no ratio."""
    found = rule(BETTER | {"log_l2": [0.5, 2.0]}, frames=2)
    (ratios, _) = found.ratios
    assert len(ratios.intervals) == 5
    known = [number for number, value in enumerate(ratios.intervals, 1) if not math.isnan(value)]
    assert len(known) == 2
    assert ratios.last == ratios.worst == pytest.approx(2.0)
    assert ratios.to_warp == pytest.approx(1.0)
    assert found.failures()[0].startswith(f"room-0, interval {known[-1]} of 5: log-L2 is 2.00")


def test_scores_that_are_no_numbers_fail():
    failures = rule(BETTER | {"log_l2": math.nan}, BETTER).failures()
    assert "room-0, interval 1 of 5: log-L2 is inf of classical's" in failures
    assert any(line.startswith("mean over captures: log-L2 is inf") for line in failures)


def test_invisible_errors_count_as_equal():
    """3e-5 against 1e-5 is no difference."""
    tiny: dict[str, float | list[float]] = {"log_l2": 3e-5, "render_l2": 3e-5}
    scores = scores_of(tiny)
    tracks = tuple(
        one if one.method != "reference" else track("room-0", "reference", {"log_l2": 1e-5, "render_l2": 1e-5},
                                                    frames=FRAMES)
        for one in scores.tracks
    )  # fmt: skip
    found = rule_of(CaptureScores(scores.captures, tracks), "single", "classical")
    assert found.mean("log_l2").mean == 1


def test_energy_is_that_of_the_last_frame():
    found = rule(BETTER | {"energy": [0.2] * 30 + [0.9]}, BETTER | {"energy": [math.nan] * 31})
    assert found.energy[0] == pytest.approx(0.9)
    assert math.isnan(found.energy[1])  # a black truth


def test_the_table_has_each_capture_and_the_means():
    console = Console(width=200, record=True)
    print_table(console, ship_rule_table(rule(BETTER | {"energy": 0.75}, BETTER)))
    text = console.export_text()
    assert "single against classical" in text
    assert f"at most {TOLERANCE}, mean {TARGET}" in text
    row = next(line for line in text.split("\n") if "room-0" in line and "log-L2" in line)
    assert "0.80" in row
    assert "0.40" in row
    assert "0.75" in row
    assert "0.800 [0.800, 0.800]" in text
    assert text.count("room-1") == 2


def test_scores_and_rule_are_written_as_json(tmp_path: Path):
    scores = scores_of({"log_l2": [0.5, 2.0], "render_l2": 0.8}, frames=2)
    found = rule_of(scores, "single", "classical")
    write_rule(tmp_path / "rule.json", found, scores)
    read = json.loads((tmp_path / "rule.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert read["schema"] == "roomlight-evaluation-1"
    written = read["ship_rule"]
    assert written["failures"] == found.failures()
    assert written["ratios"][0]["capture"] == "room-0"
    assert None in written["ratios"][0]["intervals"]
    assert written["means"]["render_l2"]["mean"] == pytest.approx(np.mean(0.8))
