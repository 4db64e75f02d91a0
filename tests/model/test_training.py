"""The trainer: it learns, resumes to the same curve after a kill, and refuses unusable options and folders."""

import json
import math
import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
import torch

from recordings import BoxRecordings
from roomlight.conventions import linear_to_srgb8, panorama_rays, srgb8_to_linear
from roomlight.dataset.recording import GLASS
from roomlight.engine.network_backend import NetworkBackend
from roomlight.engine.session import WORKING_SIZE, Session, SessionOptions
from roomlight.errors import ModelError, OptionError, OutputError
from roomlight_model.checkpoint import load_checkpoint
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel
from roomlight_model.training.batches import collate
from roomlight_model.training.examples import example_of, read_example
from roomlight_model.training.gradients import BatchGradients
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.stages import predict, predicted_panoramas, rendered, stage_losses, trained_modules
from roomlight_model.training.trainer import Trainer
from roomlight_model.training.validation import Validation

TINY = ModelConfig(sg=SGConfig(channels=4, full_channels=4), blend=BlendConfig(channels=4, full_channels=4))
OPTIONS = TrainOptions(
    steps=6, batch=3, warm_up=2, rays=64, sphere_pixels=4, sphere_samples=4, volume_shape=(16, 15, 21),
    panorama_height=16, bf16=False, model=TINY,
)  # fmt: skip
CPU = torch.device("cpu")


def quiet(_):
    return None


def curve(folder):
    return [json.loads(line)["loss"] for line in (folder / "log.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("stage", ["single-sglv", "single-blend", "single-joint"])
def test_a_stage_changes_only_its_own_networks(tmp_path, stage):
    trainer = Trainer(replace(OPTIONS, stage=stage, steps=3), BoxRecordings(3), tmp_path / "run", device=CPU)
    before = {name: value.clone() for name, value in trainer.model.state_dict().items()}
    trainer.train(report=quiet)
    moved = {name.split(".")[0] for name, value in trainer.model.state_dict().items() if not value.equal(before[name])}
    wanted = {id(module) for module in trained_modules(trainer.model, stage)}
    assert moved == {name for name, module in trainer.model.named_children() if id(module) in wanted}


def error_on(batch, trainer):
    """Log-L2 of 512 fixed rays."""
    options = replace(trainer.options, rays=512)
    with torch.no_grad():
        sglv = predict(trainer.model, batch, options, device=CPU)
        generator = torch.Generator().manual_seed(1)
        losses = stage_losses(trainer.model, sglv, batch, options, generator=generator, device=CPU)
    return float(losses.log_l2)


def test_it_learns_two_rooms(tmp_path):
    """The error on fixed rays falls to 0.60 to 0.71 of its start over seeds 0 to 4; half of that fall must be met."""
    options = replace(OPTIONS, steps=20, batch=2, learning_rate=1e-2, augment=False, depth="exact", rays=128)
    recordings = BoxRecordings(2)
    trainer = Trainer(options, recordings, tmp_path / "run", device=CPU)
    examples = [example_of(recordings.read(k, frames=[0]), np.random.default_rng(0), depth="exact") for k in range(2)]
    batch = collate(examples, volume_shape=options.volume_shape, panorama_height=None)
    before = error_on(batch, trainer)
    trainer.train(report=quiet)
    assert error_on(batch, trainer) < 0.85 * before


def test_the_checkpoint_is_the_averaged_model_with_its_card(tmp_path):
    trainer = Trainer(OPTIONS, BoxRecordings(3), tmp_path / "run", device=CPU)
    trainer.train(report=quiet)
    loaded = load_checkpoint(tmp_path / "run" / "model.pt")
    assert loaded.card["steps"] == 6
    assert loaded.card["stage"] == "single-sglv"
    assert loaded.card["sequences"] == 3
    for name, value in loaded.model.state_dict().items():
        torch.testing.assert_close(value, trainer.average[name])


def test_a_stopped_run_goes_on_to_the_same_weights(tmp_path):
    whole = Trainer(OPTIONS, BoxRecordings(3), tmp_path / "whole", device=CPU)
    whole.train(report=quiet)
    first = Trainer(OPTIONS, BoxRecordings(3), tmp_path / "parts", device=CPU)
    first.train(report=quiet, stop=lambda: first.step >= 2)
    second = Trainer(OPTIONS, BoxRecordings(3), tmp_path / "parts", device=CPU)
    assert second.step == 2
    second.train(report=quiet)
    for name, value in whole.model.state_dict().items():
        torch.testing.assert_close(second.model.state_dict()[name], value, rtol=0, atol=0)


SCRIPT = textwrap.dedent("""
    import sys
    from pathlib import Path
    import test_training as t
    from dataclasses import replace

    def print_step(trainer):
        print(trainer.step, flush=True)
        if trainer.step == 6:
            sys.stdin.readline()  # wait here to be killed

    trainer = t.Trainer(replace(t.OPTIONS, steps=9), t.BoxRecordings(3), Path(sys.argv[1]), device=t.CPU)
    trainer.train(report=t.quiet, every=print_step, every_steps=3, checkpoint_s=0.0)
""")


@pytest.mark.slow
def test_a_killed_run_repeats_the_curve_of_a_whole_one(tmp_path):
    options = replace(OPTIONS, steps=9)
    Trainer(options, BoxRecordings(3), tmp_path / "whole", device=CPU).train(report=quiet)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(tmp_path / "killed")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    with process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.strip() == "6":
                process.send_signal(signal.SIGKILL)
                break
    assert process.returncode == -signal.SIGKILL
    resumed = Trainer(options, BoxRecordings(3), tmp_path / "killed", device=CPU)
    assert 0 < resumed.step <= 6
    resumed.train(report=quiet)
    assert curve(tmp_path / "killed") == curve(tmp_path / "whole")


def test_a_mirrored_example_is_the_mirrored_room():
    """The mirrored volume gives the same light along mirrored rays."""
    recordings = BoxRecordings(1)
    plain = example_of(recordings.read(0, frames=[0]), np.random.default_rng(0), depth="exact")
    batch = collate([plain, replace(plain, mirrored=True)], volume_shape=(16, 15, 21), panorama_height=None)
    assert batch.volume[0].flip(-1).equal(batch.volume[1])
    torch.manual_seed(0)
    sglv = SingleModel(TINY)(batch.volume)
    # lobes and alpha of the mirrored volume are those of the plain one, mirrored
    sglv = sglv._replace(
        alpha=torch.stack([sglv.alpha[0], sglv.alpha[0].flip(-1)]),
        lobes=torch.stack([sglv.lobes[0], sglv.lobes[0].flip(-2) * torch.tensor([1.0] * 7 + [-1, 1, 1])]),
    )
    rays = torch.from_numpy(panorama_rays(8).copy()).expand(2, batch.origins.shape[1], -1, 3)
    light = rendered(sglv, batch, rays)
    torch.testing.assert_close(light[0], light[1], rtol=1e-3, atol=1e-4)


def test_truth_and_image_agree_in_units_and_place():
    """The frame's mesh rendered at a probe equals the truth: poses, units and mirroring agree."""
    example = example_of(BoxRecordings(1).read(0, frames=[0]), np.random.default_rng(0), depth="exact")
    batch = collate([example], volume_shape=(16, 15, 21), panorama_height=60)
    assert batch.partial is not None
    assert batch.mask is not None
    assert batch.before is not None
    assert batch.kept is not None
    seen = batch.mask.expand_as(batch.truth) > 0
    assert seen.float().mean() > 0.05
    assert (batch.partial[seen] - batch.truth[seen]).abs().median() < 0.02


def test_augmented_image_and_truth_show_one_room():
    """Contrast, gains, swapped channels and mirroring apply to both; white pixels stay white."""
    rng = np.random.default_rng(2)
    brightness = set()
    for _ in range(12):
        example = read_example(BoxRecordings(1), 0, rng, depth="exact", augment=True)
        batch = collate([example], volume_shape=(16, 15, 21), panorama_height=60)
        assert batch.partial is not None
        assert batch.mask is not None
        assert batch.before is not None
        assert batch.kept is not None
        seen = (batch.mask.expand_as(batch.truth) > 0) & (batch.partial < 0.95)
        assert (batch.partial[seen] - batch.truth[seen]).abs().median() < 0.03
        brightness.add(round(float(example.frame.image.mean()), 3))
    assert len(brightness) > 6


def test_examples_follow_their_generator_and_frames_vary():
    recordings = BoxRecordings(4)

    def draw(seed):
        rng = np.random.default_rng(seed)
        return [read_example(recordings, 0, rng, depth="both", augment=True) for _ in range(12)]

    once, again = draw(5), draw(5)
    for a, b in zip(once, again, strict=True):
        np.testing.assert_array_equal(a.frame.image, b.frame.image)
        np.testing.assert_array_equal(a.frame.depth_m, b.frame.depth_m)
        np.testing.assert_array_equal(a.truth, b.truth)
        assert a.mirrored == b.mirrored
    assert len({example.frame.camera_to_world.tobytes() for example in once}) > 1
    assert len({example.mirrored for example in once}) == 2


def test_exact_depth_has_holes_only_at_panes():
    whole = BoxRecordings(1).read(0, frames=[0])
    pane = np.zeros(whole.depth_mm.shape, np.uint8)
    pane[:, 5:20, 10:30] = GLASS
    recording = replace(whole, surface=pane)
    known = set()
    for seed in range(24):
        measured = example_of(recording, np.random.default_rng(seed), depth="both").frame.depth_m
        if measured.shape != pane[0].shape:  # phone-like
            continue
        assert (measured[pane[0] != GLASS] > 0).all()
        known.add(bool((measured[pane[0] == GLASS] > 0).all()))
        assert len(np.unique(measured[pane[0] == GLASS] > 0)) == 1
    assert known == {True, False}
    assert (example_of(recording, np.random.default_rng(0), depth="exact").frame.depth_m > 0).all()


def test_losses_are_finite_in_bf16_too():
    batch = collate(
        [example_of(BoxRecordings(1).read(0, frames=[0]), np.random.default_rng(0), depth="arkit")],
        volume_shape=(16, 15, 21), panorama_height=16,
    )  # fmt: skip
    for stage in ("single-sglv", "single-joint"):
        options = replace(OPTIONS, stage=stage, bf16=True)
        model, generator = SingleModel(TINY), torch.Generator().manual_seed(0)
        sglv = predict(model, batch, options, device=CPU)
        losses = stage_losses(model, sglv, batch, options, generator=generator, device=CPU)
        total, log_l2, rendering, _ = (float(part.detach()) for part in losses)
        assert math.isfinite(total)
        assert total == pytest.approx(log_l2 + 0.3 * rendering, rel=1e-5)


def test_pieces_of_a_batch_add_up_to_its_gradient():
    """Pieces run on threads and differ in size; gradients have the parameters' strides, for the fused optimiser."""
    options = replace(OPTIONS, stage="single-joint", rendering_weight=0.0)  # its directions are each piece's own
    recordings = BoxRecordings(3)
    batch = collate(
        [read_example(recordings, k, np.random.default_rng(k), depth="exact", augment=False) for k in range(3)],
        volume_shape=options.volume_shape, panorama_height=options.panorama_height,
    )  # fmt: skip
    model = SingleModel(TINY)
    model.sg_encoder.to(memory_format=torch.channels_last_3d)
    parameters = list(model.parameters())
    losses = BatchGradients(model, parameters, options, device=CPU).of(batch, 0)
    pieces = [parameter.grad for parameter in parameters]
    model.zero_grad(set_to_none=True)
    sglv = predict(model, batch, options, device=CPU)
    whole = stage_losses(model, sglv, batch, options, generator=torch.Generator().manual_seed(0), device=CPU)
    whole.total.backward()
    torch.testing.assert_close(losses.total, whole.total.detach())
    for parameter, gradient in zip(parameters, pieces, strict=True):
        assert gradient is not None
        assert gradient.stride() == parameter.stride()
        torch.testing.assert_close(gradient, parameter.grad, rtol=1e-3, atol=1e-6)


def test_blending_needs_partial_panoramas():
    example = example_of(BoxRecordings(1).read(0, frames=[0]), np.random.default_rng(0), depth="exact")
    batch = collate([example], volume_shape=(16, 15, 21), panorama_height=None)
    model = SingleModel(TINY)
    with pytest.raises(ValueError, match="panorama_height"):
        predicted_panoramas(model, model(batch.volume), batch, bf16=False, device=CPU)


def test_a_folder_of_other_options_is_refused_by_name(tmp_path):
    Trainer(OPTIONS, BoxRecordings(3), tmp_path / "run", device=CPU)
    with pytest.raises(ModelError, match=r"other options \(learning_rate, seed\)"):
        Trainer(replace(OPTIONS, seed=1, learning_rate=0.1), BoxRecordings(3), tmp_path / "run", device=CPU)


def test_a_finished_run_can_be_extended(tmp_path):
    Trainer(OPTIONS, BoxRecordings(3), tmp_path / "run", device=CPU).train(report=quiet)
    longer = Trainer(replace(OPTIONS, steps=8), BoxRecordings(3), tmp_path / "run", device=CPU)
    longer.train(report=quiet)
    assert longer.step == 8
    assert TrainOptions.read(tmp_path / "run" / "options.json").steps == 8


def test_checkpoints_store_the_sizes_of_training(tmp_path):
    """Opacity is per voxel: a graph of another resolution would show another room."""
    trainer = Trainer(replace(OPTIONS, steps=1), BoxRecordings(3), tmp_path / "run", device=CPU)
    trainer.train(report=quiet)
    config = load_checkpoint(tmp_path / "run" / "model.pt").config
    assert config.sg.volume_shape == OPTIONS.volume_shape
    assert config.blend.height == OPTIONS.panorama_height


def test_only_a_better_score_replaces_the_best(tmp_path):
    trainer = Trainer(OPTIONS, BoxRecordings(3), tmp_path / "run", device=CPU)
    assert trainer.keep_scored(0.5)
    assert not trainer.keep_scored(0.6, {"log_l2_blended": 0.6})
    assert load_checkpoint(tmp_path / "run" / "model.pt").card["scores"] == {"log_l2_blended": 0.6}
    assert trainer.keep_scored(0.4)
    assert load_checkpoint(tmp_path / "run" / "best.pt").card["held_out"] == 0.4


def test_a_foreign_folder_is_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(OutputError, match="other files"):
        Trainer(OPTIONS, BoxRecordings(3), tmp_path, device=CPU)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_broken_checkpoint_is_named(tmp_path):
    Trainer(OPTIONS, BoxRecordings(3), tmp_path / "run", device=CPU)
    (tmp_path / "run" / "last.pt").write_bytes(b"torn")
    with pytest.raises(ModelError, match=r"last\.pt.*delete it to start again"):
        Trainer(OPTIONS, BoxRecordings(3), tmp_path / "run", device=CPU)


def test_too_few_sequences_are_refused(tmp_path):
    with pytest.raises(ModelError, match="1 sequences are fewer than a batch of 3"):
        Trainer(OPTIONS, BoxRecordings(1), tmp_path / "run", device=CPU)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps is 0; it must be 1 or more"),
        ({"batch": 0}, "batch is 0; it must be 1 or more"),
        ({"rays": 7}, "rays is 7; it must be 8 or more"),
        ({"frames": 0}, "frames is 0; it must be 1 or more"),
        ({"held_out": -1}, "held_out is -1; it must be 0 or more"),
        ({"sphere_pixels": -1}, "sphere_pixels is -1; it must be 0 or more"),
        ({"sphere_samples": 1}, "sphere_samples is 1; it must be 2 or more"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0; it must be between 0 and 1"),
        ({"surround_max": -0.1}, "surround_max is -0.1; it must be between 0 and 100"),
        ({"volume_shape": (4, 30, 42)}, "volume_shape"),
        ({"panorama_height": 61}, "panorama_height is 61; it must be even and 8 or more"),
        ({"panorama_height": 9}, "panorama_height is 9; it must be even and 8 or more"),
    ],
)
def test_options_out_of_range_are_refused(changes, message):
    with pytest.raises(OptionError, match=message):
        replace(OPTIONS, **changes)


def test_options_survive_json(tmp_path):
    path = tmp_path / "options.json"
    path.write_text(json.dumps(OPTIONS.to_dict()))
    assert TrainOptions.read(path) == OPTIONS
    path.write_text("[1]")
    with pytest.raises(ModelError, match="not the options"):
        TrainOptions.read(path)
    for values, named in (
        ({"colour": "red"}, "colour"),
        ({"steps": "many"}, "steps"),
        ({"batch": 0}, "batch is 0"),
        ({"stage": "double"}, "stage"),
        ({"model": {"sg": {"depth": 3}}}, r"model\.sg\.depth"),
    ):
        path.write_text(json.dumps(values))
        with pytest.raises(ModelError, match=rf"options\.json: .*{named}"):
            TrainOptions.read(path)


def test_several_frames_are_fused_as_in_the_serving_engine():
    """The volume equals the engine's buffer after the same frames, and the seen pixels equal its probes'."""
    recording = BoxRecordings(1).read(0, frames=[0, 8, 16])
    example = example_of(recording, np.random.default_rng(0), depth="exact")
    session = Session(SessionOptions(model="single", height=60))
    handles = [session.track(tuple(position)) for position in example.positions.tolist()]
    frames = [example.completed, *example.later]
    for frame in frames:
        session.push(frame)
    resized = [replace(frame.resized(*WORKING_SIZE), index=k) for k, frame in enumerate(frames)]
    whole = replace(example, frame=resized[0], depth_m=resized[0].depth_m, later=tuple(resized[1:]))
    assert session.grid is not None
    batch = collate([whole], volume_shape=session.grid.shape, panorama_height=60)
    assert batch.partial is not None
    assert batch.mask is not None
    assert batch.before is not None
    assert batch.kept is not None
    np.testing.assert_allclose(batch.lower_m[0], session.grid.lower_m, atol=1e-6)
    assert isinstance(session._backend, NetworkBackend)
    np.testing.assert_array_equal(batch.volume[0].numpy(), session._backend._volume)
    seen = ((batch.mask > 0) | (batch.kept > 0))[0, :, 0].numpy()
    for handle, mask in zip(handles, seen, strict=True):
        np.testing.assert_array_equal(mask, session.light(handle).observed > 0)
    assert (batch.kept > 0).any()
    assert ((batch.kept > 0) & ~(batch.mask > 0)).any()


def test_detail_of_earlier_frames_stays_without_gradient():
    recording = BoxRecordings(1).read(0, frames=[0, 16])
    example = example_of(recording, np.random.default_rng(0), depth="exact")
    batch = collate([example], volume_shape=(16, 15, 21), panorama_height=24)
    assert batch.partial is not None
    assert batch.mask is not None
    assert batch.before is not None
    assert batch.kept is not None
    model = SingleModel(TINY)
    _, blended = predicted_panoramas(model, model(batch.volume), batch, bf16=False, device=CPU)
    kept = (batch.kept > 0).expand_as(blended)
    assert blended[kept].equal(batch.before[kept])
    truth = batch.truth[kept]
    assert (blended[kept] - truth).abs().median() < 0.03
    blended[kept].sum().backward()
    assert all(p.grad is None or not p.grad.any() for p in model.parameters())


def test_frames_shown_together_have_one_exposure():
    """Phones change exposure while recording; a wall must be as bright in the third frame as in the first."""
    recording = BoxRecordings(1).read(0, frames=[0, 0])
    twice = replace(recording, exposure=np.array([1.0, 0.5]))
    darker = linear_to_srgb8(srgb8_to_linear(recording.colour[1]) * 0.5)
    twice = replace(twice, colour=np.stack([recording.colour[0], darker]))
    example = example_of(twice, np.random.default_rng(0), depth="exact")
    open_ = ~example.frame.clipped
    np.testing.assert_allclose(example.later[0].image[open_], example.frame.image[open_], atol=0.02)


def test_the_number_of_frames_varies_from_one_to_all():
    recordings = BoxRecordings(1)
    rng = np.random.default_rng(0)
    drawn = [read_example(recordings, 0, rng, depth="both", augment=True, frames=5) for _ in range(40)]
    assert {1 + len(example.later) for example in drawn} == {1, 2, 3, 4, 5}
    assert all(len({frame.depth_m.shape for frame in (one.frame, *one.later)}) == 1 for one in drawn)
    plain = read_example(recordings, 0, rng, depth="exact", augment=False, frames=5)
    assert len(plain.later) == 4
    last = recordings.read(0, frames=[30]).camera_to_world[0]
    np.testing.assert_array_equal(plain.later[-1].camera_to_world, last)


def test_augmented_frames_and_truth_show_one_room():
    rng = np.random.default_rng(4)
    for _ in range(8):
        example = read_example(BoxRecordings(1), 0, rng, depth="exact", augment=True, frames=4)
        batch = collate([example], volume_shape=(16, 15, 21), panorama_height=60)
        assert batch.partial is not None
        assert batch.mask is not None
        assert batch.before is not None
        assert batch.kept is not None
        seen = torch.where(batch.kept > 0, batch.before, batch.partial)
        known = ((batch.mask > 0) | (batch.kept > 0)).expand_as(seen) & (seen < 0.95)
        assert (seen[known] - batch.truth[known]).abs().median() < 0.03


@pytest.mark.slow
def test_a_run_on_walks_repeats_its_curve_and_is_scored(tmp_path):
    options = replace(OPTIONS, stage="single-joint", frames=3, steps=4)
    trainer = Trainer(options, BoxRecordings(3), tmp_path / "whole", device=CPU)
    trainer.train(report=quiet)
    first = Trainer(options, BoxRecordings(3), tmp_path / "parts", device=CPU)
    first.train(report=quiet, stop=lambda: first.step >= 2)
    again = Trainer(options, BoxRecordings(3), tmp_path / "parts", device=CPU)
    again.train(report=quiet)
    assert curve(tmp_path / "parts") == curve(tmp_path / "whole")
    validation = Validation(BoxRecordings(3), [0], options)
    scores = validation.scores(trainer.averaged(), device=CPU)
    assert {"log_l2_blended", "log_l2_blended_walk", "log_l2_sglv_walk"} <= set(scores)
    both = [scores[f"log_l2_{name}"] + 0.3 * scores[f"rendering_{name}"] for name in ("blended", "blended_walk")]
    assert validation.loss(scores) == pytest.approx(np.mean(both))
