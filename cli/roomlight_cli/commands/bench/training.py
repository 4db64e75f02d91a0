"""`roomlight bench widths`, `train` and `rendering`: what networks and their training cost."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Interval

from roomlight.captures import open_capture
from roomlight.dataset.loader import Dataset
from roomlight.engine.volume.grid import VOLUME_SHAPE
from roomlight.images import read_panorama
from roomlight.sample import sample_capture
from roomlight.spheres import view_toward
from roomlight_bench.training.rendering import compare_sampling
from roomlight_bench.training.training import measure_training
from roomlight_cli.console import say, show_report
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import Device, FiguresJson, Resolution
from roomlight_cli.train import choose_device
from roomlight_export.widths import format_widths, measure_widths
from roomlight_model.training.single_view import SingleViewOptions
from roomlight_model.training.subsets import train_val_split
from roomlight_model.training.video import VideoOptions


def widths(*, rounds: Annotated[int, Ge(1)] = 15) -> None:
    """Measure what each width of the networks costs (needs the `train` extra; minutes).

    Columns: parameters, GMAC (10^9 multiply-accumulates) and milliseconds.

    Args:
        rounds: Interleaved rounds over all widths.
    """
    with Progress("measuring") as progress:
        rows = measure_widths(rounds=rounds, progress=progress.say)
    say(format_widths(rows))


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


def rendering(panorama: Path | None = None, *, picture: Path | None = None, json: FiguresJson = None) -> None:
    """Compare importance sampling of the rendering layer with uniform directions (needs the `train` extra).

    Both use the same number of directions.

    Args:
        panorama: An HDR panorama (EXR) that lights the sphere; default: the sample room's.
        picture: Also write a PNG of the spheres.
    """
    view = (0.0, 0.0, -1.0)
    if panorama is None:
        capture = open_capture(sample_capture())
        probe = capture.probes[0]
        light, view = probe.panorama(), view_toward(next(iter(capture)).camera_to_world, probe.position)
    else:
        light = read_panorama(panorama)
    with Progress("rendering") as progress:
        report = compare_sampling(light, view, progress=progress.say)
    show_report(report, json, report.table())
    if picture:
        report.write_picture(picture)
        say(f"Picture: {picture}")
