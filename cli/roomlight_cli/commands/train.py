"""`roomlight train`: what can be said on its command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from roomlight.engine.volume import VOLUME_SHAPE
from roomlight.errors import ModelError
from roomlight_cli import console

Stage = Literal["single-sglv", "single-blend", "single-joint"]
Resolution = Literal["half", "full"]


def train(
    data: Annotated[
        list[Path], typer.Argument(help="Dataset folders (roomlight dataset generate); they may grow meanwhile.")
    ],
    out: Annotated[Path, typer.Option(help="Folder of the run: new, or one to go on with.")],
    stage: Annotated[Stage, typer.Option(help="What to train: the volume, the blending on it, or both.")],
    steps: Annotated[
        int, typer.Option(min=1, help="Steps in all; the learning rate falls over them. May change between runs.")
    ] = 20_000,
    minutes: Annotated[float | None, typer.Option(min=0, help="Stop after so long; the same command goes on.")] = None,
    start_from: Annotated[
        Path | None,
        typer.Option(
            help="Checkpoint of the stage before, or exported weights such as those that are shipped: weights and "
            "widths are taken."
        ),
    ] = None,
    batch: Annotated[int, typer.Option(min=1, help="Examples a step.")] = 4,
    learning_rate: Annotated[float, typer.Option(help="Highest learning rate.")] = 1e-3,
    volume: Annotated[
        Resolution, typer.Option(help="Half costs an eighth, in training and in use; graphs are exported for it.")
    ] = "half",
    depth: Annotated[
        Literal["exact", "arkit", "both"], typer.Option(help="Depth as it is, as a phone measures it, or half of each.")
    ] = "both",
    rendering_weight: Annotated[float, typer.Option(min=0, help="Weight of the rendering loss (paper: 0.3).")] = 0.3,
    rgb_alpha: Annotated[
        bool, typer.Option("--rgb-alpha", help="An RGB-alpha volume without spherical Gaussians (ablation).")
    ] = False,
    surround_max: Annotated[
        float,
        typer.Option(
            min=0,
            help="Only sequences that are at most so many times as bright all around as in their first frame (0: all): "
            "people film the lit side of a room.",
        ),
    ] = 0.0,
    frames: Annotated[
        int,
        typer.Option(
            min=1, help="Up to so many frames of a walk together, as a stream shows them; 1: single views only."
        ),
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, order and augmentation.")] = 0,
    device: Annotated[Literal["auto", "cpu", "cuda"], typer.Option(help="Where to train.")] = "auto",
    every: Annotated[int, typer.Option(min=1, help="Look at held-out rooms every so many steps.")] = 1000,
) -> None:
    """Train one stage on the train split. Killed or stopped, the same command goes on from the last checkpoint."""
    from roomlight_cli.train import train as run
    from roomlight_model.config import ModelConfig, SGConfig

    try:
        from roomlight_model.training.options import HELD_OUT, OPTIONS, TrainOptions
        from roomlight_model.training.subsets import TrainingRooms

        begun = out / OPTIONS
        options = TrainOptions(
            stage=stage,
            steps=steps,
            batch=batch,
            learning_rate=learning_rate,
            rendering_weight=rendering_weight,
            depth=depth,
            surround_max=surround_max,
            frames=frames,
            seed=seed,
            model=ModelConfig(sg=SGConfig(spherical_gaussians=not rgb_alpha)),
        )
        with console.err.status("opening the datasets") as status:
            rooms = TrainingRooms(
                data,
                surround_max=surround_max,
                held_out=TrainOptions.read(begun).held_out if begun.exists() else HELD_OUT,
                progress=lambda done, of: status.update(f"looking at sequence {done} of {of}"),
            )
        options = replace(options, held_out=len(rooms.held_out))
        if volume == "full":
            options = replace(options, volume_shape=VOLUME_SHAPE)
        card = run(
            options,
            rooms.training,
            out,
            held_out=rooms.held_out,
            grow=rooms.grow,
            data=rooms.described,
            device=device,
            start_from=start_from,
            minutes=minutes,
            every_steps=every,
            console=console.err,
        )
    except ModuleNotFoundError as error:
        raise ModelError(f"this command needs {error.name}: pip install 'roomlight[train]'") from error
    console.say(f"{out}: {card['steps']} of {steps} steps in {card['hours']:.2f} hours; weights in {out / 'model.pt'}")
    best = out / "best.pt"
    if card["steps"] >= steps and best.exists():
        console.say(f"Those that did best on held-out rooms: roomlight export {best} --out {out / 'onnx'}")


def bench_train(
    data: Annotated[list[Path], typer.Argument(help="Dataset folders (roomlight dataset generate).")],
    stage: Annotated[Stage, typer.Option(help="The stage of training.")] = "single-sglv",
    steps: Annotated[int, typer.Option(min=1, max=10_000, help="Steps to measure.")] = 20,
    batch: Annotated[int, typer.Option(min=1, help="Examples a step.")] = 4,
    volume: Annotated[Resolution, typer.Option(help="Resolution of the volume.")] = "half",
    bf16: Annotated[bool, typer.Option("--bf16/--fp32", help="Arithmetic of the networks.")] = True,
    device: Annotated[Literal["auto", "cpu", "cuda"], typer.Option(help="Where to train.")] = "auto",
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the figures as JSON.")] = None,
) -> None:
    """What a training step costs by part: data, forward, render, backward, optimiser (needs the `train` extra)."""
    from roomlight.files import write_json
    from roomlight_evaluation.tables import print_whole

    try:
        from roomlight_bench.train import measure
        from roomlight_cli.train import choose_device
        from roomlight_model.training.options import TrainOptions
        from roomlight_model.training.subsets import TrainingRooms

        options = TrainOptions(stage=stage, batch=batch, bf16=bf16, steps=1_000_000)
        if volume == "full":
            options = replace(options, volume_shape=VOLUME_SHAPE)
        with console.err.status("measuring") as status:
            costs = measure(
                options,
                TrainingRooms(data).training,
                steps=steps,
                device=choose_device(device),
                progress=status.update,
            )
    except ModuleNotFoundError as error:
        raise ModelError(f"this command needs {error.name}: pip install 'roomlight[train]'") from error
    print_whole(console.out, costs.table())
    if json_out:
        write_json(json_out, costs.to_json())


def bench_rendering(
    panorama: Annotated[
        Path | None, typer.Argument(help="An HDR panorama (EXR) to light the sphere; the sample room's if not given.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="PNG of the spheres.")] = None,
    json_out: Annotated[Path | None, typer.Option("--json", help="Also write the figures as JSON.")] = None,
) -> None:
    """The rendering layer's importance sampling beside uniform directions, at the same count (needs `train`)."""
    from roomlight.captures import open_capture
    from roomlight.files import write_json
    from roomlight.images import read_panorama
    from roomlight.sample import sample_capture
    from roomlight.spheres import view_toward
    from roomlight_bench.rendering import compare_sampling
    from roomlight_evaluation.tables import print_whole

    view = (0.0, 0.0, -1.0)
    if panorama is None:
        capture = open_capture(sample_capture())
        probe = capture.probes[0]
        light, view = probe.panorama(), view_toward(next(iter(capture)).camera_to_world, probe.position)
    else:
        light = read_panorama(panorama)
    try:
        with console.err.status("rendering") as status:
            report = compare_sampling(light, view, progress=status.update)
    except ModuleNotFoundError as error:
        raise ModelError(f"this command needs {error.name}: pip install 'roomlight[train]'") from error
    print_whole(console.out, report.table())
    if json_out:
        write_json(json_out, report.to_json())
    if picture:
        report.write_picture(picture)
        console.say(f"Look at {picture}")
