"""`roomlight bench train`: a training step, part by part."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from roomlight.dataset.loader import Dataset
from roomlight.engine.volume.grid import VOLUME_SHAPE
from roomlight.files import write_json
from roomlight_bench.training.training import measure_training
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_cli.train import choose_device
from roomlight_model.training.single_view import SingleViewOptions
from roomlight_model.training.subsets import train_val_split
from roomlight_model.training.video import VideoOptions

app = single_command_app()


@app.command("train")
def bench_train(
    data: Annotated[list[Path], typer.Argument(help="Dataset folders (roomlight dataset generate).")],
    stage: Annotated[
        Literal["single-sglv", "single-blend", "single-joint", "video-sglv", "video-blend", "video-joint"],
        typer.Option(help="The stage of training."),
    ] = "single-sglv",
    steps: Annotated[int, typer.Option(min=1, max=10_000, help="Steps to measure.")] = 20,
    batch: Annotated[
        int | None, typer.Option(min=1, help="Examples per step; 4, and 2 sequences in video stages.")
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Frames of an example; 1, and 31 in video stages.")] = None,
    window: Annotated[int, typer.Option(min=1, help="Video stages: frames over which gradients go back in time.")] = 31,
    volume: Annotated[arguments.Resolution, typer.Option(help="Resolution of the volume.")] = "half",
    bf16: Annotated[bool, typer.Option("--bf16/--fp32", help="Number format of the networks.")] = True,
    device: arguments.Device = "auto",
    json_out: arguments.FiguresJson = None,
) -> None:
    """Measure what a training step costs by part (needs the `train` extra).

    Parts: data, forward pass, rendering, backward pass, optimiser; in video stages also meshes and the probes' views
    of them, and ray marching and blending apart.
    """
    options = VideoOptions(stage=stage, window=window) if stage.startswith("video-") else SingleViewOptions(stage=stage)
    options = replace(
        options,
        batch=batch or options.batch,
        frames=frames or options.frames,
        bf16=bf16,
        steps=1_000_000,
        volume_shape=VOLUME_SHAPE if volume == "full" else options.volume_shape,
    )
    with console.err.status("measuring") as status:
        costs = measure_training(
            options,
            train_val_split([Dataset(folder, "train") for folder in data], options.held_out)[0],
            steps=steps,
            device=choose_device(device),
            progress=status.update,
        )
    console.print_table(console.out, costs.table())
    if json_out:
        write_json(json_out, costs.to_json())
