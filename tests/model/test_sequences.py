"""Training sequences: cuts and strides, augmentation, and agreement with what the engine sees."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from roomlight_model.training.sequences import PreparedWalk, collate_walks, draw_frames, draw_length, with_views
from tiny_stages import SHAPE, box_walk, dimmed, unclipped, walk_batch


def test_frames_keep_their_order_and_one_stride():
    rng = np.random.default_rng(0)
    strides, starts = set(), set()
    for _ in range(300):
        numbers = draw_frames(31, 8, rng)
        assert len(numbers) == 8
        assert numbers[0] >= 0
        assert numbers[-1] <= 30
        assert len(set(np.diff(numbers))) == 1
        strides.add(numbers[1] - numbers[0])
        starts.add(numbers[0])
    assert strides == {1, 2, 3, 4}
    assert len(starts) > 15
    assert draw_frames(31, 31, rng) == list(range(31))
    assert draw_frames(5, 1, rng)[0] < 5


def test_a_walk_that_is_too_short_is_refused():
    with pytest.raises(ValueError, match="a walk of 3 frames has no 4"):
        draw_frames(3, 4, np.random.default_rng(0))


def test_pasts_are_short_and_long():
    rng = np.random.default_rng(0)
    lengths = np.array([draw_length(31, rng) for _ in range(2000)])
    assert lengths.min() == 2
    assert lengths.max() == 31
    assert 0.2 < (lengths == 31).mean() < 0.35
    assert 0.2 < (lengths <= 5).mean() < 0.45


def test_all_frames_of_a_sequence_show_the_lit_room_of_its_truth():
    """Augmentation is the same in every frame and in the truth: each frame's view from a probe equals the truth."""
    rng = np.random.default_rng(5)
    for _ in range(3):
        batch = walk_batch(box_walk(rng), height=60)
        assert batch.detail is not None
        assert batch.mask is not None
        truth = torch.stack([batch.truth(frame) for frame in range(batch.frames)], dim=1)
        seen = (batch.mask.expand_as(truth) > 0) & (batch.detail < 0.95)
        assert seen.any()
        assert (batch.detail[seen] - truth[seen]).abs().median() < 0.03


def test_a_mirrored_sequence_has_mirrored_volumes():
    plain = box_walk(np.random.default_rng(0), augment=False)
    mirrored = replace(plain, example=replace(plain.example, mirrored=True))
    one, other = (walk_batch(walk, height=None).volume for walk in (plain, mirrored))
    assert one.flip(-1).equal(other)


def test_the_light_of_a_sequence_may_change_at_a_frame():
    plain = walk_batch(box_walk(np.random.default_rng(1), change_light=unclipped), height=60)
    batch = walk_batch(box_walk(np.random.default_rng(1), change_light=dimmed), height=60)
    assert batch.light_of.tolist() == [[0, 0, 1, 1]]
    for frame, share in enumerate((1, 1, 0.5, 0.5)):
        torch.testing.assert_close(batch.truth(frame), plain.truth(frame) * share)
        assert batch.detail is not None
        assert plain.detail is not None
        torch.testing.assert_close(batch.detail[:, frame], plain.detail[:, frame] * share)


def test_batches_of_sequences_split_into_pieces():
    prepared = [PreparedWalk.of(box_walk(np.random.default_rng(k)), SHAPE) for k in range(3)]
    batch = with_views(collate_walks(prepared, panorama_height=16), prepared, panorama_height=16)
    pieces = batch.pieces(1)
    assert len(pieces) == 3
    assert pieces[2].volume.equal(batch.volume[2:])
    assert pieces[1].truth(0).equal(batch.truth(0)[1:2])
