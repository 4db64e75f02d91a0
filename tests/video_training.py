"""Options and starting weights that the tests of the video stages share."""

from dataclasses import replace

import numpy as np
import torch

from roomlight_model.checkpoint import Checkpoint
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel
from roomlight_model.training.options import TrainOptions
from roomlight_model.training.sequences import WalkExample

CPU = torch.device("cpu")
SHAPE = (16, 15, 21)
HEIGHT = 16
TINY = ModelConfig(
    sg=SGConfig(volume_shape=SHAPE, channels=4, full_channels=4),
    blend=BlendConfig(height=HEIGHT, channels=4, full_channels=4),
)
OPTIONS = TrainOptions(
    stage="video-joint", steps=4, batch=2, warm_up=1, rays=64, sphere_pixels=4, sphere_samples=4, volume_shape=SHAPE,
    panorama_height=HEIGHT, bf16=False, frames=4, learning_rate=3e-3, model=TINY,
)  # fmt: skip


def single_view_weights(config: ModelConfig = TINY) -> Checkpoint:
    """A single-view model whose weights all differ, as trained ones do."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(7)
        model = SingleModel(config)
        with torch.no_grad():
            for weight in model.parameters():
                weight += 0.02 * torch.randn_like(weight)
    return Checkpoint("single", config, model, {"steps": 5, "stage": "single-joint"})


def unclipped(walk: WalkExample, rng: np.random.Generator) -> WalkExample:
    """Declare every pixel known, so that no estimate of clipped light is added to it."""
    del rng
    frames = [replace(frame, clipped=np.zeros_like(frame.clipped)) for frame in walk.frames]
    return replace(walk, example=replace(walk.example, frame=frames[0], later=tuple(frames[1:])))


def dimmed(walk: WalkExample, rng: np.random.Generator) -> WalkExample:
    """Switch half of the light off from frame 2 on: a light change for tests."""
    walk = unclipped(walk, rng)
    first, *later = walk.frames
    later = [replace(frame, image=frame.image * np.float32(0.5 if k >= 2 else 1)) for k, frame in enumerate(later, 1)]
    return replace(
        walk,
        example=replace(walk.example, frame=first, later=tuple(later)),
        lights=np.concatenate([walk.lights, walk.lights * np.float32(0.5)]),
        light_of=(np.arange(len(walk.frames)) >= 2).astype(np.int64),
    )
