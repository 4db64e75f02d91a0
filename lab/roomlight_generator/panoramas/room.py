"""A room whose surfaces and lights are a panorama projected onto its shell: renders frames and probes' panoramas.

World frame: y up, metres; radiance in kcd/m2; panoramas world-aligned (`roomlight.conventions`).
"""

from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from roomlight.camera import Intrinsics
from roomlight.conventions import LUMINANCE, panorama_solid_angles
from roomlight.dataset.recording import GLASS, LIGHT, ORDINARY
from roomlight.spheres import resize_panorama
from roomlight_generator.panoramas.furnished import CELL_M as FURNITURE_CELL_M
from roomlight_generator.panoramas.furnished import FurnishedLight, padded
from roomlight_generator.panoramas.furniture import Footprint, Furniture, still_free
from roomlight_generator.panoramas.kernels import shell_views
from roomlight_generator.panoramas.kernels.shell_views import CameraArrays, PanoramaArrays
from roomlight_generator.panoramas.shell import CELL_M, PanoramaShell
from roomlight_generator.sequences.walk import FreeSpace
from roomlight_generator.transport import FrameView, z_depth
from roomlight_generator.transport.paths import follow_view

FINER: Final = 2
"""Frames are rendered at this many times their height and averaged."""
_BRIGHT: Final = 3.0
"""Sources of light are this many times as bright as the panorama's 80th percentile, which a phone shows as 0.3 to 0.6
of white."""
_WINDOW_SR: Final = 0.03
"""Larger sources may be windows: 17 x 6 degrees."""
_WINDOW_ELEVATION: Final = (-0.35, 0.75)
"""Range of the sine of a window's elevation: sources above are ceiling lights, bright areas below are sunny floors."""
_GLASS_SHARE: Final = 0.75
"""Share of the possible windows that are glass to a depth sensor."""


class PanoramaRoom:
    """A shell with a panorama on it."""

    def __init__(
        self,
        shell: PanoramaShell,
        image: Float32[np.ndarray, "h w 3"],
        kinds: UInt8[np.ndarray, "h w"],
        furniture: Furniture | None = None,
    ) -> None:
        """Take a shell, the panorama's radiance (kcd/m2), the kind of surface of its pixels, and furniture."""
        self.shell = shell
        self._shade = np.empty((0, 3), np.float32)
        self._furniture: FurnishedLight | None = None
        emitted, reflected = image, np.zeros_like(image)
        self._footprints: tuple[Footprint, ...] = ()
        if furniture is not None and furniture.items:
            self._footprints = furniture.footprints
            self._furniture = FurnishedLight(shell, image, bright_parts(image), furniture)
            emitted, reflected = self._furniture.emitted, self._furniture.reflected
            self._shade = self._furniture.shade
        self._panorama = PanoramaArrays(padded(emitted), padded(reflected), kinds, shell.centre)

    def free_space(self) -> FreeSpace:
        """Return where a camera can be: near the centre, off the walls and the furniture."""
        walkable, points = self.shell.walkable()
        origin = float(points[0, 0, 0]), float(points[0, 0, 1])
        return FreeSpace(still_free(walkable, points, self._footprints), origin, CELL_M, self._distances)

    def _distances(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, " n"]:
        """Return the distance in metres along each ray to the shell or the furniture."""
        reach = self.shell.distances(origins, directions)
        if self._furniture is None:
            return reach
        return np.minimum(reach, self._furniture.tracer.distances(origins, directions))

    def frame(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], *, seed: int) -> FrameView:
        """Render what a pinhole camera sees; the pose is camera-to-world, OpenGL axes."""
        del seed  # the picture has no noise
        larger = intrinsics.resized(FINER * intrinsics.width, FINER * intrinsics.height)
        fine = self._picture(_pinhole(larger, camera_to_world))
        radiance = fine.reshape(intrinsics.height, FINER, intrinsics.width, FINER, 3).mean((1, 3), dtype=np.float32)
        camera = _pinhole(intrinsics, camera_to_world)
        distance = np.empty((camera.height, camera.width))
        kinds = np.empty((camera.height, camera.width), np.uint8)
        shell_views.centres(self.shell.arrays, self._panorama, camera, distance, kinds)
        if self._furniture is not None:
            seen = follow_view(self._furniture.tracer, *_rays(camera))
            reach, surface = (part.reshape(distance.shape) for part in (seen.distance_m, seen.surface))
            kinds = np.where(reach < distance, surface, kinds)
            distance = np.minimum(distance, reach)
        return FrameView(radiance, z_depth(intrinsics, distance.ravel()), kinds)

    def depth(self, intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]) -> Float32[np.ndarray, "h w"]:
        """Compute the depth of `frame` alone."""
        origins, directions = _rays(_pinhole(intrinsics, camera_to_world))
        return z_depth(intrinsics, self._distances(origins, directions))

    def panorama(
        self, position: Float[np.ndarray, "3"], height: int = 120, *, seed: int
    ) -> Float32[np.ndarray, "{height} 2*{height} 3"]:
        """Render the radiance that arrives at a point from all sides, the mean over each pixel."""
        del seed
        finer = 1 if self._furniture is None else FINER  # the shell alone is exact at any size
        rows = finer * height
        fine = self._picture(CameraArrays(np.asarray(position, np.float64), np.eye(3), np.zeros(4), rows, 2 * rows))
        return resize_panorama(fine, height)

    def _picture(self, camera: CameraArrays) -> Float32[np.ndarray, "h w 3"]:
        image = np.empty((camera.height, camera.width, 3), np.float32)
        shell_views.picture(self.shell.arrays, self._shade, self._panorama, camera, image)
        if self._furniture is not None:
            origins, directions = _rays(camera)
            reach = self.shell.distances(origins, directions)
            sphere = camera.lens[0] == 0
            angle = np.pi / camera.height if sphere else 1 / camera.lens[0]
            on, radiance, _ = self._furniture.shaded(
                origins, directions, reach, float(angle), cell_m=FURNITURE_CELL_M[int(sphere)]
            )
            image.reshape(-1, 3)[on] = radiance
        return image


def classify_surfaces(image: Float32[np.ndarray, "h w 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "h w"]:
    """Return the kinds of surface in a panorama.

    Bright areas are lights. Three of four large bright areas at the height of windows are glass, because phones see
    through some panes and measure others. Sunny floors are ordinary surfaces.
    """
    bright = bright_parts(image)
    count, labels, _, middles = cv2.connectedComponentsWithStats(bright.astype(np.uint8))
    area = np.broadcast_to(panorama_solid_angles(len(image)), bright.shape)
    solid = np.bincount(labels.ravel(), weights=area.ravel(), minlength=count)
    elevation = np.cos((middles[:, 1] + 0.5) / len(image) * np.pi)
    low, high = _WINDOW_ELEVATION
    glass = (solid > _WINDOW_SR) & (elevation > low) & (elevation < high) & (rng.random(count) < _GLASS_SHARE)
    kind = np.where(glass, GLASS, np.where(elevation > low, LIGHT, ORDINARY)).astype(np.uint8)
    kind[0] = ORDINARY  # the background
    return kind[np.asarray(labels, np.int64)]


def bright_parts(image: Float32[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Return the mask of a panorama's bright parts: sources of light, and surfaces that they light from near."""
    luminance = image @ LUMINANCE
    return luminance > _BRIGHT * max(percentile(luminance, 80.0), 1e-9)


def percentile(luminance: Float32[np.ndarray, "h w"], percent: float) -> float:
    """Return a percentile of a panorama over the sphere: each pixel, of 64 rows, counts by its solid angle."""
    luminance = cv2.resize(luminance, (128, 64), interpolation=cv2.INTER_AREA)
    order = np.argsort(luminance, axis=None)
    weight = np.broadcast_to(panorama_solid_angles(len(luminance)), luminance.shape).ravel()[order].cumsum()
    return float(luminance.ravel()[order[np.searchsorted(weight, percent / 100 * weight[-1])]])


def _pinhole(intrinsics: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"]) -> CameraArrays:
    lens = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy], np.float64)
    pose = np.asarray(camera_to_world, np.float64)
    rotation = np.ascontiguousarray(pose[:3, :3])
    return CameraArrays(pose[:3, 3].copy(), rotation, lens, intrinsics.height, intrinsics.width)


def _rays(camera: CameraArrays) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 3"]]:
    """Return origins and unit directions of the rays through the pixels' centres."""
    directions = np.empty((camera.height * camera.width, 3), np.float32)
    shell_views.directions(camera, directions)
    return np.broadcast_to(camera.position.astype(np.float32), directions.shape).copy(), directions


def describe(kinds: UInt8[np.ndarray, "h w"]) -> dict[str, Any]:
    """Return the shares of the sphere that are glass and lights."""
    weight = np.broadcast_to(panorama_solid_angles(len(kinds)), kinds.shape) / (4 * np.pi)
    return {
        "glass": round(float(weight[kinds == GLASS].sum()), 4),
        "lights": round(float(weight[kinds == LIGHT].sum()), 4),
    }
