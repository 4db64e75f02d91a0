"""Arguments and options that several commands share, as typer annotations, and what is built from them."""

from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from roomlight.captures import FORMATS, CaptureOptions
from roomlight.captures.options import CameraConvention, PoseDirection
from roomlight.conventions import Position
from roomlight.depth import UnknownDepth
from roomlight.engine.networks.providers import Provider
from roomlight.engine.session import ModelName, SessionOptions

CAPTURE_PANEL: Final = "How to read the capture"
MODEL_PANEL: Final = "How to estimate the light"
POINTS_PANEL: Final = "Where to light"

Resolution = Literal["half", "full"]

Format = Annotated[
    str | None,
    typer.Option("--format", rich_help_panel=CAPTURE_PANEL, help=f"Force a reader: {', '.join(sorted(FORMATS))}."),
]
DepthKey = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=CAPTURE_PANEL, help="Which depth map of a transforms.json to read, e.g. depth_lidar_file_path."
    ),
]
DepthUnit = Annotated[
    float | None,
    typer.Option("--depth-unit", rich_help_panel=CAPTURE_PANEL, help="Metres per stored unit of depth."),
]
MinConfidence = Annotated[
    int | None,
    typer.Option(min=0, max=255, rich_help_panel=CAPTURE_PANEL, help="Drop depth with a lower confidence than this."),
]
CameraAxes = Annotated[
    CameraConvention | None,
    typer.Option("--camera-convention", rich_help_panel=CAPTURE_PANEL, help="Camera axes of the stored poses."),
]
PoseMaps = Annotated[
    PoseDirection | None,
    typer.Option("--pose-direction", rich_help_panel=CAPTURE_PANEL, help="Direction in which the stored poses map."),
]
WorldUp = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=CAPTURE_PANEL,
        help="Up direction of the stored world: x, y, z, -x, -y, -z, or three numbers X,Y,Z.",
    ),
]
MaxFrames = Annotated[
    int | None, typer.Option(min=1, rich_help_panel=CAPTURE_PANEL, help="Use at most this many frames.")
]

Model = Annotated[
    ModelName,
    typer.Option(
        rich_help_panel=MODEL_PANEL,
        help="auto: classical, or the networks of --weights. single: the networks that come with RoomLight.",
    ),
]
Weights = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=MODEL_PANEL, help="A model folder that `roomlight export` wrote, instead of the shipped one."
    ),
]
Runtime = Annotated[Provider, typer.Option("--provider", rich_help_panel=MODEL_PANEL, help="Where the networks run.")]
Parts = Annotated[
    Path | None,
    typer.Option(
        "--parts",
        rich_help_panel=MODEL_PANEL,
        help="A folder with the model folders `clipping` and `objects`, instead of the shipped ones.",
    ),
]
UnknownDepthOption = Annotated[
    UnknownDepth,
    typer.Option(
        "--unknown-depth",
        rich_help_panel=MODEL_PANEL,
        help="Pixels without depth: at the depth around them (rim), at the volume's far side (far), or unused (drop).",
    ),
]

Pixels = Annotated[
    list[str] | None,
    typer.Option(
        "--pixel",
        metavar="U,V",
        rich_help_panel=POINTS_PANEL,
        help="Light a point above the surface that this pixel of the first colour image shows: column U, row V from "
        "the top left. Repeatable.",
    ),
]
Above = Annotated[
    float,
    typer.Option(
        min=0, max=10, rich_help_panel=POINTS_PANEL, help="Distance in metres of --pixel points from their surface."
    ),
]

Device = Annotated[
    Literal["auto", "cpu", "cuda"], typer.Option(help="Where PyTorch runs; auto: a GPU if there is one.")
]
FiguresJson = Annotated[Path | None, typer.Option("--json", help="Also write the figures as JSON.")]


def parse_position(text: str) -> Position:
    """Parse X,Y,Z in metres. Raises typer.BadParameter for other text."""
    return _three(text, "a position is X,Y,Z in metres, e.g. 0.2,-0.1,-1.5")


def parse_pixel(text: str) -> tuple[float, float]:
    """Parse U,V: column and row of a pixel. Raises typer.BadParameter for other text."""
    try:
        column, row = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"a pixel is U,V: column and row, e.g. 960,540; got {text!r}") from None
    return column, row


def parse_world_up(text: str | None) -> str | Position | None:
    """Parse three numbers X,Y,Z; return an axis name as it is. Raises typer.BadParameter for other lists."""
    return _three(text, "world up is an axis (x, -z, ...) or three numbers X,Y,Z") if text and "," in text else text


def parse_counts(text: str) -> tuple[int, ...]:
    """Parse whole numbers from 1 to 1000, e.g. 1,4,16. Raises typer.BadParameter for other text."""
    rule = f"numbers of sessions are whole, 1 to 1000, separated by commas: 1,4,16; got {text!r}"
    try:
        counts = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(rule) from None
    if not all(1 <= count <= 1000 for count in counts):
        raise typer.BadParameter(rule)
    return counts


def _three(text: str, rule: str) -> Position:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{rule}; got {text!r}") from None
    return x, y, z


def capture_options(
    *,
    format_name: str | None,
    depth_key: str | None,
    depth_unit: float | None,
    min_confidence: int | None,
    camera_convention: CameraConvention | None,
    pose_direction: PoseDirection | None,
    world_up: str | None,
    max_frames: int | None,
    every: int = 1,
) -> CaptureOptions:
    """Build the reader's options from the command line's."""
    return CaptureOptions(
        format=format_name,
        camera_convention=camera_convention,
        pose_direction=pose_direction,
        world_up=parse_world_up(world_up),
        depth_unit_m=depth_unit,
        depth_key=depth_key,
        min_confidence=min_confidence,
        every=every,
        max_frames=max_frames,
    )


def session_options(
    *,
    model: ModelName,
    weights: Path | None,
    provider: Provider,
    unknown_depth: UnknownDepth,
    height: int,
    parts: Path | None = None,
) -> SessionOptions:
    """Build the engine's options from the command line's. Raises typer.BadParameter for weights that go unused."""
    if model == "classical" and weights is not None:
        raise typer.BadParameter(
            f"leave out --weights {weights}: --model classical does not run networks; or choose another --model"
        )
    return SessionOptions(
        model=model,
        weights=weights,
        provider=provider,
        unknown_depth=unknown_depth,
        height=height,
        parts=parts,
    )
