"""Options of reading a capture: facts that its files do not state, or state wrongly."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from annotated_types import Ge, Interval

from roomlight.errors import OptionError
from roomlight.rules import check_options

CameraConvention = Literal["opengl", "opencv"]
PoseDirection = Literal["camera-to-world", "world-to-camera"]
DepthSource = Literal["auto", "file", "network"]
"""Where depth comes from: the files if the capture has depth, else a network (auto); always the one, or the other."""

UP_AXES: Final[dict[str, tuple[float, float, float]]] = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}


@dataclass(frozen=True)
class CaptureOptions:
    """Options of reading a capture; without one, the format's default applies.

    Attributes:
        format: Use this reader instead of the one that recognises the files: roomlight, nerfstudio, stray-scanner,
            record3d, tum, seven-scenes, polycam, 3d-scanner-app, arkitscenes, scannet, scannetpp, rtabmap, ros-bag,
            colmap or video.
        camera_convention: Camera axes of the stored poses: opengl (y up, z backward) or opencv (y down, z forward).
        pose_direction: Direction in which the stored poses map.
        camera_height_m: Mean height of the camera over the floor, for poses without scale (COLMAP): poses, and depth
            files in their unit, are scaled so that the floor in view is as far below. 1.5 if it is not known.
        world_up: Up direction of the stored world: x, y, z, -x, -y, -z, or a vector X,Y,Z. Of a video without poses:
            in the axes of its first camera, x right, y up, z backward.
        fov_deg: Horizontal field of view of a video without poses, in degrees. Default: by its metadata, else adjusted
            to the camera's motion.
        depth_unit_m: Metres per stored unit of depth.
        depth: auto takes the depth files, and for a capture without any estimates depth by a network; file refuses such
            a capture; network always estimates.
        depth_model: An ONNX file that estimates depth, or a folder of `roomlight train depth`, instead of the network
            inside the package.
        depth_key: Which depth map of a transforms.json to read, e.g. depth_lidar_file_path.
        min_confidence: Drop depth of lower confidence; ARKit's levels are 0 (low), 1 and 2. Default: 1.
        every: Use every n-th frame only.
        max_frames: Use at most this many frames.

    Raises:
        OptionError: A value is out of range or unknown.
    """

    format: str | None = None
    camera_convention: CameraConvention | None = None
    pose_direction: PoseDirection | None = None
    world_up: str | tuple[float, float, float] | None = None
    camera_height_m: Annotated[float, Interval(ge=0.1, le=10)] | None = None
    fov_deg: Annotated[float, Interval(ge=5, le=150)] | None = None
    depth_unit_m: Annotated[float, Interval(ge=1e-9, le=1e3)] | None = None
    depth: DepthSource = "auto"
    depth_model: Path | None = None
    depth_key: str | None = None
    min_confidence: Annotated[int, Interval(ge=0, le=255)] | None = None
    every: Annotated[int, Ge(1)] = 1
    max_frames: Annotated[int, Ge(1)] | None = None

    def __post_init__(self) -> None:
        check_options(self)
        if self.depth == "file" and self.depth_model is not None:
            raise OptionError(f"leave out depth_model={self.depth_model}: depth=file does not estimate depth")
        if self.world_up is not None:
            try:
                up_vector(self.world_up)
            except ValueError as error:
                raise OptionError(str(error)) from error


def up_vector(world_up: str | tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the up direction as a vector of the stored world.

    Raises:
        ValueError: It is not an axis name or a finite, non-zero 3-vector.
    """
    if isinstance(world_up, str):
        if world_up.lower() not in UP_AXES:
            raise ValueError(f"world_up is {world_up!r}; it must be one of {', '.join(UP_AXES)} or three numbers")
        return UP_AXES[world_up.lower()]
    if len(world_up) != 3 or not all(abs(value) < 1e12 for value in world_up) or not any(world_up):
        raise ValueError(f"world_up is {world_up!r}; it must be a finite, non-zero 3-vector")
    x, y, z = world_up
    return float(x), float(y), float(z)
