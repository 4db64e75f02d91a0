"""The rule by which a model becomes the default, on made-up scores."""

import json
import math
from pathlib import Path

import pytest

from roomlight.metrics import METRICS
from roomlight_evaluation.captures.scores import CaptureScores, CaptureSummary, Track
from roomlight_evaluation.captures.ship_rule import BELOW, WORST, ShipRule, rule_of, write_rule

FRAMES = 3
BETTER: dict[str, float | list[float]] = {"log_l2": 0.8, "render_l2": 0.7}


def track(capture: str, method: str, values: dict[str, float | list[float]]) -> Track:
    """One probe's scores: the given metrics, each a constant or a value a frame; all others 1."""
    scores = {"energy": (1.0,) * FRAMES} | {metric.key: (1.0,) * FRAMES for metric in METRICS}
    for key, value in values.items():
        scores[key] = tuple(value) if isinstance(value, list) else (value,) * FRAMES
    scores["smoothness"] = scores["smoothness"][1:]
    return Track(capture, 0, method, tuple(range(FRAMES)), scores)


def scores_of(*captures: dict[str, float | list[float]], reference: float = 1.0) -> CaptureScores:
    known: dict[str, float | list[float]] = {"log_l2": reference, "render_l2": reference}
    tracks, summaries = list[Track](), list[CaptureSummary]()
    for number, values in enumerate(captures):
        name = f"room-{number}"
        summaries.append(CaptureSummary(name, name, frames=FRAMES, skipped=0, probes=1))
        tracks += [track(name, "candidate", values), track(name, "reference", known)]
    return CaptureScores(tuple(summaries), tuple(tracks))


def rule(*captures: dict[str, float | list[float]]) -> ShipRule:
    """The rule for a candidate with these scores on captures where the reference has 1."""
    return rule_of(scores_of(*captures), "single", "classical")


def test_a_model_that_is_better_everywhere_passes():
    passed = rule(BETTER, BETTER, BETTER)
    assert passed.failures() == []
    assert passed.ratio("log_l2").mean == pytest.approx(0.8)


def test_the_ratio_is_of_the_means_with_an_interval_over_captures():
    ratio = rule(BETTER | {"log_l2": 0.5}, BETTER | {"log_l2": [0.6, 0.9, 1.5]}).ratio("log_l2")
    assert (ratio.mean, ratio.low, ratio.high) == pytest.approx((0.75, 0.5, 1.0))


@pytest.mark.parametrize(
    ("metric", "value", "failure"),
    [
        ("log_l2", 1.0, "log-L2 is 1.000 (1.000-1.000) of classical's, not below 1.0"),
        ("render_l2", 0.95, "glossy sphere is 0.950 (0.950-0.950) of classical's, not below 0.9"),
        ("log_l2", math.nan, "log-L2 is inf (nan-nan) of classical's, not below 1.0"),
    ],
)
def test_no_gain_in_the_mean_fails(metric: str, value: float, failure: str):
    worse = BETTER | {metric: value}
    assert rule(worse, worse).failures()[-1] == f"all captures: {failure}"


def test_an_interval_that_reaches_the_limit_fails():
    captures = [BETTER] * 4 + [BETTER | {"log_l2": 1.5}]
    ratio = rule(*captures).ratio("log_l2")
    assert ratio.mean < BELOW["log_l2"] < ratio.high
    assert len(rule(*captures).failures()) == 1


def test_a_bad_capture_fails_worst_first():
    captures = [BETTER] * 40 + [BETTER | {"log_l2": WORST + 0.05}, BETTER | {"log_l2": 1.9}]
    assert rule(*captures).failures() == [
        "room-41: log-L2 is 1.90 of classical's, above 1.6",
        "room-40: log-L2 is 1.65 of classical's, above 1.6",
    ]
    assert rule(*[BETTER] * 40, BETTER | {"log_l2": WORST - 1e-9}).failures() == []


def test_invisible_errors_count_as_equal():
    """3e-5 against 1e-5 is no difference."""
    tiny = rule_of(scores_of({"log_l2": 3e-5, "render_l2": 3e-5}, reference=1e-5), "single", "classical")
    assert tiny.captures[0].ratio("log_l2") == 1


def test_energy_is_that_of_the_last_frame():
    black: list[float] = [math.nan] * 3
    scored = rule(BETTER | {"energy": [0.2, 0.3, 0.9]}, BETTER | {"energy": black})
    assert scored.captures[0].energy == pytest.approx(0.9)
    assert math.isnan(scored.captures[1].energy)


def test_scores_and_rule_are_written_as_json(tmp_path: Path):
    scores = scores_of(BETTER | {"log_l2": math.nan}, BETTER)
    verdict = rule_of(scores, "single", "classical")
    write_rule(tmp_path / "rule.json", verdict, scores)
    read = json.loads((tmp_path / "rule.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert read["schema"] == "roomlight-evaluation-1"
    assert read["ship_rule"]["failures"] == verdict.failures()
    assert read["ship_rule"]["captures"][0]["model"] == {"log_l2": None, "render_l2": pytest.approx(0.7)}
