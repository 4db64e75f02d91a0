"""Scores of estimated depth: the capture's own depth is hidden from the estimate."""

from pathlib import Path

import numpy as np
import pytest

from box_room import LENS, exact_depth, frame, pose
from depth_models import SIZE, write_depth_model
from roomlight.captures import CaptureOptions
from roomlight.engine.session import SessionOptions
from roomlight_evaluation.captures.depth import DepthScore, DepthScores, depth_errors, evaluate_depth
from written_captures import write_capture


def test_a_model_that_knows_the_room_beats_the_constant(tmp_path: Path) -> None:
    capture = write_capture(tmp_path / "room", [frame(k, pose(0.02 * k), depth=True) for k in range(3)])
    truth = exact_depth(pose(0), LENS.resized(SIZE[1], SIZE[0]))
    model = write_depth_model(tmp_path / "metric.onnx", {"depth": 1.1 * truth[None]})
    (score,) = evaluate_depth([capture], SessionOptions(model="classical"), CaptureOptions(depth_model=model)).scores
    assert score.frames == 3
    assert score.abs_rel["single"] == pytest.approx(0.1, abs=0.02)
    assert score.within_25["single"] > 0.95
    assert score.abs_rel["constant"] > 0.15
    assert score.light == {}


def test_errors_count_known_pixels_alone() -> None:
    true_m = np.full((4, 4), 2.0, np.float32)
    true_m[0] = 0
    answer = np.full((4, 4), 2.5, np.float32)
    answer[1:3] = 2.0
    assert depth_errors(answer, true_m) == pytest.approx([0.25 / 3, 2 / 3])
    assert np.isnan(depth_errors(answer, np.zeros((4, 4), np.float32))).all()


def test_the_table_ends_with_means_and_their_intervals() -> None:
    def score(name: str, error: float, light: dict[str, tuple[float, float]]) -> DepthScore:
        return DepthScore(name, 3, {"single": error}, {"single": 0.5}, light)

    table = DepthScores(
        (
            score("a", 0.1, {"log_l2": (0.3, 0.2), "si_rmse_diffuse": (0.2, 0.2)}),
            score("b", 0.3, {"log_l2": (0.1, 0.2), "si_rmse_diffuse": (0.6, 0.2)}),
            score("c", 0.2, {}),
        )
    ).table()
    rows = list(zip(*(column.cells for column in table.columns), strict=True))
    assert rows[0] == ("a", "0.100", "0.500", "1.500", "1.000")
    assert rows[2][-2:] == ("-", "-")
    assert rows[3][:2] == ("all", "0.200 (0.10-0.30)")
    assert rows[3][3:] == ("1.000 (0.50-1.50)", "2.000 (1.00-3.00)")
