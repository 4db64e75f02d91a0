"""What a user may state about a capture that its files do not say, or say wrongly."""

from dataclasses import dataclass
from typing import Final, Literal, get_args

from roomlight.errors import CaptureError

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
    """Overrides of a reader's defaults; None leaves the format's own.

    format:             force a reader, by its name in `FORMATS`.
    camera_convention:  axes of the camera in the stored poses: opengl (y up, z backward) or opencv (y down,
                        z forward).
    pose_direction:     what the stored poses are: camera-to-world or world-to-camera.
    world_up:           the direction in the stored world that points up: x, y, z, -x, -y, -z or a 3-vector.
    depth_unit_m:       metres for one stored unit of depth.
    depth_key:          which of several depth maps, by its key in a transforms.json.
    min_confidence:     depth whose confidence is below this is removed; ARKit's are 0 (low), 1 and 2. Default 1.
    every, max_frames:  take every n-th record, and at most so many of them.
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
        """Refuse values that mean nothing, before any file is opened."""
        if self.camera_convention not in (None, *get_args(CameraConvention)):
            raise CaptureError(f"camera convention {self.camera_convention!r} is neither 'opengl' nor 'opencv'")
        if self.pose_direction not in (None, *get_args(PoseDirection)):
            raise CaptureError(
                f"pose direction {self.pose_direction!r} is neither 'camera-to-world' nor 'world-to-camera'"
            )
        if self.world_up is not None:
            try:
                up_vector(self.world_up)
            except ValueError as error:
                raise CaptureError(str(error)) from error
        unit = self.depth_unit_m
        if unit is not None and not 1e-9 <= unit <= 1e3:
            raise CaptureError(f"depth unit must be metres for one stored unit, from 1e-9 to 1000, got {unit}")
        if self.every < 1:
            raise CaptureError(f"every {self.every} frames: must be 1 or more")
        if self.max_frames is not None and self.max_frames < 1:
            raise CaptureError(f"at most {self.max_frames} frames: must be 1 or more")


def up_vector(world_up: str | tuple[float, float, float]) -> tuple[float, float, float]:
    """The up direction as a vector of the stored world; ValueError if it is none."""
    if isinstance(world_up, str):
        if world_up.lower() not in UP_AXES:
            raise ValueError(f"world up {world_up!r} is none of {', '.join(UP_AXES)} (or three numbers)")
        return UP_AXES[world_up.lower()]
    if len(world_up) != 3 or not all(abs(value) < 1e12 for value in world_up) or not any(world_up):
        raise ValueError(f"world up {world_up!r} is not a finite, non-zero 3-vector")
    x, y, z = world_up
    return float(x), float(y), float(z)
