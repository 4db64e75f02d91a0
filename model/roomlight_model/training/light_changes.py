"""Sequences whose light changes at a frame: all of it, or one lamp that is switched on or off.

Generated and real-light walks have one light each. Here the images of some frames change, and with them the truth from
then on, so that recurrent networks learn to take up what frames show anew and to forget what they contradict.
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.camera import Intrinsics
from roomlight.conventions import panorama_directions
from roomlight.frame import Frame
from roomlight_model.training.examples import exposed
from roomlight_model.training.sequences import WalkExample

LAMP_SHARE: Final = 0.6
"""Share of the changes that are a lamp; the others scale all light."""
GAINS: Final = (1.5, 5.0)
"""Range of the factor between dim and bright light. The bright images are clipped."""
LAMP_RADIUS_M: Final = (0.06, 0.35)
LAMP_RADIANCE: Final = (2.0, 60.0)
"""Range of a lamp's radiance, in units of white."""
LAMP_GAIN: Final = (1.0, 1.25)
"""Range of the factor on all other light while the lamp is lit, for what it casts on the room."""
_IN_FRONT_M: Final = 0.02
"""Gap between a lamp and the surface behind it."""
_OCCLUDED_M: Final = 0.2
"""A point of the path from a probe to the lamp this far behind the surface that a frame shows is inside something."""
_NEAREST_LAMP_M: Final = 0.8
"""Smallest distance of a lamp's surface from cameras and probes."""


@dataclass(frozen=True)
class SphereLamp:
    """A sphere that emits the same radiance in every direction.

    Attributes:
        centre: In the world, metres.
        radiance: In units of the sequence's first frame, where 1 is white.
    """

    centre: Float[np.ndarray, "3"]
    radius_m: float
    radiance: Float32[np.ndarray, "3"]

    def along(
        self, origin: Float[np.ndarray, "3"], directions: Float[np.ndarray, "*shape 3"]
    ) -> Float[np.ndarray, "*shape"]:
        """Return the distance to the sphere along unit directions, infinite where they miss it."""
        towards = self.centre - origin
        middle = directions @ towards
        inside = self.radius_m**2 - (towards @ towards - middle**2)
        hit = (inside > 0) & (middle > 0)
        return np.where(hit, middle - np.sqrt(np.maximum(inside, 0)), np.inf)

    def shown_in(self, frame: Frame) -> Frame:
        """Return the frame with the lamp in it, in front of what is farther away; the image is not clipped."""
        image_covered = self._covers(frame, frame.intrinsics, frame.image.shape[:2])[0]
        depth_height, depth_width = frame.depth_m.shape
        covered, z_depth = self._covers(frame, frame.intrinsics.resized(depth_width, depth_height), frame.depth_m.shape)
        measured = covered & (frame.depth_m > 0)
        return replace(
            frame,
            image=np.where(image_covered[..., None], self.radiance, frame.image).astype(np.float32),
            depth_m=np.where(measured, z_depth, frame.depth_m).astype(np.float32),
        )

    def _covers(
        self, frame: Frame, intrinsics: Intrinsics, shape: tuple[int, ...]
    ) -> tuple[Bool[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        rays = intrinsics.rays().astype(np.float64)
        length = np.linalg.norm(rays, axis=-1)
        directions = rays / length[..., None] @ frame.camera_to_world[:3, :3].T
        z_depth = self.along(frame.camera_to_world[:3, 3], directions) / length
        behind = cv2.resize(frame.depth_m, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST_EXACT)
        return np.isfinite(z_depth) & ((behind <= 0) | (z_depth < behind)), z_depth

    def reaches(self, position: Float[np.ndarray, "3"], frame: Frame) -> bool:
        """Return whether no surface that the frame shows is between a point and the lamp."""
        shares = np.linspace(0.05, 0.95, 24)[:, None]
        ends = self.centre + self.radius_m * _unit(position - self.centre)
        world = position + shares * (ends - position)
        rotation, eye = frame.camera_to_world[:3, :3], frame.camera_to_world[:3, 3]
        height, width = frame.depth_m.shape
        xy, z_depth = frame.intrinsics.resized(width, height).project((world - eye) @ rotation)
        shown = (z_depth > 0) & (xy >= 0).all(-1) & (xy < (width, height)).all(-1)
        columns, rows = xy[shown].astype(int).T
        surface = frame.depth_m[rows, columns]
        return not bool(((surface > 0) & (z_depth[shown] > surface + _OCCLUDED_M)).any())

    def added_to(
        self, panoramas: Float[np.ndarray, "p h w 3"], positions: Float[np.ndarray, "p 3"], frame: Frame
    ) -> Float32[np.ndarray, "p h w 3"]:
        """Return the light at the points with the lamp in it, where `frame` shows nothing between them."""
        directions = panorama_directions(panoramas.shape[1])
        lit = panoramas.astype(np.float32)
        for panorama, position in zip(lit, positions, strict=True):
            if self.reaches(position, frame):
                panorama[np.isfinite(self.along(position, directions))] = self.radiance
        return lit


@dataclass(frozen=True)
class LightChanges:
    """Changes the light of a share of the sequences; the others get the same light twice (see `LightChange`)."""

    share: float

    def __call__(self, walk: WalkExample, rng: np.random.Generator) -> WalkExample:
        """Return the sequence with two lights and the images that they give."""
        length = len(walk.frames)
        plain = replace(walk, lights=np.repeat(walk.lights, 2, axis=0))
        if length < 2 or rng.random() >= self.share:
            return plain
        changes_at = int(rng.integers(1, length))
        becomes_brighter = bool(rng.random() < 0.5)
        lamp = _draw_lamp(walk, rng) if rng.random() < LAMP_SHARE else None
        gain = float(np.exp(rng.uniform(*np.log(LAMP_GAIN if lamp else GAINS))))
        bright_frames = [replace(frame, image=frame.image * np.float32(gain)) for frame in walk.frames]
        bright_light = walk.lights * np.float32(gain)
        if lamp is not None:
            positions, shown_by = walk.example.positions, walk.frames[changes_at]
            bright_frames = [lamp.shown_in(frame) for frame in bright_frames]
            bright_light = lamp.added_to(bright_light[0], positions, shown_by)[None]
        later = np.arange(length) >= changes_at
        bright = later == becomes_brighter
        first, *others = (
            exposed(lit, lit.image, white) if is_bright else dim
            for is_bright, lit, dim, white in zip(bright, bright_frames, walk.frames, walk.example.whites, strict=True)
        )
        lights = [walk.lights[0], bright_light[0]]
        return replace(
            walk,
            example=replace(walk.example, frame=first, later=tuple(others)),
            lights=np.stack(lights if becomes_brighter else lights[::-1]).astype(np.float32),
            light_of=later.astype(np.int64),
        )


def _draw_lamp(walk: WalkExample, rng: np.random.Generator) -> SphereLamp | None:
    """Draw a lamp in front of a surface of some frame; None where six draws are too near to cameras or probes."""
    eyes = np.stack([frame.camera_to_world[:3, 3] for frame in walk.frames])
    near = np.concatenate([eyes, walk.example.positions])
    for _ in range(6):
        frame = walk.frames[int(rng.integers(len(walk.frames)))]
        height, width = frame.depth_m.shape
        row, column = int(rng.integers(height)), int(rng.integers(width))
        radius_m = float(np.exp(rng.uniform(*np.log(LAMP_RADIUS_M))))
        ray = frame.intrinsics.resized(width, height).rays()[row, column].astype(np.float64)
        distance_m = float(frame.depth_m[row, column]) * np.linalg.norm(ray) - radius_m - _IN_FRONT_M
        centre = frame.camera_to_world[:3, 3] + distance_m * (frame.camera_to_world[:3, :3] @ _unit(ray))
        if np.linalg.norm(near - centre, axis=1).min() - radius_m >= _NEAREST_LAMP_M:
            colour = np.exp(rng.uniform(-0.25, 0, 3)) * np.exp(rng.uniform(*np.log(LAMP_RADIANCE)))
            return SphereLamp(centre, radius_m, colour.astype(np.float32))
    return None


def _unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
