"""Examples of single views and their batches: augmentation, depth, agreement with what the engine sees."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from recordings import BoxRecordings
from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight.dataset.recording import GLASS
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session, SessionOptions
from roomlight_model.training.batches import collate
from roomlight_model.training.examples import augmented, example_of, read_example
from roomlight_model.training.light_changes import LightChanges
from roomlight_model.training.sequences import WalkExample
from tiny_stages import box_example, view_batch


def blending_batch(examples, *, height=60) -> Any:
    """A batch with partial panoramas."""
    batch = view_batch(*examples, height=height)
    assert batch.kept is not None
    return batch


def test_truth_and_image_agree_in_units_and_place():
    """The frame's mesh rendered at a probe equals the truth: poses, units and mirroring agree."""
    batch = blending_batch([box_example()])
    seen = batch.mask.expand_as(batch.truth) > 0
    assert seen.float().mean() > 0.05
    assert (batch.partial[seen] - batch.truth[seen]).abs().median() < 0.02


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


def test_several_frames_are_fused_as_in_the_serving_engine():
    """The volume equals the engine's buffer after the same frames, and the seen pixels equal its probes'."""
    example = box_example(frames=(0, 8, 16))
    session = Session(SessionOptions(model="single", height=60))
    handles = [session.track(tuple(position)) for position in example.positions.tolist()]
    frames = [example.completed, *example.later]
    for frame in frames:
        session.push(frame)
    resized = [replace(frame.resized(*WORKING_SIZE), index=k) for k, frame in enumerate(frames)]
    whole = replace(example, frame=resized[0], depth_m=resized[0].depth_m, later=tuple(resized[1:]))
    assert session.grid is not None
    batch: Any = collate([whole], volume_shape=session.grid.shape, panorama_height=60)
    np.testing.assert_allclose(batch.lower_m[0], session.grid.lower_m, atol=1e-6)
    assert session._room is not None
    np.testing.assert_array_equal(batch.volume[0].numpy(), vars(session._room.volume)["_mean"])
    seen = ((batch.mask > 0) | (batch.kept > 0))[0, :, 0].numpy()
    for handle, mask in zip(handles, seen, strict=True):
        np.testing.assert_array_equal(mask, session.light(handle).observed > 0)
    assert (batch.kept > 0).any()
    assert ((batch.kept > 0) & ~(batch.mask > 0)).any()


def test_frames_shown_together_have_one_exposure():
    """Phones change exposure while recording; a wall must be as bright in the third frame as in the first."""
    recording = BoxRecordings(1).read(0, frames=[0, 0])
    twice = replace(recording, exposure=np.array([1.0, 0.5]))
    darker = linear_to_srgb8(srgb8_to_linear(recording.colour[1]) * 0.5)
    twice = replace(twice, colour=np.stack([recording.colour[0], darker]))
    example = example_of(twice, np.random.default_rng(0), depth="exact")
    open_ = ~example.frame.clipped
    np.testing.assert_allclose(example.later[0].image[open_], example.frame.image[open_], atol=0.02)


@pytest.mark.parametrize("change_light", [None, LightChanges(1.0)])
def test_augmented_frames_clip_at_their_own_white(change_light):
    """A grey room, of 0.8 in the first frame's units, seen at other exposures: only where white is below is it cut."""
    exposure = np.array([1.0, 1 / 256, 4.0])
    recording = BoxRecordings(1).read(0, frames=[0, 0, 0])
    grey = linear_to_srgb8(np.ones((3, 48, 64, 3)) * np.minimum(0.8 * exposure, 1)[:, None, None, None])
    example = example_of(replace(recording, colour=grey, exposure=exposure), np.random.default_rng(0), depth="exact")
    for seed in range(12):
        rng = np.random.default_rng(seed)
        one = augmented(example, rng)
        walk = WalkExample(one, one.truth[None], np.zeros(3, np.int64))
        _, dark, bright = (walk if change_light is None else change_light(walk, rng)).frames
        assert not dark.clipped.any()
        assert dark.image.max() > 0.6
        assert bright.clipped.all()
        assert bright.image.max() < 0.31  # 0.25 to the power of 0.85


def test_the_number_of_frames_varies_from_one_to_all():
    recordings = BoxRecordings(1)
    rng = np.random.default_rng(0)
    drawn = [read_example(recordings, 0, rng, depth="both", augment=True, frames=5) for _ in range(24)]
    assert {1 + len(example.later) for example in drawn} == {1, 2, 3, 4, 5}
    assert all(len({frame.depth_m.shape for frame in (one.frame, *one.later)}) == 1 for one in drawn)
    plain = read_example(recordings, 0, rng, depth="exact", augment=False, frames=5)
    assert len(plain.later) == 4
    last = recordings.read(0, frames=[30]).camera_to_world[0]
    np.testing.assert_array_equal(plain.later[-1].camera_to_world, last)


def test_augmented_frames_and_truth_show_one_room():
    rng = np.random.default_rng(4)
    for _ in range(4):
        example = read_example(BoxRecordings(1), 0, rng, depth="exact", augment=True, frames=4)
        batch = blending_batch([example])
        seen = torch.where(batch.kept > 0, batch.before, batch.partial)
        known = ((batch.mask > 0) | (batch.kept > 0)).expand_as(seen) & (seen < 0.95)
        assert (seen[known] - batch.truth[known]).abs().median() < 0.03
