"""Comparisons of the recurrent networks on walks: what each method sees, and when it answers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from present import present
from recordings import BoxWalks
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import SessionOptions
from roomlight.errors import DatasetError, OptionError
from roomlight.metrics import log_l2
from roomlight_evaluation.baselines import MeanColour
from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator
from roomlight_evaluation.captures.tables import capture_tables
from roomlight_evaluation.drift import FOLLOWED, STATED, drift_gain, drift_models
from roomlight_evaluation.walks import (
    LATE_FROM,
    NO_RNN,
    Compared,
    FrameAlone,
    LateProbe,
    SimpleAverage,
    evaluate_walks,
    image_models,
    recurrent_models,
    walk_frames,
)

pytestmark = pytest.mark.slow

FRAMES, HEIGHT = 3, 32


@pytest.fixture(scope="module")
def options(tiny_video):
    return SessionOptions(weights=tiny_video, height=HEIGHT)


@pytest.fixture(scope="module")
def models(options):
    return recurrent_models(options)


@pytest.fixture(scope="module")
def single(options):
    """Options and graphs of the single-view form."""
    chosen = replace(options, model="single")
    return chosen, choose_graphs(chosen)


@pytest.fixture(scope="module")
def evaluated(models):
    reported = []
    scores = evaluate_walks([BoxWalks(3, height=HEIGHT)], models, limit=2, progress=lambda *at: reported.append(at))
    assert reported == [(1, 2), (2, 2)]
    return scores


def test_every_comparison_is_scored_on_every_walk(evaluated):
    assert evaluated.methods == (
        "mean colour", "warp and fill", "classical", NO_RNN, "simple average", "single", "video",
        "classical, phone depth", "video, phone depth",
    )  # fmt: skip
    assert len(evaluated.captures) == 2
    for track in evaluated.tracks:
        assert len(track.scores["log_l2"]) == FRAMES
        assert len(track.scores["smoothness"]) == FRAMES - 1


def test_a_late_probe_has_no_light_before_it_is_asked_for(options):
    chosen = replace(options, model="video")
    video = EngineEstimator(chosen, choose_graphs(chosen))
    estimator, position, tracked = LateProbe(video), (0.0, 0.0, 0.0), None
    frames = list(walk_frames(BoxWalks(1, height=HEIGHT)[0], "exact"))
    for number in range(LATE_FROM):
        assert estimator.light_at(position) is None
        frame = replace(frames[number % FRAMES], index=number)
        video.push(frame)
        tracked = video.light_at(position)
        estimator.push(frame)
    late = present(estimator.light_at(position))
    assert tracked is not None
    assert not np.array_equal(late, tracked)  # it has blended no earlier frame


def test_late_probes_are_scored_on_the_walks_that_are_long_enough(tiny_video, monkeypatch):
    class TwoLengths(BoxWalks):
        def __getitem__(self, number):
            return self.read(number, frames=range(FRAMES - number))

    monkeypatch.setattr("roomlight_evaluation.walks.LATE_FROM", FRAMES)
    video = SessionOptions(model="video", weights=tiny_video, height=HEIGHT)
    graphs = choose_graphs(video)

    def estimators() -> list[Estimator]:
        tracked = EngineEstimator(video, graphs)
        return [MeanColour(), tracked, LateProbe(tracked)]

    scores = evaluate_walks([TwoLengths(2, height=HEIGHT)], Compared(estimators))
    means = [
        entry["intervals"][-2]["mean"]
        for entry in scores.to_json()["summary"]
        if (entry["method"], entry["metric"]) == (LateProbe.name, "log_l2")
    ]
    assert means[0] == means[1] > 0
    assert np.isnan(means[2])
    table, ratios = capture_tables(scores)
    assert f" {LateProbe.name}" in table.columns[0].cells
    assert list(ratios.columns[0].cells) == [MeanColour.name]  # a late probe has no mean of all frames


def test_each_frame_alone_knows_nothing_of_earlier_ones(single):
    frames = list(walk_frames(BoxWalks(1, height=HEIGHT)[0], "exact"))
    both, last = (FrameAlone(*single) for _ in range(2))
    for frame in frames:
        both.push(frame)
    last.push(frames[-1])
    np.testing.assert_array_equal(both.light_at((0.0, 0.0, 0.0)), last.light_at((0.0, 0.0, 0.0)))


def test_the_average_is_of_the_frames_so_far(single):
    alone = FrameAlone(*single)
    average = SimpleAverage(alone)
    point, seen, result = (0.0, 0.0, 0.0), [], None
    for frame in list(walk_frames(BoxWalks(1, height=HEIGHT)[0], "exact"))[:3]:
        alone.push(frame)
        average.push(frame)
        seen.append(alone.light_at(point))
        result = average.light_at(point)
    assert result is not None
    np.testing.assert_allclose(result, np.mean(seen, axis=0), rtol=1e-5)


def test_scores_are_of_the_walk_s_own_truth(evaluated, single):
    walks = BoxWalks(3, height=HEIGHT)
    recording = walks[0]
    frames = list(walk_frames(recording, "exact"))
    alone = FrameAlone(*single)
    alone.push(frames[2])
    x, y, z = recording.probe_positions[0]
    position = (float(x), float(y), float(z))
    truth = recording.probe_panoramas[0] * np.float32(recording.exposure[0])
    track = next(one for one in evaluated.tracks if one.method == NO_RNN and one.probe == 0)
    assert track.scores["log_l2"][2] == pytest.approx(log_l2(alone.light_at(position), truth), rel=1e-5)


def test_single_images_are_first_frames_with_both_kinds_of_depth(options):
    scores = evaluate_walks([BoxWalks(3, height=HEIGHT)], image_models(options), limit=2)
    names = ("warp and fill", "classical", "single")
    assert scores.methods == ("mean colour", *names, *(f"{name}, phone depth" for name in names))
    assert {track.frames for track in scores.tracks} == {(0,)}
    assert [capture.frames for capture in scores.captures] == [1, 1]


def test_drift_is_followed_from_the_first_frame_on():
    """The walk's frames have the exposures 1, 1.08 and 1.16; the session takes them as stated or estimates them."""
    scores = evaluate_walks([BoxWalks(1, height=HEIGHT)], drift_models(SessionOptions(model="classical", height=48)))
    assert scores.methods == ("classical", FOLLOWED, STATED)
    mean = {
        name: np.mean([track.scores["log_l2"] for track in scores.tracks if track.method == name], axis=0)
        for name in scores.methods
    }
    assert mean[FOLLOWED][0] == pytest.approx(mean["classical"][0], rel=0.02)
    assert mean[FOLLOWED].mean() <= 1.05 * mean["classical"].mean()
    assert mean[STATED].mean() > mean[FOLLOWED].mean()
    assert (drift_gain(0) == 1).all()


def test_phone_depth_is_seeded_by_the_walk_s_name():
    recording = BoxWalks(2, height=HEIGHT)[0]
    once, again = ([frame.depth_m for frame in walk_frames(recording, "arkit")] for _ in range(2))
    np.testing.assert_array_equal(once, again)
    renamed = replace(recording, name="another")
    assert not np.array_equal(once, [frame.depth_m for frame in walk_frames(renamed, "arkit")])


@pytest.mark.parametrize("lacking", ["depth", ("probe_positions", "probe_panoramas")])
def test_walks_without_depth_or_probes_are_left_out(lacking):
    models = drift_models(SessionOptions(model="classical", height=HEIGHT))

    class Blind(BoxWalks):
        def __getitem__(self, number):
            recording = super().__getitem__(number)
            blind = {"depth_mm": recording.depth_mm * np.uint16(0)}
            without = blind if lacking == "depth" else {name: vars(recording)[name][:0] for name in lacking}
            return recording if number else replace(recording, **without)

    assert len(evaluate_walks([Blind(2, height=HEIGHT)], models).captures) == 1
    with pytest.raises(DatasetError, match="no walk can be used"):
        evaluate_walks([Blind(1, height=HEIGHT)], models)


def test_an_empty_dataset_two_of_one_name_and_single_view_weights_are_refused(models):
    with pytest.raises(DatasetError, match="boxes: has no finished walk"):
        evaluate_walks([BoxWalks(0)], models)
    with pytest.raises(DatasetError, match="two datasets are called boxes"):
        evaluate_walks([BoxWalks(1), BoxWalks(1)], models)
    with pytest.raises(OptionError, match="single-view weights only"):
        recurrent_models(SessionOptions(weights=Path("core/roomlight/engine/weights/single").resolve()))
