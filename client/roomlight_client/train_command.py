"""`roomlight train`: what can be said on its command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from roomlight.errors import ModelError
from roomlight_client import console

Stage = Literal["single-sglv", "single-blend", "single-joint"]
Resolution = Literal["half", "full"]


def train(
    data: Annotated[Path, typer.Argument(help="A dataset folder (roomlight dataset generate).")],
    out: Annotated[Path, typer.Option(help="Folder of the run: new, or one to go on with.")],
    stage: Annotated[Stage, typer.Option(help="What to train: the volume, the blending on it, or both.")],
    steps: Annotated[int, typer.Option(min=1, help="Steps in all; the learning rate falls over them.")] = 20_000,
    minutes: Annotated[float | None, typer.Option(min=0, help="Stop after so long; the same command goes on.")] = None,
    start_from: Annotated[
        Path | None, typer.Option(help="Checkpoint of the stage before, whose weights and widths are taken.")
    ] = None,
    batch: Annotated[int, typer.Option(min=1, help="Examples a step.")] = 4,
    learning_rate: Annotated[float, typer.Option(help="Highest learning rate.")] = 1e-3,
    volume: Annotated[
        Resolution, typer.Option(help="Half trains eight times as fast; its weights fit the full volume.")
    ] = "half",
    depth: Annotated[
        Literal["exact", "arkit", "both"], typer.Option(help="Depth as it is, as a phone measures it, or half of each.")
    ] = "both",
    rendering_weight: Annotated[float, typer.Option(min=0, help="Weight of the rendering loss (paper: 0.3).")] = 0.3,
    rgb_alpha: Annotated[
        bool, typer.Option("--rgb-alpha", help="An RGB-alpha volume without spherical Gaussians (ablation).")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, order and augmentation.")] = 0,
    device: Annotated[Literal["auto", "cpu", "cuda"], typer.Option(help="Where to train.")] = "auto",
    every: Annotated[int, typer.Option(min=1, help="Look at held-out rooms every so many steps.")] = 1000,
) -> None:
    """Train one stage on the train split. Killed or stopped, the same command goes on from the last checkpoint."""
    from roomlight_client.train import train as run
    from roomlight_model.config import ModelConfig, SGConfig
    from roomlight_model.dataset.loader import Dataset

    try:
        from roomlight_model.training.options import TrainOptions

        dataset = Dataset(data, "train")
        options = TrainOptions(
            stage=stage,
            steps=steps,
            batch=batch,
            learning_rate=learning_rate,
            rendering_weight=rendering_weight,
            depth=depth,
            seed=seed,
            model=ModelConfig(sg=SGConfig(spherical_gaussians=not rgb_alpha)),
        )
        if volume == "full":
            options = replace(options, volume_shape=options.model.sg.volume_shape)
        card = run(
            options,
            dataset,
            out,
            device=device,
            start_from=start_from,
            minutes=minutes,
            every_steps=every,
            console=console.err,
        )
    except ModuleNotFoundError as error:
        raise ModelError(f"this command needs {error.name}: pip install 'roomlight[train]'") from error
    console.say(f"{out}: {card['steps']} of {steps} steps in {card['hours']:.2f} hours; weights in {out / 'model.pt'}")
    if card["steps"] >= steps:
        console.say(f"Export them: roomlight export {out / 'model.pt'} --out {out / 'onnx'}")
