"""The `roomlight` command: which commands there are, in the order in which a newcomer needs them."""

from typing import Annotated, Final

import typer

from roomlight import __version__
from roomlight_cli import console
from roomlight_cli.lazy import CommandEntry, lazy_app

_TRY: Final = "Try it"
_LIGHT: Final = "Light a recording"
_SERVE: Final = "Serve"
_MEASURE: Final = "Measure"
_TRAIN: Final = "Train"

COMMANDS: Final = (
    CommandEntry("demo", "roomlight_cli.commands.demo", "Show the light of the sample room in a browser.", _TRY),
    CommandEntry("light", "roomlight_cli.commands.light", "Light points of one photograph that has depth.", _LIGHT),
    CommandEntry(
        "replay",
        "roomlight_cli.commands.replay",
        "Light points of a recording: an HDR panorama per frame, pictures, a video, a report.",
        _LIGHT,
    ),
    CommandEntry(
        "composite",
        "roomlight_cli.commands.composite",
        "Put virtual objects into a recording: lit by the room, with shadows, hidden by real things in front.",
        _LIGHT,
    ),
    CommandEntry(
        "stream",
        "roomlight_cli.commands.stream",
        "Play a recording to a server as a phone would stream it; show rate, latency and light.",
        _LIGHT,
    ),
    CommandEntry(
        "serve",
        "roomlight_cli.commands.serve",
        "Serve lighting sessions over HTTP and WebSocket: frames in, light out.",
        _SERVE,
    ),
    CommandEntry(
        "eval",
        "roomlight_cli.commands.evaluation.captures",
        "Score light against the ground-truth probes of recordings.",
        _MEASURE,
    ),
    CommandEntry(
        "eval-dataset",
        "roomlight_cli.commands.evaluation.dataset",
        "Score light from single images on a dataset of rooms that no network was trained on.",
        _MEASURE,
    ),
    CommandEntry(
        "eval-walks",
        "roomlight_cli.commands.evaluation.walks",
        "Score the recurrent networks on walks through rooms that no network was trained on.",
        _MEASURE,
    ),
    CommandEntry(
        "eval-views",
        "roomlight_cli.commands.evaluation.views",
        "Predict later frames of recordings from the frames before them.",
        _MEASURE,
    ),
    CommandEntry(
        "eval-composite",
        "roomlight_cli.commands.evaluation.composite",
        "Compare virtual objects in pictures with the same rooms with the object really in them.",
        _MEASURE,
    ),
    CommandEntry(
        "eval-objects",
        "roomlight_cli.commands.evaluation.objects",
        "Score spheres and a sphere's shadow in the light after a few frames, in many rooms with ground truth.",
        _MEASURE,
    ),
    CommandEntry(
        "bench",
        "roomlight_cli.commands.bench",
        "Measure speed: every figure as a ratio within one run.",
        _MEASURE,
    ),
    CommandEntry(
        "dataset",
        "roomlight_cli.commands.dataset",
        "Generate, view, measure and check datasets of path-traced rooms.",
        _TRAIN,
    ),
    CommandEntry(
        "train",
        "roomlight_cli.commands.train",
        "Train networks by a recipe: its data, its stages, the export (needs the `train` extra).",
        _TRAIN,
    ),
    CommandEntry(
        "export",
        "roomlight_cli.commands.export",
        "Export a checkpoint as verified ONNX graphs (needs the `train` extra).",
        _TRAIN,
    ),
)

app = lazy_app(
    COMMANDS,
    name="roomlight",
    help_text="HDR indoor light at any point of a room, from colour, depth and camera poses.",
)


@app.callback(invoke_without_command=True)
def _root(  # pyright: ignore[reportUnusedFunction]  (typer calls it)
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if version:
        console.say(f"roomlight {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command of `sys.argv`. A RoomLightError is one line on standard error and exit code 1."""
    console.run(app)
