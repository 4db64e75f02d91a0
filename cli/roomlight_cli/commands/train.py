"""`roomlight train`: a recipe, from its data to exported weights."""

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer
from annotated_types import Ge

from roomlight_cli import console
from roomlight_cli.commands.export import use_of, warn_of_untrained
from roomlight_cli.options import Flag
from roomlight_cli.shared_options import Device
from roomlight_cli.train import train_recipe
from roomlight_model.checkpoint import load_checkpoint
from roomlight_model.training.recipe import read_recipe


def train(
    recipe: str,
    *,
    out: Path,
    data: Path | None = None,
    changes: Annotated[tuple[str, ...], Flag(name="--set", metavar="NAME=VALUE")] = (),
    minutes: Annotated[float, Ge(0)] | None = None,
    device: Device = "auto",
) -> None:
    """Train networks by a recipe: its data, its stages, the export (needs the `train` extra).

    Stopped or killed, the same command continues from the last checkpoint.

    Args:
        recipe: A recipe's file (.toml), or the name of a shipped one: single, video, clipping,
            objects, depth.
        out: Folder of the runs: a new one, or one to continue.
        data: Folder with the recipe's datasets by name; missing ones are generated. Default: OUT/data.
        changes: Change an option in every stage that has it, e.g. --set steps=100. Repeatable.
        minutes: Stop after this many minutes of training; generating data does not count. The same command continues.
    """
    read = read_recipe(recipe).changed(_parse_changes(changes))
    report = train_recipe(read, out, data=data or out / "data", device=device, minutes=minutes, console=console.err)
    if report is not None:
        warn_of_untrained(report)
        shipped = out / read.ships
        weights = f"{shipped} (step {load_checkpoint(shipped).card['steps']})"
        console.say(f"{report.out}: the weights of {weights}, as ONNX graphs; use them with {use_of(report)}")


def _parse_changes(changes: tuple[str, ...]) -> dict[str, Any]:
    """Parse NAME=VALUE; values are written as in TOML, and other text is a string."""
    values: dict[str, Any] = {}
    for change in changes:
        name, equals, text = change.partition("=")
        if not equals:
            raise typer.BadParameter(f"--set takes NAME=VALUE, e.g. steps=100; got {change!r}")
        try:
            values[name.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[name.strip()] = text
    return values
