"""Options of reading a capture: facts that its files do not state, or state wrongly."""

from dataclasses import dataclass
from typing import Final, Literal, get_args

from roomlight.errors import OptionError

CameraConvention = Literal["opengl", "opencv"]
PoseDirection = Literal["camera-to-world", "world-to-camera"]

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
    """Options of reading a capture; None keeps the format's default.

    Attributes:
        format: Name of the reader to use, one of `FORMATS`; None detects it.
        camera_convention: Camera axes of the stored poses: "opengl" (y up, z backward) or "opencv" (y down,
            z forward).
        pose_direction: Direction of the stored poses: "camera-to-world" or "world-to-camera".
        world_up: Up direction of the stored world: x, y, z, -x, -y, -z or a 3-vector.
        depth_unit_m: Metres for one stored unit of depth.
        depth_key: Key of the depth map in a transforms.json that lists several.
        min_confidence: Depth of lower confidence is removed; ARKit's levels are 0 (low), 1 and 2. Default 1.
        every: Read every n-th record.
        max_frames: Read at most this many records.

    Raises:
        OptionError: A value is out of range or unknown.
    """

    format: str | None = None
    camera_convention: str | None = None
    pose_direction: str | None = None
    world_up: str | tuple[float, float, float] | None = None
    depth_unit_m: float | None = None
    depth_key: str | None = None
    min_confidence: int | None = None
    every: int = 1
    max_frames: int | None = None

    def __post_init__(self) -> None:
        _check_choice("camera_convention", self.camera_convention, get_args(CameraConvention))
        _check_choice("pose_direction", self.pose_direction, get_args(PoseDirection))
        if self.world_up is not None:
            try:
                up_vector(self.world_up)
            except ValueError as error:
                raise OptionError(str(error)) from error
        unit = self.depth_unit_m
        if unit is not None and not 1e-9 <= unit <= 1e3:
            raise OptionError(f"depth_unit_m is {unit}; it must be the metres for one stored unit, 1e-9 to 1000")
        if self.every < 1:
            raise OptionError(f"every is {self.every}; it must be 1 or more")
        if self.max_frames is not None and self.max_frames < 1:
            raise OptionError(f"max_frames is {self.max_frames}; it must be 1 or more")


def _check_choice(name: str, value: str | None, choices: tuple[str, ...]) -> None:
    if value is not None and value not in choices:
        raise OptionError(f"{name} is {value!r}; it must be one of {', '.join(choices)}")


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
