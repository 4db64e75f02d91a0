"""Scores of estimators on captures: values, refusals, intervals over captures, JSON and tables."""

import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from roomlight.camera import Intrinsics
from roomlight.captures import CaptureOptions
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError, ImageError, ModelError, OptionError
from roomlight.files import json_text
from roomlight.frame import Frame
from roomlight.images import write_exr
from roomlight.metrics import METRICS, PAPER_INTERVALS
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.depth import evaluate_depth
from roomlight_evaluation.captures.estimators import Estimator, PredictionFolder
from roomlight_evaluation.captures.evaluation import capture_names, evaluate_captures, evaluate_engine
from roomlight_evaluation.captures.main_light import evaluate_main_lights
from roomlight_evaluation.captures.poses import evaluate_poses
from roomlight_evaluation.captures.scores import CaptureScores, CaptureSummary, Track
from roomlight_evaluation.captures.tables import capture_tables
from roomlight_evaluation.confidence import mean_with_interval
from roomlight_evaluation.objects.evaluation import evaluate_objects
from rooms import BoxRoom, pan
from written_captures import write_capture

PROBES = ((0.0, 0.0, -1.0), (0.3, 0.1, -1.5))
INTRINSICS = Intrinsics(32.0, 32.0, 20.0, 15.0, 40, 30)


def truth(number: int, height: int = 16) -> np.ndarray:
    return np.random.default_rng(number).exponential(0.5, (height, 2 * height, 3)).astype(np.float16).astype(np.float32)


def capture_of(path: Path, *, frames: int = 3, probes: bool = True) -> Path:
    """A capture of a flat coloured wall two metres ahead; its ground truth is unrelated noise."""
    return write_capture(
        path,
        [wall_frame(index, 0.1 * (index + 1)) for index in range(frames)],
        probes=[(position, truth(number)) for number, position in enumerate(PROBES if probes else ())],
    )


def wall_frame(index: int, grey: float) -> Frame:
    image = np.full((30, 40, 3), np.float32(grey))
    return Frame(index, image, image[..., 0] > 1, np.full((30, 40), 2.0, np.float32), INTRINSICS, np.eye(4))


class Oracle:
    """Returns the truth after `at` further frames, and black before."""

    def __init__(self, name: str = "oracle", at: int = 0, height: int = 16) -> None:
        self.name = name
        self._at = at
        self._height = height
        self._frames = 0

    def push(self, frame: Frame) -> None:
        assert frame.image.shape == (30, 40, 3)
        self._frames += 1

    def light_at(self, position: tuple[float, float, float]) -> np.ndarray:
        number = min(range(len(PROBES)), key=lambda index: math.dist(PROBES[index], position))
        panorama = truth(number).repeat(self._height // 16, axis=0).repeat(self._height // 16, axis=1)
        return panorama if self._frames > self._at else np.zeros_like(panorama)


def values(scores: CaptureScores, method: str, metric: str) -> list[tuple[float, ...]]:
    return [track.scores[metric] for track in scores.tracks if track.method == method]


def test_the_truth_scores_zero_and_baselines_do_not(tmp_path: Path) -> None:
    capture = capture_of(tmp_path / "room")
    seen: list[tuple[str, int, int]] = []

    def methods() -> Sequence[Estimator]:
        return [Oracle(), MeanColour(16), WarpAndFill(16)]

    scores = evaluate_captures([capture], methods, progress=lambda *state: seen.append(state))
    assert scores.methods == ("oracle", "mean colour", "warp and fill")
    assert scores.captures == (CaptureSummary("room", str(capture), frames=3, skipped=0, probes=2),)
    assert seen == [("room", done, 3) for done in range(1, 4)]
    for metric in METRICS:
        for track in values(scores, "oracle", metric.key):
            assert track == pytest.approx([metric.best] * len(track), abs=1e-6)
            assert len(track) == (2 if metric.key == "smoothness" else 3)
    for metric in ("log_l2", "ldr_l2", "render_l2", "si_rmse_mirror"):
        assert min(min(track) for track in values(scores, "mean colour", metric)) > 0.001
    # the mean colour changes as frames come in, and so is not smooth
    assert min(values(scores, "mean colour", "smoothness")[0]) > 0


def test_panoramas_are_resized_to_the_height_of_the_truth(tmp_path: Path) -> None:
    scores = evaluate_captures([capture_of(tmp_path / "room", frames=1)], lambda: [Oracle(height=48)])
    # 48 rows hold three equal ones for each of the 16: the solid-angle weighted mean of each three is the row itself
    assert values(scores, "oracle", "log_l2")[0] == pytest.approx((0.0,), abs=1e-9)


def test_the_engine_is_scored_beside_both_baselines(tmp_path: Path) -> None:
    room, point = BoxRoom(), (0.3, 1.2, -0.5)
    probes = [(point, room.panorama(np.array(point), height=32)[0])]
    capture = write_capture(tmp_path / "box", pan(room, 3, width=64, height=48, step_degrees=25.0), probes=probes)
    scores = evaluate_engine([capture], SessionOptions(model="classical", height=32))
    assert scores.methods == ("mean colour", "warp and fill", "classical")
    assert "null" not in json.dumps(scores.to_json()["tracks"], allow_nan=False)
    # it sees the wall ahead of the probe; the mean colour does not
    assert scores.means("classical", "log_l2")[-1].mean < scores.means("mean colour", "log_l2")[-1].mean


def write_predictions(folder: Path, *, frames: range) -> None:
    for number in range(len(PROBES)):
        for index in frames:
            write_exr(folder / f"probe-{number:02d}" / f"light.{index:06d}.exr", truth(number))


@pytest.mark.parametrize("nested", [False, True])
def test_predictions_are_scored_as_one_more_method(tmp_path: Path, nested: bool) -> None:
    capture = capture_of(tmp_path / "room")
    predictions = tmp_path / "out"
    write_predictions(predictions / "room" if nested else predictions, frames=range(3))
    scores = evaluate_captures([capture], lambda: [MeanColour(16)], predictions=predictions)
    assert scores.methods == ("mean colour", "predictions")
    assert values(scores, "predictions", "log_l2")[1] == pytest.approx([0.0] * 3, abs=1e-9)
    alone = evaluate_captures([capture], list, predictions=predictions)
    assert alone.methods == ("predictions",)
    assert values(alone, "predictions", "log_l2") == values(scores, "predictions", "log_l2")


def test_predictions_are_numbered_by_frame_index(tmp_path: Path) -> None:
    capture = capture_of(tmp_path / "room")
    write_predictions(tmp_path / "out", frames=range(0, 3, 2))
    scores = evaluate_captures([capture], list, predictions=tmp_path / "out", options=CaptureOptions(every=2))
    assert scores.tracks[0].frames == (0, 2)


def test_a_missing_prediction_is_named(tmp_path: Path) -> None:
    capture = capture_of(tmp_path / "room")
    write_predictions(tmp_path / "out", frames=range(3))
    missing = tmp_path / "out" / "probe-01" / "light.000002.exr"
    missing.unlink()
    with pytest.raises(CaptureError, match=r"probe-01/light\.000002\.exr.*is missing"):
        evaluate_captures([capture], list, predictions=tmp_path / "out")
    missing.with_suffix(".npz").touch()
    with pytest.raises(CaptureError, match=r"light\.000002\.npz, but predictions are EXR or HDR"):
        evaluate_captures([capture], list, predictions=tmp_path / "out")


def test_predictions_may_be_of_a_wide_gamut_or_hdr(tmp_path: Path) -> None:
    write_predictions(tmp_path, frames=range(1))
    green, folder = np.zeros_like(truth(1)), tmp_path / "probe-01"
    green[..., 1] = 1.0  # of ACEScg: its red of Rec. 709 is below 0
    acescg = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    write_exr(folder / "light.000000.exr", green, metadata={"chromaticities": acescg})
    cv2.imwrite(str(tmp_path / "probe-00/light.000000.hdr"), truth(0)[..., ::-1])
    (tmp_path / "probe-00/light.000000.exr").unlink()
    read = PredictionFolder(tmp_path, PROBES)
    read.push(wall_frame(0, 0.1))
    assert (read.light_at(PROBES[1]) >= 0).all()
    np.testing.assert_allclose(read.light_at(PROBES[0]), truth(0), rtol=0.01, atol=0.01 * truth(0).max())


@pytest.mark.parametrize("value", [np.nan, -0.1])
def test_a_prediction_that_is_not_finite_or_negative_is_refused(tmp_path: Path, value: float) -> None:
    write_predictions(tmp_path / "out", frames=range(3))
    damaged = truth(1)
    damaged[3, 4] = value
    write_exr(tmp_path / "out" / "probe-01" / "light.000001.exr", damaged)
    with pytest.raises(ImageError, match=r"probe-01/light\.000001\.exr: 1 pixels are not finite or negative"):
        evaluate_captures([capture_of(tmp_path / "room")], list, predictions=tmp_path / "out")


def test_predictions_of_two_probes_at_one_position_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"probes 0 and 2 are both at \(0.0, 0.0, -1.0\)"):
        PredictionFolder(tmp_path, [*PROBES, PROBES[0]])


def test_a_folder_without_predictions_is_named(tmp_path: Path) -> None:
    capture, other = capture_of(tmp_path / "room"), capture_of(tmp_path / "other")
    write_predictions(tmp_path / "out", frames=range(3))
    with pytest.raises(CaptureError, match="no predictions for the capture room"):
        evaluate_captures([capture], list, predictions=tmp_path / "nowhere")
    # with two captures, probe-00 without a capture's name could be either's
    with pytest.raises(CaptureError, match="no predictions for the capture room"):
        evaluate_captures([capture, other], lambda: [], predictions=tmp_path / "out")


def test_a_replay_that_lights_scenes_is_refused(tmp_path: Path) -> None:
    write_predictions(tmp_path / "out", frames=range(3))
    (tmp_path / "out" / "replay.json").write_text('{"options": {"use": "lighting"}}')
    capture = capture_of(tmp_path / "room")
    with pytest.raises(CaptureError, match="--use reflection"):
        evaluate_captures([capture], list, predictions=tmp_path / "out")
    (tmp_path / "out" / "replay.json").write_text('{"by": "another program"}')
    evaluate_captures([capture], list, predictions=tmp_path / "out")


class Broken(Oracle):
    def __init__(self, change: Callable[[np.ndarray], np.ndarray]) -> None:
        super().__init__()
        self._change = change

    def light_at(self, position: tuple[float, float, float]) -> np.ndarray:
        return self._change(super().light_at(position))


class Interrupted:
    """Is black after the first frame, has no estimate after the third, and the truth after the others."""

    name = "interrupted"

    def __init__(self) -> None:
        self._oracle, self._frames = Oracle(at=1), 0

    def push(self, frame: Frame) -> None:
        self._frames += 1
        self._oracle.push(frame)

    def light_at(self, position: tuple[float, float, float]) -> np.ndarray | None:
        return None if self._frames == 3 else self._oracle.light_at(position)


def test_a_missing_estimate_has_no_score_and_moves_no_other(tmp_path: Path) -> None:
    scores = evaluate_captures([capture_of(tmp_path / "room", frames=5)], lambda: [Interrupted()])
    for track in scores.tracks:
        assert [index for index, value in enumerate(track.scores["log_l2"]) if math.isnan(value)] == [2]
        assert [value > 0 for value in track.scores["log_l2"]] == [True, False, False, False, False]
        # smoothness i is between frames i and i + 1: the light comes on from the first to the second
        first, *others, last = track.scores["smoothness"]
        assert first > last == 0
        assert all(math.isnan(value) for value in others)


def test_what_cannot_be_scored_is_named(tmp_path: Path) -> None:
    room, namesake = capture_of(tmp_path / "a" / "room"), capture_of(tmp_path / "b" / "room")
    bare = capture_of(tmp_path / "bare", probes=False)
    for captures, methods, error, message in (
        ([bare], [MeanColour(16)], CaptureError, "bare: there is no ground truth"),
        ([room, namesake], [MeanColour(16)], CaptureError, "two captures are called room"),
        ([room], [MeanColour(16), MeanColour(16)], OptionError, "different names"),
        ([room], [Broken(lambda light: light * np.float32(np.nan))], ModelError, "invalid panorama at .* frame 0"),
        ([room], [Broken(lambda light: -light)], ModelError, r"least value -\d.*not negative"),
        ([room], [Broken(lambda light: light[..., :1])], ModelError, r"shape \(16, 32, 1\)"),
        ([room], [Broken(lambda light: light[..., 0])], ModelError, r"shape \(16, 32\)"),
    ):
        with pytest.raises(error, match=message):
            evaluate_captures(captures, lambda chosen=methods: chosen)


def test_captures_of_one_name_are_not_merged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    captures, light, reading = [tmp_path / "a" / "room", tmp_path / "b" / "room"], SessionOptions(), CaptureOptions()
    for evaluate in (
        lambda: evaluate_main_lights(captures, light),
        lambda: evaluate_depth(captures, light, reading),
        lambda: evaluate_poses(captures, light, reading),
        lambda: evaluate_objects(captures, light),
    ):
        with pytest.raises(CaptureError, match="two captures are called room"):
            evaluate()
    monkeypatch.chdir(tmp_path)
    assert capture_names([Path()]) == [tmp_path.name]


def test_scores_are_written_as_json(tmp_path: Path) -> None:
    scores = evaluate_captures(
        [capture_of(tmp_path / "room"), capture_of(tmp_path / "short", frames=1)], lambda: [MeanColour(16)]
    )
    data = json.loads(json_text(scores.to_json()))
    assert data["schema"] == "roomlight-evaluation-1"
    assert len(data["summary"]) == 3 * len(METRICS)  # both captures and their mean, one method
    one_frame = next(
        entry for entry in data["summary"] if entry["capture"] == "short" and entry["metric"] == "smoothness"
    )
    assert {interval["mean"] for interval in one_frame["intervals"]} == {None}


def uniform_scores(by_pair: dict[tuple[str, int], float], *, frames: int = 31, method: str = "m") -> CaptureScores:
    captures = tuple(
        CaptureSummary(name, name, frames, 0, sum(key[0] == name for key in by_pair))
        for name in dict.fromkeys(key[0] for key in by_pair)
    )
    tracks = tuple(
        Track(capture, probe, method, tuple(range(frames)), dict.fromkeys((m.key for m in METRICS), (score,) * frames))
        for (capture, probe), score in by_pair.items()
    )
    return CaptureScores(captures, tracks)


def test_captures_have_equal_weight_whatever_their_probes() -> None:
    scores = uniform_scores({("a", 0): 1.0, ("b", 0): 2.0, ("b", 1): 2.0, ("b", 2): 2.0})
    for cell in scores.means("m", "log_l2"):
        assert cell.mean == pytest.approx(1.5)
        assert 1.0 <= cell.low < 1.5 < cell.high <= 2.0
    assert [cell.mean for cell in scores.means("m", "log_l2", capture="b")] == [2.0] * 6
    walks = uniform_scores(
        {(f"{room}{walk}", 0): value for room, value in (("a", 1.0), ("b", 2.0)) for walk in range(4)}
    )
    alike = uniform_scores({(room, probe): value for room, value in (("a", 1.0), ("b", 2.0)) for probe in range(50)})
    assert (alike.means("m", "log_l2")[0].low, alike.means("m", "log_l2")[0].high) == (1.0, 2.0)  # two rooms, not 100
    rooms = tuple(dataclasses.replace(capture, room=f"room {capture.name[0]}") for capture in walks.captures)
    walks = dataclasses.replace(walks, captures=rooms)
    assert (walks.means("m", "log_l2")[0].low, walks.means("m", "log_l2")[0].high) == (1.0, 2.0)  # two rooms, not 8
    assert walks.resampled == "rooms"
    with pytest.raises(KeyError, match="no scores of 'x'"):
        scores.means("x", "log_l2")


def test_captures_whose_facts_state_one_room_count_together(tmp_path: Path) -> None:
    captures = [capture_of(tmp_path / name, frames=1) for name in ("a", "b", "c")]
    for capture, room in zip(captures, ('{"room": "hall"}', '{"light": {"building": "hall"}}'), strict=False):
        (capture / "facts.json").write_text(room)
    scores = evaluate_captures(captures, lambda: [MeanColour(16), WarpAndFill(16)])
    assert [capture.room for capture in scores.captures] == ["hall", "hall", None]
    assert scores.resampled == "rooms"
    (captures[2] / "facts.json").write_text("{")
    with pytest.raises(CaptureError, match=r"c.facts\.json: is not JSON"):
        evaluate_captures(captures, list)  # before any frame is scored


def test_captures_are_compared_with_the_classical_model() -> None:
    classical = uniform_scores({("a", 0): 1.0, ("b", 0): 1.0}, method="classical")
    single = uniform_scores({("a", 0): 0.5, ("b", 0): 1.0}, method="single")
    scores = dataclasses.replace(classical, tracks=(*classical.tracks, *single.tracks))
    ratio = scores.ratio("log_l2", "single", "classical")
    assert (ratio.mean, ratio.low, ratio.high) == pytest.approx((0.75, 0.5, 1.0))
    *_, table = capture_tables(scores, per_capture=True)
    assert [list(column.cells) for column in table.columns][:2] == [
        ["a", "b", "all 2"],
        ["0.500", "1.000", "0.750 (0.500 to 1.000)"],
    ]
    of_a = {"captures": scores.captures[:1], "tracks": tuple(t for t in scores.tracks if t.capture == "a")}
    *_, table = capture_tables(dataclasses.replace(scores, **of_a), per_capture=True)
    assert [*table.columns[0].cells] == ["a"]
    *_, table = capture_tables(scores)
    assert [list(column.cells) for column in table.columns][:2] == [["single"], ["0.750 (0.500 to 1.000)"]]
    alike = tuple(dataclasses.replace(capture, room="a") for capture in scores.captures)
    *_, table = capture_tables(dataclasses.replace(scores, captures=alike), per_capture=True)
    assert [*table.columns[1].cells][-1] == "0.750"
    assert "interval over rooms" in str(table.caption)


def test_the_bootstrap_interval_matches_the_standard_error() -> None:
    drawn = np.random.default_rng(5).normal(10, 2, 200)
    interval = mean_with_interval(drawn)
    standard_error = drawn.std() / math.sqrt(len(drawn))
    assert interval.high - interval.low == pytest.approx(2 * 1.96 * standard_error, rel=0.05)
    assert interval == mean_with_interval(drawn)  # seeded
    single = mean_with_interval([3.0])
    assert single.mean == 3.0
    assert math.isnan(single.low)


def test_column_headings_are_the_papers_for_31_frames() -> None:
    assert uniform_scores({("a", 0): 1.0}).columns == (*PAPER_INTERVALS, "all")
    assert uniform_scores({("a", 0): 1.0}, frames=10).columns == ("1-2", "3-4", "5-6", "7-8", "9-10", "all")
    mixed = uniform_scores({("a", 0): 1.0})
    every_sixth = [dataclasses.replace(track, frames=(0, 6, 12, 18)) for track in mixed.tracks]
    sparse = dataclasses.replace(mixed.captures[0], frames=4)
    assert CaptureScores((sparse,), tuple(every_sixth)).columns == ("1", "7", "none", "13", "19", "all")
    shorter = dataclasses.replace(mixed.captures[0], name="b", frames=12)
    assert dataclasses.replace(mixed, captures=(*mixed.captures, shorter)).columns[0] == "part 1 of 5"
