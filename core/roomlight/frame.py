"""A frame: colour, depth and camera. Readers yield frames, sessions take them."""

import operator
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16

from roomlight.camera import Intrinsics, check_rigid
from roomlight.conventions import linear_to_srgb8
from roomlight.depth import DEPTH_MEDIAN_M, clean_depth, without_unseen
from roomlight.errors import FrameError
from roomlight.rules import check_type, is_finite

CLIPPED_SRGB8: Final = 250
"""8-bit values from here up count as clipped: JPEG ringing and noise keep true white below 255."""


def clipped_pixels(rgb: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Return where a channel of encoded sRGB is clipped; NumPy's maximum along an axis of 3 takes 8 times as long."""
    limit = CLIPPED_SRGB8 * (int(np.iinfo(rgb.dtype).max) // 255)
    return np.maximum(np.maximum(rgb[..., 0], rgb[..., 1]), rgb[..., 2]) >= limit


MAX_POSITION_M: Final = 10_000.0
"""Largest coordinate of cameras, objects and probes: beyond it float32 metres cannot represent a millimetre; no indoor
capture is so large."""
MAX_RADIANCE: Final = 1e12
"""Brightest pixel: white is 1 and the sun a million; from about 1e19 up its square overflows float32."""
BLACK: Final = 0.002
"""A frame is black if no part of it is brighter in the mean, of 32 x 24 parts. A dark room is at 0.003 and more."""
ASPECT_TOLERANCE: Final = 0.03
"""Largest relative difference between the aspect ratios of depth and image."""


@dataclass(frozen=True, eq=False)
class Frame:
    """An RGB-D image with a pose, in RoomLight's conventions (`roomlight.conventions`).

    Every value is checked here, so that the kernels, which check nothing, get finite, contiguous float32.

    Attributes:
        image: linear RGB radiance, float32 [h, w, 3], relative to the session's reference exposure.
        clipped: bool [h, w]: pixels whose sensor value saturated, whose true radiance is at least this.
        depth_m: z-depth in metres, float32 [dh, dw], 0 = unknown (what is not finite or below 0 becomes 0); same view
            as the image, any size of at least 2 x 2.
        intrinsics: of the image (depth's are the same, resized).
        camera_to_world: rigid 4 x 4, float64.
        index: number of the frame in its stream, 0 or more.
        timestamp_s: seconds, from any origin.
        source: name of the frame in messages, e.g. its file.
        guessed: float32 [h, w]: luminance of the image that is an estimate for clipped pixels
            (`roomlight.engine.networks.clipping`); image less this is the least that it can be. None: nothing is
            estimated.
        seen: bool [h, w]: pixels that show something; None: all do. The others (transparent or masked) count for
            nothing: `hidden` gives them no depth and the colour around them.
        auto_exposed: the camera chose exposure and white balance of this image, and nothing states them: the image is
            in a unit of its own, and a session fits it to what it has seen (`roomlight.engine.surface.drift`).
        depth_estimated: the depth is a network's (`roomlight.monocular`): surfaces may lean by tens of degrees.
        exposure: of the recorded image, relative to the reference exposure: `image` was divided by it.

    Raises:
        FrameError: parts do not fit each other, radiance is negative or not finite, the pose is not rigid, or the depth
            is not in metres.

    Examples:
        >>> import roomlight as rl
        >>> frame = next(iter(rl.open_capture(rl.sample_capture())))
        >>> frame.image.shape == (frame.intrinsics.height, frame.intrinsics.width, 3)
        True
    """

    index: int
    image: Float[np.ndarray, "h w 3"]
    clipped: Bool[np.ndarray, "h w"]
    depth_m: Float[np.ndarray, "dh dw"]
    intrinsics: Intrinsics
    camera_to_world: Float[np.ndarray, "4 4"]
    timestamp_s: float | None = None
    source: str = ""
    guessed: Float[np.ndarray, "h w"] | None = None
    seen: Bool[np.ndarray, "h w"] | None = None
    auto_exposed: bool = False
    depth_estimated: bool = False
    exposure: float = 1.0

    def __post_init__(self) -> None:
        name = self.source or f"frame {self.index}"
        try:
            object.__setattr__(self, "index", operator.index(self.index))
        except TypeError as error:
            raise FrameError(f"{name}: the index is {self.index!r}, not a whole number") from error
        if self.index < 0:
            raise FrameError(f"{name}: the index is {self.index}; frames are numbered from 0 on")
        if self.timestamp_s is not None:
            if not is_finite(self.timestamp_s):
                raise FrameError(f"{name}: timestamp_s is {self.timestamp_s!r}, not a number of seconds")
            object.__setattr__(self, "timestamp_s", float(self.timestamp_s))
        if not is_finite(self.exposure) or self.exposure <= 0:
            raise FrameError(f"{name}: the exposure is {self.exposure!r}; relative to the reference it is above 0")
        object.__setattr__(self, "exposure", float(self.exposure))
        check_type(self.intrinsics, Intrinsics, f"{name}: intrinsics", FrameError)
        if not _is_float(self.image, 3) or self.image.shape[2] != 3:
            raise FrameError(
                f"{name}: the image is {_kind_of(self.image)}, not linear float RGB [h, w, 3]; "
                "roomlight.conventions.srgb8_to_linear decodes 8-bit sRGB"
            )
        if not _is_float(self.depth_m, 2):
            raise FrameError(
                f"{name}: the depth is {_kind_of(self.depth_m)}, not float metres [h, w]; "
                "multiply stored integers by their unit; 0 is unknown"
            )
        height, width = self.image.shape[:2]
        if (self.intrinsics.width, self.intrinsics.height) != (width, height):
            raise FrameError(
                f"{name}: the image is {width} x {height} but its intrinsics are for "
                f"{self.intrinsics.width} x {self.intrinsics.height}"
            )
        object.__setattr__(self, "clipped", _checked_mask(self.clipped, (height, width), f"{name}: the clipping mask"))
        if self.seen is not None:
            mask = _checked_mask(self.seen, (height, width), f"{name}: the mask of seen pixels")
            object.__setattr__(self, "seen", mask)
        if self.guessed is not None:
            fits = _is_float(self.guessed, 2) and self.guessed.shape == (height, width)
            if not fits or not (np.isfinite(self.guessed) & (self.guessed >= 0)).all():
                what = _kind_of(self.guessed)
                raise FrameError(f"{name}: the estimated luminance, {what}, must fit the image and be 0 or more")
            object.__setattr__(self, "guessed", np.ascontiguousarray(self.guessed, np.float32))
        depth_height, depth_width = self.depth_m.shape
        if min(depth_height, depth_width) < 2:
            raise FrameError(f"{name}: depth of {depth_width} x {depth_height} is too small; 2 x 2 is the least")
        if abs(depth_width / depth_height - width / height) > ASPECT_TOLERANCE * width / height:
            raise FrameError(
                f"{name}: depth of {depth_width} x {depth_height} has another aspect than the image "
                f"of {width} x {height}"
            )
        try:
            pose = check_rigid(self.camera_to_world)
        except (TypeError, ValueError) as error:
            raise FrameError(f"{name}: {error}") from error
        far_m = float(np.abs(pose[:3, 3]).max())
        if far_m > MAX_POSITION_M:
            raise FrameError(
                f"{name}: the pose is {far_m:.3g} m from the origin; tracking was lost, or the unit is not "
                f"metres (limit: {MAX_POSITION_M:.0f} m)"
            )
        depth_m, (_, most_m) = clean_depth(self.depth_m), DEPTH_MEDIAN_M
        if depth_m.max() > most_m and (median_m := float(np.median(depth_m[depth_m > 0]))) > most_m:
            raise FrameError(
                f"{name}: the median depth is {median_m:.4g} m, more than {most_m:g} m; is it in millimetres or "
                f"centimetres?"
            )
        object.__setattr__(self, "image", _checked_image(self.image, name))
        object.__setattr__(self, "depth_m", depth_m)
        object.__setattr__(self, "camera_to_world", pose)

    def _repr_png_(self) -> bytes:
        from roomlight.images import encode_png  # which imports this module

        return encode_png(linear_to_srgb8(self.image))

    @property
    def recorded(self) -> Float32[np.ndarray, "h w 3"]:
        """The image in its own exposure, linear: 1 is white in the recording."""
        return self.image if self.exposure == 1.0 else self.image * np.float32(self.exposure)

    @property
    def is_black(self) -> bool:
        """Whether the image shows nothing, as the first ones of cameras that start, and of films that fade in."""
        parts = cv2.resize(self.image, (32, 24), interpolation=cv2.INTER_AREA)
        return float(parts.max()) * max(1.0, self.exposure) <= BLACK

    def scaled(self, factor: float) -> "Frame":
        """Return the frame with depth and the camera's place in another unit: `factor` of it are the present one."""
        pose = self.camera_to_world.copy()
        pose[:3, 3] *= factor
        return replace(self, depth_m=self.depth_m * np.float32(factor), camera_to_world=pose)

    def resized(self, max_width: int, max_height: int) -> "Frame":
        """Reduce image and depth to fit into a box, with the same aspect; nothing is enlarged.

        Width and height of the box are swapped for an upright image, so that both orientations keep as many pixels.
        Colour is averaged by area in linear light. Depth takes the nearest sample, because a mean across an edge is a
        surface that does not exist.
        """
        height, width = self.image.shape[:2]
        if (height > width) != (max_height > max_width):
            max_width, max_height = max_height, max_width
        scale = min(1.0, max_width / width, max_height / height)
        new_width, new_height = max(2, round(width * scale)), max(2, round(height * scale))
        image, clipped, guessed, seen = self.image, self.clipped, self.guessed, self.seen
        if (new_width, new_height) != (width, height):
            image = cv2.resize(image, (new_width, new_height), interpolation=cv2.INTER_AREA)
            share = cv2.resize(clipped.astype(np.float32), (new_width, new_height), interpolation=cv2.INTER_AREA)
            clipped = share >= 0.5
            if guessed is not None:
                guessed = cv2.resize(guessed, (new_width, new_height), interpolation=cv2.INTER_AREA)
            if seen is not None:
                share = cv2.resize(seen.astype(np.float32), (new_width, new_height), interpolation=cv2.INTER_AREA)
                seen = share >= 0.5
        depth = self.depth_m
        if depth.shape[0] > new_height or depth.shape[1] > new_width:
            depth = cv2.resize(depth, (new_width, new_height), interpolation=cv2.INTER_NEAREST_EXACT)
        return replace(
            self,
            image=image,
            clipped=clipped,
            guessed=guessed,
            seen=seen,
            depth_m=depth,
            intrinsics=self.intrinsics.resized(new_width, new_height),
        )


def hidden(
    image: Float[np.ndarray, "h w 3"], depth_m: Float[np.ndarray, "dh dw"], seen: Bool[np.ndarray, "h w"]
) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "dh dw"]]:
    """Return image and depth without the pixels that are not seen: their depth is 0, their colour that around them.

    The colour matters where a consumer knows no mask, such as a server: neither black nor what an editor left there.
    """
    weight = seen.astype(np.float32)
    known = image.astype(np.float32) * weight[..., None]
    filled = np.broadcast_to(known.sum(axis=(0, 1)) / max(float(weight.sum()), 1.0), image.shape).astype(np.float32)
    for side in (257, 65, 17, 5):  # from far to near, so that the nearest colour stays
        share = cv2.blur(weight, (side, side))
        near = cv2.blur(known, (side, side)) / np.maximum(share, 1e-6)[..., None]
        filled = np.where(share[..., None] > 1e-3, near, filled)
    colour = np.where(seen[..., None], image, np.maximum(filled, 0)).astype(np.float32)
    return colour, without_unseen(depth_m, seen)


def _is_float(values: object, axes: int) -> bool:
    return isinstance(values, np.ndarray) and values.dtype.kind == "f" and values.ndim == axes


def _kind_of(values: object) -> str:
    if isinstance(values, np.ndarray):
        return f"{values.dtype} of shape {values.shape}"
    remedy = " (pass its .numpy())" if hasattr(values, "numpy") else ""
    return "None" if values is None else f"of the type {type(values).__name__}{remedy}"


def _checked_mask(mask: object, size: tuple[int, int], what: str) -> Bool[np.ndarray, "h w"]:
    """Return a mask as bool; of whole numbers, as OpenCV's masks are, those but 0 count."""
    if not isinstance(mask, np.ndarray) or mask.shape != size or mask.dtype.kind not in "bui":
        raise FrameError(f"{what} is {_kind_of(mask)}; it must be bool of shape {size}")
    return np.ascontiguousarray(mask if mask.dtype == np.bool_ else mask != 0)


def _checked_image(image: Float[np.ndarray, "h w 3"], name: str) -> Float32[np.ndarray, "h w 3"]:
    """Return contiguous float32, checked: 1.6 ms for 1920 x 1440 pixels, 0.02 ms for 320 x 240."""
    with np.errstate(over="ignore"):
        radiance = np.ascontiguousarray(image, np.float32)
    if radiance.size == 0 or not (radiance.min() >= 0 and radiance.max() <= MAX_RADIANCE):  # NaN compares as neither
        bad = int((~((radiance >= 0) & (radiance <= MAX_RADIANCE))).sum())
        raise FrameError(
            f"{name}: {bad} of {image.size} radiances are NaN, infinite, below 0 or over {MAX_RADIANCE:g}; "
            "repair the image first"
        )
    return radiance
