"""Scores of estimated depth: the capture's own depth is hidden from the estimate."""

from pathlib import Path

import numpy as np
import pytest

from box_room import LENS, exact_depth, frame, pose
from depth_models import SIZE, write_depth_model
from roomlight.captures import CaptureOptions
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError
from roomlight_evaluation.captures.depth import METHODS, DepthScore, DepthScores, depth_errors, evaluate_depth
from written_captures import write_capture


def test_a_model_that_knows_the_room_beats_the_constant(tmp_path: Path) -> None:
    capture = write_capture(tmp_path / "room", [frame(k, pose(0.02 * k), depth=True) for k in range(3)])
    truth = exact_depth(pose(0), LENS.resized(SIZE[1], SIZE[0]))
    model = write_depth_model(tmp_path / "metric.onnx", {"depth": 1.1 * truth[None]})
    (capture / "facts.json").write_text('{"room": "box"}')
    (score,) = evaluate_depth([capture], SessionOptions(model="classical"), CaptureOptions(depth_model=model)).scores
    assert (score.frames, score.of_room) == (3, "box")
    assert score.abs_rel["single"] == pytest.approx(0.1, abs=0.02)
    assert score.delta["single"] > 0.95
    assert score.abs_rel["constant"] > 0.15
    assert score.light == {}


def test_errors_count_known_pixels_alone() -> None:
    true_m = np.full((4, 4), 2.0, np.float32)
    true_m[0] = 0
    answer = np.full((4, 4), 2.5, np.float32)
    answer[1:3] = 2.0
    assert depth_errors(answer, true_m) == pytest.approx([0.25 / 3, 2 / 3])
    assert np.isnan(depth_errors(answer, np.zeros((4, 4), np.float32))).all()
    fine_m = np.arange(1, 82, dtype=np.float32).reshape(9, 9)
    assert depth_errors(fine_m[1::3, 1::3], fine_m) == pytest.approx([0, 1])  # of the samples at its pixels' centres


@pytest.mark.slow
def test_light_by_exact_depth_is_what_light_is_compared_with(tmp_path: Path) -> None:
    """Of a capture with a true panorama and of a dataset's walks: a model that knows the depth changes no light."""
    shots = [frame(k, pose(0.02 * k), depth=True) for k in range(2)]
    panorama = np.random.default_rng(0).uniform(0, 2, (16, 32, 3)).astype(np.float32)
    capture = write_capture(tmp_path / "room", shots, probes=[((0.0, 1.2, -1.0), panorama)])
    model = write_depth_model(
        tmp_path / "metric.onnx", {"depth": exact_depth(pose(0), LENS.resized(*SIZE[::-1]))[None]}
    )
    sources, reading = [capture, Path("tests/data/rooms")], CaptureOptions(depth_model=model, max_frames=2)
    seen: list[tuple[str, int, int]] = []

    def show(name: str, done: int, count: int) -> None:
        seen.append((name, done, count))

    scores = evaluate_depth(sources, SessionOptions(model="classical"), reading, limit=1, progress=show).scores
    assert [score.source for score in scores] == ["captures", "rooms"]
    assert all(score.frames == 2 and set(score.light) == {"log_l2", "si_rmse_diffuse"} for score in scores)
    by_estimate, by_truth = scores[0].light["log_l2"]
    assert by_estimate == pytest.approx(by_truth, rel=0.05)
    other_depth, exact = scores[1].light["log_l2"]
    assert other_depth != exact
    assert scores[1].abs_rel["scaled"] <= scores[1].abs_rel["stream"]
    assert [at for at in seen if at[0] == "room"] == [("room", 1, 2), ("room", 2, 2)]


def test_nothing_to_score_is_an_error() -> None:
    with pytest.raises(CaptureError, match="no recording to score"):
        evaluate_depth([], SessionOptions(model="classical"), CaptureOptions())


def test_the_table_has_means_and_their_intervals_over_captures_and_over_the_walks_of_a_dataset() -> None:
    def score(name: str, source: str, error: float, light: dict[str, tuple[float, float]]) -> DepthScore:
        return DepthScore(name, source, 3, dict.fromkeys(METHODS, error), dict.fromkeys(METHODS, 0.5), light)

    table = DepthScores(
        (
            score("a [y]", "captures", 0.1, {"log_l2": (0.3, 0.2), "si_rmse_diffuse": (0.2, 0.2)}),
            score("walk", "rooms", 0.4, {}),
            score("b", "captures", 0.3, {"log_l2": (0.1, 0.2), "si_rmse_diffuse": (0.6, 0.2)}),
            score("c", "captures", 0.2, {}),
        )
    ).table()
    rows = list(zip(*(column.cells for column in table.columns), strict=True))
    assert rows[0] == (r"a \[y]", *["0.10"] * 4, *["0.50"] * 2, "1.50", "1.00")
    assert rows[2][-2:] == ("-", "-")
    assert rows[3][:2] == ("captures (3)", "0.20 (0.10 to 0.30)")
    assert rows[3][7:] == ("1.00 (0.50 to 1.50)", "2.00 (1.00 to 3.00)")
    assert rows[4][:2] == ("rooms (1)", "0.40")
    assert len(rows) == 5
