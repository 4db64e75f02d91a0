"""Arguments that several commands share, as typer annotations, and what they build."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight.captures import FORMATS, CaptureOptions
from roomlight.captures.options import CameraConvention, PoseDirection
from roomlight.conventions import Position
from roomlight.depth import UnknownDepth
from roomlight.engine.providers import Provider
from roomlight.engine.session import ModelName, SessionOptions

_CAPTURE = "How to read the capture"
_MODEL = "How to estimate the light"

Format = Annotated[
    str | None,
    typer.Option("--format", rich_help_panel=_CAPTURE, help=f"Force a reader: {', '.join(sorted(FORMATS))}."),
]
DepthKey = Annotated[
    str | None,
    typer.Option(rich_help_panel=_CAPTURE, help="Which depth map of a transforms.json, e.g. depth_lidar_file_path."),
]
DepthUnit = Annotated[
    float | None, typer.Option("--depth-unit", rich_help_panel=_CAPTURE, help="Metres for one stored unit of depth.")
]
MinConfidence = Annotated[
    int | None,
    typer.Option(min=0, max=255, rich_help_panel=_CAPTURE, help="Depth with a lower confidence than this is removed."),
]
CameraAxes = Annotated[
    CameraConvention | None,
    typer.Option("--camera-convention", rich_help_panel=_CAPTURE, help="Camera axes of the stored poses."),
]
PoseMaps = Annotated[
    PoseDirection | None, typer.Option("--pose-direction", rich_help_panel=_CAPTURE, help="What the stored poses map.")
]
WorldUp = Annotated[
    str | None,
    typer.Option(rich_help_panel=_CAPTURE, help="The stored world's up: x, y, z, -x, -y, -z, or three numbers X,Y,Z."),
]
MaxFrames = Annotated[int | None, typer.Option(min=1, rich_help_panel=_CAPTURE, help="Use at most so many frames.")]

Model = Annotated[
    ModelName,
    typer.Option(rich_help_panel=_MODEL, help="auto: the trained weights that come with it, else classical."),
]
Weights = Annotated[
    Path | None,
    typer.Option(rich_help_panel=_MODEL, help="A model folder of `roomlight export` instead of the shipped one."),
]
AllowUntrained = Annotated[
    bool, typer.Option("--allow-untrained", rich_help_panel=_MODEL, help="Accept weights that were never trained.")
]
Runtime = Annotated[
    Provider, typer.Option("--provider", rich_help_panel=_MODEL, help="Where networks run: auto, cpu, openvino.")
]
UnknownDepthOption = Annotated[
    UnknownDepth,
    typer.Option("--unknown-depth", rich_help_panel=_MODEL, help="Where pixels without depth are taken to be."),
]


def parse_position(text: str) -> Position:
    """X,Y,Z in metres; typer's own error otherwise."""
    return _three(text, "a position is X,Y,Z in metres, e.g. 0.2,-0.1,-1.5")


def parse_world_up(text: str | None) -> str | Position | None:
    """An axis name as it is, or three numbers."""
    return _three(text, "world up is an axis (x, -z, ...) or three numbers X,Y,Z") if text and "," in text else text


def parse_counts(text: str) -> tuple[int, ...]:
    """1,4,16: whole numbers from 1 to 1000; typer's own error otherwise."""
    rule = f"numbers of sessions are whole, 1 to 1000, with commas: 1,4,16; got {text!r}"
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
    """The reader's options from the command line."""
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
    allow_untrained: bool,
    unknown_depth: UnknownDepth,
    height: int,
) -> SessionOptions:
    """The engine's options from the command line; typer's own error for weights that would not be used."""
    if model == "classical" and weights is not None:
        raise typer.BadParameter(
            f"--model classical uses no networks: leave out --weights {weights}, or choose --model"
        )
    return SessionOptions(
        model=model,
        weights=weights,
        provider=provider,
        allow_untrained=allow_untrained,
        unknown_depth=unknown_depth,
        height=height,
    )
