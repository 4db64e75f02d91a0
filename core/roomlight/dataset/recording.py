"""A generated sequence: the type that is stored, loaded and trained on."""

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float, Float16, Float32, UInt8, UInt16

from roomlight.camera import Intrinsics
from roomlight.conventions import Position, srgb8_to_linear
from roomlight.frame import CLIPPED_SRGB8, Frame

Split = Literal["train", "test"]

ORDINARY: Final = 0
GLASS: Final = 1
MIRROR: Final = 2
LIGHT: Final = 3
"""Kinds of surface, as a depth sensor distinguishes them; `LIGHT` is a visible light source."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames, exact depth, poses and ground-truth panoramas of one camera walk through one room.

    World frame: y up, metres; poses are camera-to-world with OpenGL axes.

    Attributes:
        name: Name of the sequence, such as `train-000012`.
        colour: sRGB 8-bit images of the simulated phone camera: exposed, clipped, noisy.
        depth_mm: Exact z-depth in millimetres, 0 where nothing is hit (open sky). Panes, mirrors and lamps count as
            surfaces at their own depth.
        surface: Kind of surface: `ORDINARY`, `GLASS`, `MIRROR` or `LIGHT`.
        intrinsics: The camera, in pixels; one for all frames.
        camera_to_world: Poses.
        exposure: Exposure relative to the first frame's: exposure[0] = 1.
        timestamp_s: Times in seconds.
        probe_positions: Positions of the ground-truth panoramas, world, metres.
        probe_panoramas: Linear RGB panoramas, H x 2H, in units of the first frame: 1.0 is shown as white there.
        facts: Statistics that training does not need: room type, seeds, light sources, kilocandela per square metre
            for 1.0, attributions.
        clipped_radiance: True radiance of the clipped pixels: linear RGB, the mean over the pixel's area before the
            sensor, in units of that frame's own white. 0 where the image is not clipped (no channel at
            `roomlight.frame.CLIPPED_SRGB8` or above, before JPEG). None if it was not stored or not requested.
    """

    name: str
    colour: UInt8[np.ndarray, "f h w 3"]
    depth_mm: UInt16[np.ndarray, "f h w"]
    surface: UInt8[np.ndarray, "f h w"]
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "f 4 4"]
    exposure: Float[np.ndarray, " f"]
    timestamp_s: Float[np.ndarray, " f"]
    probe_positions: Float[np.ndarray, "p 3"]
    probe_panoramas: Float[np.ndarray, "p ph pw 3"]
    facts: dict[str, Any]
    clipped_radiance: Float16[np.ndarray, "f h w 3"] | None = None

    @property
    def room(self) -> str:
        """The room, as `room_of` names it; the own name where it is not known."""
        return room_of(self.facts) or self.name

    def true_panoramas(self) -> Float32[np.ndarray, "p ph pw 3"]:
        """Return the light at each probe, in units of the first decoded frame's white."""
        return self.probe_panoramas.astype(np.float32) * np.float32(self.exposure[0])

    def truths(self) -> list[tuple[Position, Float32[np.ndarray, "ph pw 3"]]]:
        """Return the place of each probe, world, metres, and its light as `true_panoramas` gives it."""
        places: list[Position] = [(float(x), float(y), float(z)) for x, y, z in self.probe_positions]
        return list(zip(places, self.true_panoramas(), strict=True))

    def frame(self, number: int, depth_mm: UInt16[np.ndarray, "dh dw"]) -> Frame:
        """Return a frame as a client would send it, in units of the first decoded frame's white.

        `depth_mm` is its z-depth in millimetres, exact or as a phone measures it; 0 is unknown.
        """
        return Frame(
            index=number,
            image=srgb8_to_linear(self.colour[number]) * np.float32(self.exposure[0] / self.exposure[number]),
            clipped=(self.colour[number] >= CLIPPED_SRGB8).any(-1),
            depth_m=depth_mm.astype(np.float32) / np.float32(1000),
            intrinsics=self.intrinsics,
            camera_to_world=self.camera_to_world[number],
            source=self.name,
        )


def room_of(facts: Any) -> str | None:
    """Return the room that facts state: recordings of one room are alike.

    Rooms lit by panoramas of one building are one room, as is a scene of Blender. Others have a seed and a number.
    """
    match facts:
        case {"room": str(name)} | {"light": {"building": str(name)}} | {"scene": str(name)}:
            return name
        case {"made": {"split": split, "room_seed": seed, "room": number}}:
            return f"{split}-{seed}-{number}"
        case {"room": int(number)}:
            return str(number)
        case _:
            return None
