"""`roomlight train`: one stage of training, from the command line's options."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from roomlight.engine.volume.grid import VOLUME_SHAPE
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app
from roomlight_cli.train import train as run_training
from roomlight_cli.train_part import train_part
from roomlight_model.config import ModelConfig, SGConfig
from roomlight_model.training.options import HELD_OUT, OPTIONS, TrainOptions, is_video
from roomlight_model.training.part_trainer import PartOptions
from roomlight_model.training.subsets import TrainingRooms

app = single_command_app()


@app.command()
def train(
    data: Annotated[
        list[Path],
        typer.Argument(help="Dataset folders (roomlight dataset generate); they may grow during the run."),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the run: a new one, or one to continue.")],
    stage: Annotated[
        arguments.TrainingStage,
        typer.Option(
            help="What to train: the lighting volume (sglv), the blending network on it, or both jointly; single: for "
            "one view, video: the recurrent networks, from single-view weights (--start-from). clipping: the radiance "
            "of clipped pixels. completion: light where no frame looked. objects: the light of virtual objects. These "
            "three use --steps, --batch, --learning-rate, --seed, --minutes, --every and --start-from."
        ),
    ],
    steps: Annotated[
        int, typer.Option(min=1, help="Steps in all; the learning rate falls over them. May change between runs.")
    ] = 20_000,
    minutes: Annotated[
        float | None, typer.Option(min=0, help="Stop after this many minutes; the same command continues.")
    ] = None,
    start_from: Annotated[
        Path | None,
        typer.Option(
            help="Weights to start from: a checkpoint of the stage before, or a model folder such as the shipped ones. "
            "Their network widths are taken over."
        ),
    ] = None,
    batch: Annotated[
        int | None, typer.Option(min=1, help="Examples per step; 4, and 2 sequences in video stages.")
    ] = None,
    learning_rate: Annotated[
        float | None, typer.Option(help="Highest learning rate; 1e-3, and 3e-4 in video stages.")
    ] = None,
    volume: Annotated[
        arguments.Resolution,
        typer.Option(
            help="Resolution of the volume. half costs an eighth of full; the exported graphs have the same resolution."
        ),
    ] = "half",
    depth: Annotated[
        Literal["exact", "arkit", "both"],
        typer.Option(help="Depth as rendered, as a phone measures it, or half of each."),
    ] = "both",
    rendering_weight: Annotated[float, typer.Option(min=0, help="Weight of the rendering loss (paper: 0.3).")] = 0.3,
    rgb_alpha: Annotated[
        bool, typer.Option("--rgb-alpha", help="Use an RGB-alpha volume without spherical Gaussians (ablation).")
    ] = False,
    surround_max: Annotated[
        float,
        typer.Option(
            min=0,
            help="Leave out sequences whose surroundings are more than this many times as bright as their first frame "
            "(0: leave out none). People film the lit side of a room.",
        ),
    ] = 0.0,
    relative: Annotated[
        bool,
        typer.Option(
            "--relative",
            help="single-blend, single-joint: divide each example's error by that of the classical fill, and count "
            "what exceeds it twice. Easy rooms then count as hard ones.",
        ),
    ] = False,
    frames: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Show up to this many frames of a walk together, as in a stream; 1: single views. Video stages: the "
            "longest sequence, 31.",
        ),
    ] = None,
    window: Annotated[
        int,
        typer.Option(min=1, help="Video stages: frames over which gradients go back in time; fewer take less memory."),
    ] = 31,
    variants: Annotated[
        int,
        typer.Option(
            min=0,
            help="video-blend: draw so many sequences from each walk and keep what the fixed 3D networks make of them "
            "in the run's folder, about 10 MB each; 0: draw new ones at every step.",
        ),
    ] = 0,
    light_changes: Annotated[
        float,
        typer.Option(
            min=0, max=1, help="Video stages: share of sequences in which a lamp is switched or all light changes."
        ),
    ] = 0.0,
    second_looks: Annotated[
        float,
        typer.Option(
            min=0, max=1, help="Video stages: share of sequences that stay at a place or return the same way."
        ),
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of initial weights, order and augmentation.")] = 0,
    device: arguments.Device = "auto",
    every: Annotated[int, typer.Option(min=1, help="Score the held-out rooms every this many steps.")] = 1000,
) -> None:
    """Train one stage of the networks on a dataset (needs the `train` extra).

    It uses the train split. Stopped or killed, the same command continues from the last checkpoint.
    """
    if stage in ("clipping", "completion", "objects"):
        part_options = PartOptions(
            steps=steps,
            batch=batch or PartOptions.batch,
            learning_rate=PartOptions.learning_rate if learning_rate is None else learning_rate,
            seed=seed,
        )
        done = train_part(
            stage,
            data,
            out,
            options=part_options,
            start_from=start_from,
            minutes=minutes,
            every_steps=every,
            console=console.err,
        )
        _say_result(out, done["steps"], steps, done["hours"])
        return
    begun, video = out / OPTIONS, is_video(stage)
    options = TrainOptions(
        stage=stage,
        steps=steps,
        batch=batch or (2 if video else 4),
        learning_rate=learning_rate if learning_rate is not None else 3e-4 if video else 1e-3,
        rendering_weight=rendering_weight,
        depth=depth,
        surround_max=surround_max,
        relative=relative,
        frames=frames or (31 if video else 1),
        window=window,
        variants=variants,
        light_changes=light_changes,
        second_looks=second_looks,
        seed=seed,
        model=ModelConfig(sg=SGConfig(spherical_gaussians=not rgb_alpha)),
    )
    with console.err.status("opening the datasets") as status:
        rooms = TrainingRooms(
            data,
            surround_max=surround_max,
            held_out=TrainOptions.read(begun).held_out if begun.exists() else HELD_OUT,
            progress=lambda done, total: status.update(f"checking sequence {done} of {total}"),
        )
    options = replace(options, held_out=len(rooms.held_out))
    if volume == "full":
        options = replace(options, volume_shape=VOLUME_SHAPE)
    card = run_training(
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
    _say_result(out, card["steps"], steps, card["hours"])


def _say_result(out: Path, done: int, steps: int, hours: float) -> None:
    console.say(f"{out}: {done} of {steps} steps in {hours:.2f} hours; weights in {out / 'model.pt'}")
    best = out / "best.pt"
    if done >= steps and best.exists():
        console.say(f"Export the best weights on held-out rooms: roomlight export {best} --out {out / 'onnx'}")
