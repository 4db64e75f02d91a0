"""A composited frame with its layers, and how it is encoded."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

from roomlight.compositing.picture.crop import NO_CROP, Crop
from roomlight.compositing.placement.places import Placement
from roomlight.conventions import linear_to_srgb8
from roomlight.frame import Frame
from roomlight.images import encode_png
from roomlight.kernels.encode import compose_rows, encode_values
from roomlight.threads import parallel_for


@dataclass(frozen=True, eq=False, kw_only=True)
class Composite:
    """A frame with objects, and its layers: image = plate x shadow x (1 - alpha) + objects.

    In memory the shadow has the pixels of `crop` and the other layers those of `object_crop`; the properties are of
    the frame's size. Without crops and their layers it is a frame that no object changes.

    Attributes:
        image: [h, w, 3] 8-bit sRGB, with the camera's noise on the objects.
        frame: what objects were put into.
        crop: rectangle outside which the frame is unchanged.
        object_crop: rectangle outside which there is no object, within `crop`.
        stage_ms: milliseconds by stage: place, light, depth, camera, scene, render, shadow, occlusion, combine.
        waiting: names of objects whose pixel belongs to a frame that was not composited yet.
        stage_cpu_ms: processor time by stage, of the whole process.
        samples: light paths that each pixel of the objects got; 0 for a preview.
        visible: share that real things leave of each object in the picture, by its index in the scene.
        placements: where the objects that have a place stand, before their motion, by index in the scene.
        gain: factors of red, green and blue by which the recorded frame's radiance becomes that of the light.
    """

    image: UInt8[np.ndarray, "h w 3"]
    frame: Frame
    stage_ms: dict[str, float]
    stage_cpu_ms: dict[str, float]
    waiting: tuple[str, ...]
    crop: Crop = NO_CROP
    object_crop: Crop = NO_CROP
    crop_objects: Float32[np.ndarray, "oh ow 3"] = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    crop_alpha: Float32[np.ndarray, "oh ow"] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    crop_shadow: Float32[np.ndarray, "ch cw 3"] = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    crop_depth_m: Float32[np.ndarray, "oh ow"] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    crop_object_id: Int32[np.ndarray, "oh ow"] = field(default_factory=lambda: np.zeros((0, 0), np.int32))
    samples: int = 0
    visible: dict[int, float] = field(default_factory=dict[int, float])
    placements: dict[int, Placement] = field(default_factory=dict[int, Placement])
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @cached_property
    def objects(self) -> Float32[np.ndarray, "h w 3"]:
        """Linear radiance of the objects times alpha, without noise."""
        return self._whole(self.crop_objects, self.object_crop, 0)

    @cached_property
    def alpha(self) -> Float32[np.ndarray, "h w"]:
        """Share of a pixel that objects cover, 0 to 1; real things in front taken off."""
        return self._whole(self.crop_alpha, self.object_crop, 0)

    @cached_property
    def shadow(self) -> Float32[np.ndarray, "h w 3"]:
        """Light on the real surfaces with objects / without them, by channel: 1 is unchanged."""
        return self._whole(self.crop_shadow, self.crop, 1)

    @cached_property
    def depth_m(self) -> Float32[np.ndarray, "h w"]:
        """Depth of the objects (z-depth, metres), also where real things hide them, 0 where there is none."""
        return self._whole(self.crop_depth_m, self.object_crop, 0)

    @cached_property
    def object_id(self) -> Int32[np.ndarray, "h w"]:
        """Index of the object in the scene, also where real things hide it, -1 where there is none."""
        return self._whole(self.crop_object_id, self.object_crop, -1)

    @property
    def plate(self) -> Float32[np.ndarray, "h w 3"]:
        """The frame as it was recorded, in linear radiance; 0 where it shows nothing."""
        seen = self.frame.seen
        return self.frame.recorded if seen is None else self.frame.recorded * seen[..., None]

    @cached_property
    def radiance(self) -> Float32[np.ndarray, "h w 3"]:
        """The composite in linear radiance, unclipped, without added noise."""
        return self.plate * (self.shadow * (1 - self.alpha[..., None])) + self.objects

    def _repr_png_(self) -> bytes:
        """Return the picture for a notebook."""
        return encode_png(self.image)

    def _whole(self, part: np.ndarray, crop: Crop, outside: int) -> np.ndarray:
        whole = np.full((*self.frame.image.shape[:2], *part.shape[2:]), outside, part.dtype)
        whole[crop.slices] = part
        return whole


def encode_srgb8(linear: Float32[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Encode as `roomlight.conventions.linear_to_srgb8`, by table: 1 ms for 640 x 480 pixels on two cores."""
    values = np.ascontiguousarray(linear, np.float32).reshape(-1)
    out = np.empty(len(values), np.uint8)
    parallel_for(lambda start, stop: encode_values(values, _srgb_table(), out, start, stop), len(values))
    return out.reshape(linear.shape)


def compose_srgb8(
    encoded: UInt8[np.ndarray, "h w 3"],
    frame: Float32[np.ndarray, "h w 3"],
    ratio: Float32[np.ndarray, "h w 3"],
    objects: Float32[np.ndarray, "oh ow 4"],
    corner: tuple[int, int],
) -> None:
    """Write frame x ratio x (1 - alpha) + objects to `encoded`, which holds the encoded frame, where it differs.

    Args:
        objects: radiance times alpha, and alpha, of a rectangle of the image.
        corner: its first row and column.
    """
    arguments = (frame, ratio, objects, corner, _srgb_table(), encoded)
    parallel_for(lambda start, stop: compose_rows(*arguments, start, stop), len(ratio))


@lru_cache(maxsize=1)
def _srgb_table() -> UInt8[np.ndarray, "65536"]:
    return linear_to_srgb8(np.arange(65536, dtype=np.float64) / 65535)


class BehindGlass:
    """The frame as seen through glass: as if everything behind were far away; NaN outside the picture."""

    def __init__(self, frame: Frame) -> None:
        self._image, self._camera = frame.image, frame.intrinsics
        self._rotation = frame.camera_to_world[:3, :3].astype(np.float32)

    def __call__(self, directions: Float32[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the radiance of the frame in unit world directions."""
        xy, _ = self._camera.project(directions @ self._rotation)
        maps = np.nan_to_num(xy, nan=-10.0, posinf=-10, neginf=-10).astype(np.float32)[None] - np.float32(0.5)
        size = np.array([self._camera.width, self._camera.height])
        inside = ((maps[0] > -0.5) & (maps[0] < size - 0.5)).all(axis=-1)
        seen = np.full(directions.shape, np.nan, np.float32)
        for start in range(0, len(directions), 30_000):  # OpenCV's remap takes at most 32,767 columns
            part = slice(start, start + 30_000)
            values = cv2.remap(
                self._image, maps[:, part, 0], maps[:, part, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )[0]
            seen[part] = np.where(inside[part, None], values, np.float32(np.nan))
        return seen
