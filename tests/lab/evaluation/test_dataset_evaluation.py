"""Scores of methods on a small dataset: values, intervals over rooms, ratios, tables, Markdown and picture."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from recordings import BoxRecordings
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import SessionOptions
from roomlight.errors import DatasetError, ModelError, OptionError
from roomlight.metrics import log_l2
from roomlight_cli.console import print_table
from roomlight_cli.main import app
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.datasets.evaluation import evaluate_dataset, first_frame
from roomlight_evaluation.datasets.methods import BLENDED, UNBLENDED, BaselineMethod, EngineMethod
from roomlight_evaluation.datasets.picture import compose_picture, write_picture
from roomlight_evaluation.datasets.scores import DatasetScores, SequenceScores
from roomlight_evaluation.datasets.tables import dataset_tables
from roomlight_evaluation.tables import markdown


class Boxes(BoxRecordings):
    """A dataset of box rooms with two sequences per room."""

    folder = "boxes"

    def read(self, index, *, frames):
        recording = super().read(index, frames=frames)
        return replace(recording, facts={"room_type": "box", "split": "test", "seed": 1, "room": index // 2})


@pytest.fixture(scope="module")
def evaluated(tiny_video):
    options = SessionOptions(model="single", weights=tiny_video[1])
    methods = [
        BaselineMethod(MeanColour), BaselineMethod(WarpAndFill),
        EngineMethod("classical", SessionOptions(model="classical"), None),
        EngineMethod(BLENDED, options, choose_graphs(options), unblended_name=UNBLENDED),
    ]  # fmt: skip
    reported = []
    result = evaluate_dataset(Boxes(4, height=120), methods, picture_rows=2, progress=lambda *at: reported.append(at))
    assert reported == [(1, 4), (2, 4), (3, 4), (4, 4)]
    return result


def scores_of(values, rooms):
    """Scores with exact depth: `values` are (log-L2, rendering loss) of each sequence by method."""
    sequences = []
    for k, room in enumerate(rooms):
        scores = {method: {"exact": pairs[k]} for method, pairs in values.items()}
        sequences.append(SequenceScores(f"s{k}", room, "box", scores))
    return DatasetScores("a dataset", tuple(sequences))


def test_every_method_is_scored_on_every_sequence_and_depth(evaluated):
    scores, _ = evaluated
    assert scores.methods == ("mean colour", "warp and fill", "classical", "SGLV alone", "full")
    assert scores.depths == ("exact", "arkit")
    assert (len(scores.sequences), scores.rooms) == (4, 2)
    for method in scores.methods:
        for depth in scores.depths:
            mean = scores.mean(method, depth, "log_l2")
            assert 0 < mean.low <= mean.mean <= mean.high


def test_a_score_is_the_mean_of_the_metric_over_the_probes(evaluated):
    scores, _ = evaluated
    recording = Boxes(4, height=120).read(1, frames=[0])
    baseline = MeanColour()
    baseline.push(first_frame(recording, "exact"))
    expected = np.mean([log_l2(baseline.light_at((0.0, 0.0, 0.0)), truth) for truth in recording.probe_panoramas])
    assert scores.sequences[1].values["mean colour"]["exact"][0] == pytest.approx(expected, rel=1e-5)


def test_arkit_depth_is_seeded_by_the_sequences_name():
    recording = Boxes(2).read(0, frames=[0])
    once, again = first_frame(recording, "arkit"), first_frame(recording, "arkit")
    np.testing.assert_array_equal(once.depth_m, again.depth_m)
    other = first_frame(replace(recording, name="another"), "arkit")
    assert not np.array_equal(once.depth_m, other.depth_m)
    np.testing.assert_array_equal(first_frame(recording, "exact").depth_m, recording.depth_mm[0] / np.float32(1000))


def test_intervals_are_over_rooms_not_sequences():
    """Ten walks through two rooms hold no more information than two: the interval must not shrink."""
    pairs = [(1.0, 1.0), (3.0, 3.0)]
    repeated = {"full": [pair for pair in pairs for _ in range(5)]}
    few = scores_of({"full": pairs}, ["a", "b"]).mean("full", "exact", "log_l2")
    many = scores_of(repeated, ["a"] * 5 + ["b"] * 5).mean("full", "exact", "log_l2")
    assert few.mean == many.mean == 2.0
    assert (few.low, few.high) == (many.low, many.high) == (1.0, 3.0)
    one = scores_of({"full": [(1.0, 2.0)]}, ["a"]).mean("full", "exact", "render_l2")
    assert one.mean == 2.0
    assert np.isnan(one.low)


def test_ratios_are_paired():
    """The means differ widely between rooms, the ratio does not: its interval has no width."""
    rooms = [f"r{k}" for k in range(8)]
    alone = [(10.0**k, 1.0) for k in range(8)]
    scores = scores_of({"SGLV alone": alone, "full": [(0.9 * a, b) for a, b in alone]}, rooms)
    blended = scores.ratios()[0]
    assert "paper 0.947" in blended.title
    assert (blended.value.mean, blended.value.low, blended.value.high) == pytest.approx((0.9, 0.9, 0.9))
    assert blended.holds
    assert scores.ratios()[1].holds is False  # 1.0 on rendering


def test_networks_are_compared_with_the_best_baseline():
    values = {"mean colour": [(3.0, 1.0)] * 2, "classical": [(2.0, 4.0)] * 2, "full": [(1.0, 1.0)] * 2}
    titles = {ratio.title: ratio for ratio in scores_of(values, ["a", "b"]).ratios()}
    assert titles["full / classical, the best baseline, log-L2"].value.mean == 0.5
    assert titles["full / classical, the best baseline, log-L2"].holds
    assert titles["full / mean colour, the best baseline, rendering loss"].limit is None


def test_ablations_are_compared_by_their_names():
    values = {"full": [(1.0, 0.9)], "rgb-alpha": [(1.0, 1.0)], "no-rendering-loss": [(1.0, 1.2)]}
    titles = [ratio.title for ratio in scores_of(values, ["a"]).ratios()]
    assert any("RGB-alpha" in title and "rendering loss" in title for title in titles)
    assert "with / without rendering loss, rendering loss" in titles


def test_tables_json_and_markdown_say_the_same(evaluated):
    scores, _ = evaluated
    console = Console(width=60)
    with console.capture() as shown:
        for table in dataset_tables(scores):
            print_table(console, table)
    text = markdown(dataset_tables(scores))
    plain = json.loads(json.dumps(scores.to_json()))
    assert plain["rooms"] == 2
    assert len(plain["sequences"]) == 4
    for entry in plain["summary"]:
        factor = 10 if entry["metric"] == "log_l2" else 100
        assert f"{entry['mean'] * factor:.3g} (" in text
        assert f"{entry['mean'] * factor:.3g} (" in shown.get()
    for ratio in plain["ratios"]:
        assert ratio["title"] in text
        assert ratio["title"] in shown.get()


def test_the_picture_has_a_column_per_method(evaluated, tmp_path):
    _, rows = evaluated
    assert [row.name for row in rows] == ["box-0", "box-2"]
    assert list(rows[0].panoramas) == ["truth", "mean colour", "warp and fill", "classical", "SGLV alone", "full"]
    one, two = compose_picture(rows[:1]), compose_picture(rows)
    assert one.shape[1] == two.shape[1] > 7 * 240
    assert two.shape[0] > 1.5 * one.shape[0]
    write_picture(tmp_path / "picture.png", rows)
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="at least one row"):
        compose_picture([])


def test_limit_spreads_the_scored_sequences_evenly():
    scores, rows = evaluate_dataset(Boxes(4, height=16), [BaselineMethod(MeanColour)], depths=["exact"], limit=2)
    assert [one.name for one in scores.sequences] == ["box-0", "box-2"]
    assert rows == []


def test_frames_without_depth_are_skipped_and_named():
    class Blind(Boxes):
        def read(self, index, *, frames):
            recording = super().read(index, frames=frames)
            return recording if index else replace(recording, depth_mm=np.zeros_like(recording.depth_mm))

    classical = EngineMethod("classical", SessionOptions(model="classical"), None)
    scores, _ = evaluate_dataset(Blind(2, height=120), [classical], depths=["exact"])
    assert len(scores.sequences) == 1
    assert scores.skipped[0].startswith("box-0: ")
    with pytest.raises(DatasetError, match="no sequence can be used"):
        evaluate_dataset(Blind(1), [classical], depths=["exact"])


def test_an_empty_dataset_and_equal_names_are_refused():
    with pytest.raises(DatasetError, match="no finished sequence"):
        evaluate_dataset(Boxes(0), [BaselineMethod(MeanColour)])
    with pytest.raises(OptionError, match="different names"):
        evaluate_dataset(Boxes(1), [BaselineMethod(MeanColour), BaselineMethod(MeanColour)])


def test_an_invalid_panorama_is_refused_and_the_method_named():
    class Broken:
        names = ("broken",)

        def light(self, frame, positions):  # noqa: ARG002  (named as in the protocol)
            return {"broken": [np.full((120, 240, 3), np.nan, np.float32) for _ in positions]}

    with pytest.raises(ModelError, match="broken: returned an invalid panorama for box-0"):
        evaluate_dataset(Boxes(1), [Broken()], depths=["exact"])


@pytest.mark.parametrize(
    ("also", "message"), [("rgb-alpha", "NAME=DIR"), ("=there", "NAME=DIR"), ("full=there", "scored in any")]
)
def test_a_malformed_also_option_is_a_usage_error(tmp_path, also, message):
    result = CliRunner().invoke(app, ["eval", "dataset", str(tmp_path), "--also", also])
    assert result.exit_code == 2
    assert message in result.output
