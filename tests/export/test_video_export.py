"""A video model: exported, imported again, and run by the engine as it is trained."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from export_models import CONFIG, SHAPE

from roomlight.engine.networks.units import mean_colour
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session, SessionOptions
from roomlight_export.importing import load_exported
from roomlight_export.inputs import room_volume
from roomlight_model import volume_networks
from roomlight_model.networks import VideoModel
from roomlight_model.training.examples import Example
from roomlight_model.training.sequences import WalkExample
from roomlight_model.training.video import Unroll
from tiny_stages import WALKS, box_example, walk_batch

FRAMES, HEIGHT = 5, CONFIG.blend.height


def walk():
    """Five unclipped frames whose mean colour changes by less than a stop, in the engine's working size."""
    example = box_example(frames=(0, 4, 8, 12, 16))
    resized = [frame.resized(*WORKING_SIZE) for frame in (example.frame, *example.later)]
    frames = [
        replace(frame, index=k, image=frame.image * np.float32(0.6 - 0.06 * k), clipped=np.zeros_like(frame.clipped))
        for k, frame in enumerate(resized)
    ]
    example = Example(
        frames[0], frames[0].depth_m, example.positions, example.truth, later=tuple(frames[1:])
    )  # fmt: skip
    return WalkExample(example, example.truth[None], np.zeros(FRAMES, np.int64))


@pytest.mark.slow
@pytest.mark.parametrize("exported", ["video"], indirect=True)
def test_the_engine_shows_the_panoramas_of_the_training_forward(exported):
    folder = exported.folder
    model = load_exported(folder).model  # weights rounded to half precision, as in the graphs
    assert isinstance(model, VideoModel)
    sequence = walk()
    batch = walk_batch(sequence, height=HEIGHT, shape=SHAPE)
    options = replace(WALKS, model=model.config)
    session = Session(SessionOptions(model="video", weights=folder, provider="cpu", height=HEIGHT, hedge=0.0))
    handles = [session.track(tuple(position)) for position in sequence.example.positions.tolist()]
    with torch.no_grad():
        unroll = Unroll(model, batch, options, generator=torch.Generator().manual_seed(0))
        for number, frame in enumerate(sequence.frames):
            if number:
                unroll.advance(number)
            session.push(frame)
            assert session.sglv is not None
            assert session.grid is not None
            # order of summation, under an exponent: 1e-4 to 1e-3 of the light
            np.testing.assert_allclose(session.sglv.alpha, unroll.volume_state.volume.alpha[0].numpy(), atol=1e-3)
            panoramas = unroll.panoramas()[0].permute(0, 2, 3, 1).numpy()
            for handle, expected in zip(handles, panoramas, strict=True):
                difference = np.abs(np.log1p(session.light(handle).reflection) - np.log1p(expected))
                # a pixel at the threshold of the conservative rule may fall on either side
                assert np.quantile(difference, 0.995) < 2e-3
                assert difference.mean() < 3e-4


def test_mean_colour_equals_its_twin():
    volume = room_volume(SHAPE, frame=3)
    expected = volume_networks.mean_colour(torch.from_numpy(volume))[0, :, 0, 0, 0].numpy()
    np.testing.assert_allclose(mean_colour(volume[0]), expected, rtol=1e-4)
    empty = np.zeros((5, *SHAPE), np.float32)
    np.testing.assert_allclose(mean_colour(empty), 0.3, rtol=1e-6)
