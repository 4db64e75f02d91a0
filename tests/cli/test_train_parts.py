"""`roomlight train --stage clipping`, `completion` and `objects`, their export, and a session that uses them."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_runner import RunCommand

import lamp_rooms
import stub_rooms
from roomlight.captures import open_capture
from roomlight.compositing.light.object_light import object_light
from roomlight.dataset.loader import Dataset
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import DatasetError
from roomlight.sample import sample_capture
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_model.part_checkpoint import load_part_checkpoint
from roomlight_model.training.clipping_examples import ClippingFrames
from roomlight_model.training.completion_examples import CompletionExamples, _reduced

SHORT = ("--batch", 2, "--every", 1)


def dataset(folder: Path, *, sequences: int = 6, renderer: str = lamp_rooms.NAME) -> Path:
    options = GenerateOptions(
        seed=3, sequences=sequences, shard_size=4, sequences_per_room=2, frames=3, renderer=renderer
    )
    generate(folder, options, workers=1)
    return folder


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dataset(tmp_path_factory.mktemp("rooms") / "data")


def test_the_stages_train_export_and_run(data: Path, tmp_path: Path, roomlight: RunCommand) -> None:
    for stage in ("clipping", "completion", "objects"):
        run = f"run-{stage}"
        trained = roomlight("train", data, "--out", run, "--stage", stage, "--steps", 2, *SHORT, cwd=tmp_path)
        assert trained.code == 0, trained.err
        assert "2 of 2 steps" in trained.out
        assert "held out: loss" in trained.err
        card = load_part_checkpoint(tmp_path / run / "best.pt").card
        assert card["data"] == [{"seed": 3, "frames": 3, "sequences": 6}]
        exported = roomlight("export", f"{run}/best.pt", "--out", f"parts/{stage}", cwd=tmp_path)
        assert exported.code == 0, exported.err
        assert f"{stage} model" in exported.out
    session = Session(SessionOptions(parts=tmp_path / "parts", provider="cpu", height=32))
    session.push(next(iter(open_capture(sample_capture()))))
    light = session.light_at((0.0, 0.0, -0.5))
    assert np.isfinite(light.panorama).all()
    assert light.panorama.max() > 0
    lit = object_light(session, session.track((0.0, 0.0, -0.5)))
    assert np.isfinite(lit.shown).all()
    assert np.isfinite(lit.casting).all()


def test_a_run_continues_and_refuses_other_options(data: Path, tmp_path: Path, roomlight: RunCommand) -> None:
    command = ("train", data, "--out", "run", "--stage", "clipping", *SHORT)
    assert roomlight(*command, "--steps", 1, cwd=tmp_path).code == 0
    assert "2 of 2 steps" in roomlight(*command, "--steps", 2, cwd=tmp_path).out
    refused = roomlight(*command, "--steps", 2, "--seed", 9, cwd=tmp_path)
    assert refused.code == 1
    assert "other options (seed)" in refused.err
    out_of_range = roomlight(*command, "--steps", 2, "--learning-rate", 0, cwd=tmp_path)
    assert "learning_rate 0.0" in out_of_range.err
    assert len((tmp_path / "run" / "log.jsonl").read_text().splitlines()) == 2


def test_recordings_without_the_truth_are_refused(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "data", sequences=2, renderer=stub_rooms.NAME)
    with pytest.raises(DatasetError, match="no sequence holds the radiance of clipped pixels"):
        ClippingFrames.read([Dataset(folder, "train")], seed=0)


def test_frames_hold_the_true_radiance(data: Path) -> None:
    seen: list[tuple[int, int]] = []
    frames = ClippingFrames.read([Dataset(data, "train")], seed=0, progress=lambda *state: seen.append(state))
    assert seen[-1] == (6, 6)
    assert len(frames) == 6
    assert frames.radiance.max() == pytest.approx(lamp_rooms.LAMP)
    assert (frames.radiance >= 2).any(axis=1).mean() == pytest.approx(0.75 * 80 / 768, rel=0.3)  # the lamp's area
    again = ClippingFrames.read([Dataset(data, "train")], seed=0)
    assert np.array_equal(again.geometry, frames.geometry)


def test_streams_hold_what_was_seen_and_the_truth(data: Path) -> None:
    dataset = Dataset(data, "train")
    examples = CompletionExamples.read([dataset], seed=0, streams_each=1)
    assert len(examples) >= 12  # two probes of six recordings, one or two moments
    known = examples.panels[:, 3].astype(np.float32)
    assert 0 < known.mean() < 1
    assert np.isfinite(examples.truth).all()


@pytest.mark.parametrize("rows", [60, 90, 120, 240])
def test_reduced_truth_keeps_the_energy(rows: int) -> None:
    """A small lamp too, and at heights that are no multiple of the network's."""
    truth = np.full((rows, 2 * rows, 3), np.float32(0.25))
    truth[rows - 8, 2 * rows - 5] = 400.0
    reduced = _reduced(truth)
    assert reduced.shape == (3, 60, 120)
    assert reduced.astype(np.float32).mean() == pytest.approx(float(truth.mean()), rel=2e-3)  # half precision


def test_the_ship_rule_compares_and_decides(tmp_path: Path, roomlight: RunCommand) -> None:
    """The reference against itself: no interval is worse, but nothing is gained."""
    options = ("--ship-rule", "--model", "classical", "--max-frames", 2, "--json", "s.json")
    result = roomlight("eval", sample_capture(), *options, cwd=tmp_path)
    assert result.code == 1, result.err
    assert "classical against classical" in result.out
    assert "log-L2 is 1.000 of classical's, above 0.85" in result.out
    assert "classical fails: 2 of its figures break the rule" in result.out
    written = json.loads((tmp_path / "s.json").read_text())
    assert [one["overall"] for one in written["ship_rule"]["ratios"]] == [1.0, 1.0]
    assert {track["method"] for track in written["tracks"]} == {"warp and fill", "candidate", "reference"}


def test_a_model_within_the_rule_passes(tmp_path: Path, roomlight: RunCommand, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roomlight_evaluation.captures.ship_rule.TARGET", 1.0)
    options = ("--ship-rule", "--model", "classical", "--max-frames", 1)
    result = roomlight("eval", sample_capture(), *options, cwd=tmp_path)
    assert result.code == 0, result.err
    assert "classical passes: 0 of its figures break the rule" in result.out


@pytest.mark.parametrize("other", [("--late",), ("--main-light",), ("--predictions", ".")])
def test_the_ship_rule_excludes_other_scores(other: tuple[str, ...], tmp_path: Path, roomlight: RunCommand) -> None:
    result = roomlight("eval", sample_capture(), "--ship-rule", *other, cwd=tmp_path)
    assert result.code == 2
    assert "--ship-rule scores tracked probes" in result.err


def test_parts_are_an_option_of_eval(tmp_path: Path, roomlight: RunCommand) -> None:
    result = roomlight("eval", sample_capture(), "--parts", tmp_path / "none", "--max-frames", 1, cwd=tmp_path)
    assert result.code == 1
    assert "none/clipping/model.json: cannot be read" in result.err
