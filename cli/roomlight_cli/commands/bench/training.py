"""`roomlight bench train`: what training the networks costs."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Interval

from roomlight.dataset.loader import Dataset
from roomlight.engine.volume.grid import VOLUME_SHAPE
from roomlight_bench.training.training import measure_training
from roomlight_cli.console import show_report
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import Device, FiguresJson, Resolution
from roomlight_cli.train import choose_device
from roomlight_model.training.single_view import SingleViewOptions
from roomlight_model.training.subsets import train_val_split
from roomlight_model.training.video import VideoOptions


def train(
    data: tuple[Path, ...],
    *,
    stage: Literal[
        "single-sglv", "single-blend", "single-joint", "video-sglv", "video-blend", "video-joint"
    ] = "single-sglv",
    steps: Annotated[int, Interval(ge=1, le=10_000)] = 20,
    batch: Annotated[int, Ge(1)] | None = None,
    frames: Annotated[int, Ge(1)] | None = None,
    window: Annotated[int, Ge(1)] = 31,
    volume: Resolution = "half",
    bf16: bool = True,
    device: Device = "auto",
    json: FiguresJson = None,
) -> None:
    """Measure what a training step costs by part (needs the `train` extra).

    Parts: data, forward pass, rendering, backward pass, optimiser; in video stages also meshes and the probes' views
    of them, and ray marching and blending apart.

    Args:
        data: Dataset folders (roomlight dataset generate).
        stage: The stage of training.
        steps: Steps to measure.
        batch: Examples per step; 4, and 2 sequences in video stages.
        frames: Frames of an example; 1, and 31 in video stages.
        window: Video stages: frames over which gradients go back in time.
        volume: Resolution of the volume.
        bf16: Number format of the networks: bfloat16 or float32.
        device: Where PyTorch runs.
    """
    options = (
        VideoOptions(stage=stage, window=window)
        if stage in ("video-sglv", "video-blend", "video-joint")
        else SingleViewOptions(stage=stage)
    )
    options = replace(
        options,
        batch=batch or options.batch,
        frames=frames or options.frames,
        bf16=bf16,
        steps=1_000_000,
        volume_shape=VOLUME_SHAPE if volume == "full" else options.volume_shape,
    )
    with Progress("measuring") as progress:
        training, _ = train_val_split([Dataset(folder, "train") for folder in data], options.held_out)
        chosen = choose_device(device)
        costs = measure_training(options, training, steps=steps, device=chosen, progress=progress.say)
    show_report(costs, json, costs.table())
