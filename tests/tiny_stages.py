"""Stages of training on small networks and box rooms, and weights to start from."""

import json
from dataclasses import replace
from typing import Literal

import numpy as np
import torch

from recordings import BoxRecordings
from roomlight_model.checkpoint import Checkpoint
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel
from roomlight_model.training.batches import collate
from roomlight_model.training.examples import DepthKind, Example, example_of
from roomlight_model.training.run_folder import RunOptions
from roomlight_model.training.sequences import PreparedWalk, WalkExample, collate_walks, read_walk, with_views
from roomlight_model.training.single_view import SingleViewOptions, SingleViewStage
from roomlight_model.training.video import VideoOptions, VideoStage

CPU = torch.device("cpu")
SHAPE = (16, 15, 21)
HEIGHT = 16
TINY = ModelConfig(
    sg=SGConfig(volume_shape=SHAPE, channels=4, full_channels=4),
    blend=BlendConfig(height=HEIGHT, channels=4, full_channels=4),
)
VIEWS = SingleViewOptions(
    steps=6, batch=3, warm_up=2, rays=64, sphere_pixels=4, sphere_samples=4, volume_shape=SHAPE, panorama_height=HEIGHT,
    bf16=False, model=TINY,
)  # fmt: skip
WALKS = VideoOptions(
    stage="video-joint", steps=4, batch=2, warm_up=1, rays=64, sphere_pixels=4, sphere_samples=4, volume_shape=SHAPE,
    panorama_height=HEIGHT, bf16=False, frames=4, learning_rate=3e-3, model=TINY,
)  # fmt: skip
NO_ROOMS = BoxRecordings(0)


def view_stage(options=VIEWS, *, rooms=3, held_out=NO_ROOMS, start_from=None):
    """A single-view stage on `rooms` box rooms."""
    return SingleViewStage(options, BoxRecordings(rooms), held_out, device=CPU, start_from=start_from)


def video_stage(
    options=WALKS,
    *,
    rooms: int | BoxRecordings = 3,
    held_out=NO_ROOMS,
    start_from: Checkpoint | Literal["single-view"] | None = "single-view",
    change_light=None,
):
    """A video stage on walks through `rooms` box rooms, from `single_view_weights` unless others are given."""
    return VideoStage(
        options,
        rooms if isinstance(rooms, BoxRecordings) else BoxRecordings(rooms),
        held_out,
        device=CPU,
        start_from=single_view_weights() if start_from == "single-view" else start_from,
        change_light=change_light,
    )


def keys_of_batch(stage, monkeypatch):
    """The keys of the random streams of a step's batch, as numpy takes them: without zeros at the end."""
    asked, rng = [], RunOptions.rng
    with monkeypatch.context() as patched:
        patched.setattr(RunOptions, "rng", lambda self, *keys: asked.append(keys) or rng(self, *keys))
        stage.batch(3)
    return [keys[:1] if keys[1:] == (0,) else keys for keys in asked]


def logged(folder):
    """The log of a run without times."""
    entries = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    times = ("seconds_a_step", "waited_for_data")
    return [{name: value for name, value in entry.items() if name not in times} for entry in entries]


def trained_networks(network):
    """The names of the networks in a model that require a gradient."""
    return {name.split(".")[0] for name, weight in network.named_parameters() if weight.requires_grad}


def networks_moved_by(run):
    """Train a run; the names of the networks whose weights are others then."""
    before = {name: value.clone() for name, value in run.network.state_dict().items()}
    run.train()
    return {name.split(".")[0] for name, value in run.network.state_dict().items() if not value.equal(before[name])}


def single_view_weights(config: ModelConfig = TINY) -> Checkpoint:
    """A single-view model whose weights all differ, as trained ones do."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(7)
        model = SingleModel(config)
        with torch.no_grad():
            for weight in model.parameters():
                weight += 0.02 * torch.randn_like(weight)
    return Checkpoint("single", config, model, {"steps": 5, "stage": "single-joint"})


def box_example(*, frames=(0,), depth: DepthKind = "exact") -> Example:
    """A single view of a box room, and the frames after it."""
    return example_of(BoxRecordings(1).read(0, frames=[*frames]), np.random.default_rng(0), depth=depth)


def view_batch(*examples: Example, height: int | None = None):
    """A batch of single views, of `box_example` unless others are given."""
    return collate([*examples] or [box_example()], volume_shape=SHAPE, panorama_height=height)


def walk_batch(walk: WalkExample, *, height: int | None, shape=SHAPE):
    """A batch of a walk, with the views from its probes unless `height` is None."""
    prepared = [PreparedWalk.of(walk, shape)]
    batch = collate_walks(prepared, panorama_height=height)
    return batch if height is None else with_views(batch, prepared, panorama_height=height)


def box_walk(rng: np.random.Generator, *, length=4, augment=True, change_light=None) -> WalkExample:
    """A walk through a box room with exact depth."""
    return read_walk(
        BoxRecordings(1), 0, rng, depth="exact", length=length, augment=augment, change_light=change_light
    )  # fmt: skip


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
