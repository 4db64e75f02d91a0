"""A briefly trained video model: exported, imported again, and run by the engine as it was trained."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from recordings import BoxRecordings
from roomlight.engine.networks.graphs import load_graphs
from roomlight.engine.networks.units import mean_colour
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session, SessionOptions
from roomlight_export.exporting import export_checkpoint
from roomlight_export.importing import load_exported
from roomlight_export.inputs import room_volume
from roomlight_model import volume_networks
from roomlight_model.checkpoint import load_checkpoint
from roomlight_model.networks import VideoModel
from roomlight_model.training.examples import Example, example_of
from roomlight_model.training.loop import Run
from roomlight_model.training.sequences import PreparedWalk, WalkExample, collate_walks, with_views
from roomlight_model.training.video import Unroll
from tiny_stages import HEIGHT, SHAPE, WALKS, video_stage

FRAMES = 5


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """(checkpoint, model folder) after two steps."""
    folder = tmp_path_factory.mktemp("video")
    options = replace(WALKS, steps=2, frames=3, learning_rate=2e-2, ema=0.0)
    Run(video_stage(options, rooms=2), folder / "run").train()
    checkpoint = folder / "run" / "model.pt"
    report = export_checkpoint(checkpoint, folder / "onnx", ort=False)
    assert report.form == "video"
    assert len(report.graphs) == 10
    return checkpoint, folder / "onnx"


def walk():
    """Five unclipped frames whose mean colour changes by less than a stop, in the engine's working size."""
    recording = BoxRecordings(1).read(0, frames=[0, 4, 8, 12, 16])
    example = example_of(recording, np.random.default_rng(0), depth="exact")
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
def test_the_engine_shows_the_panoramas_of_the_training_forward(trained):
    checkpoint, folder = trained
    model = load_exported(folder).model  # weights rounded to half precision, as in the graphs
    assert isinstance(model, VideoModel)
    sequence = walk()
    prepared = [PreparedWalk.of(sequence, SHAPE)]
    batch = with_views(collate_walks(prepared, panorama_height=HEIGHT), prepared, panorama_height=HEIGHT)
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
    assert checkpoint.exists()


@pytest.mark.slow
def test_training_reaches_the_exported_graphs(trained):
    checkpoint, folder = trained
    graphs = load_graphs(folder, provider="cpu")
    assert graphs.form == "video"
    assert graphs.card["stage"] == "video-joint"
    assert graphs.card["steps"] == 2
    assert graphs.card["options"]["frames"] == 3
    assert graphs.card["before"]["steps"] == 5
    again = load_exported(folder)
    kept = load_checkpoint(checkpoint).model.state_dict()
    for name, value in again.model.state_dict().items():
        torch.testing.assert_close(value, kept[name], rtol=1e-3, atol=1e-6)


def test_mean_colour_equals_its_twin():
    volume = room_volume(SHAPE, frame=3)
    expected = volume_networks.mean_colour(torch.from_numpy(volume))[0, :, 0, 0, 0].numpy()
    np.testing.assert_allclose(mean_colour(volume[0]), expected, rtol=1e-4)
    empty = np.zeros((5, *SHAPE), np.float32)
    np.testing.assert_allclose(mean_colour(empty), 0.3, rtol=1e-6)
