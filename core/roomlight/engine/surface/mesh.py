"""The partial mesh of one frame, and what a probe sees of it: LDR panorama, mask, depth (paper, 4.1, 4.2).

Vertices are depth pixels in world metres; no triangle crosses a depth edge. A probe's panorama of the mesh is
rasterised (`roomlight.engine.kernels.rasterise`) and textured with the frame's image
(`roomlight.engine.surface.texture`): what rays through its pixel centres meet, without a tree.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.conventions import panorama_rays
from roomlight.engine.kernels.rasterise import (
    Raster,
    Surface,
    join_quads,
    leave_out_shown,
    locate,
    near_centres,
    place_vertices,
    raise_vertices,
    rasterise,
)
from roomlight.engine.surface.texture import Pyramid, Texture
from roomlight.frame import Frame

EDGE_RATIO = 1.08
"""Neighbouring vertices whose depths differ by more than this ratio belong to two surfaces. With a vertex every 0.36
degrees, a plane exceeds it only under 5 degrees of grazing angle; sofa edges against walls are at 1.2 and more."""
_EVERY: Final = 2
_SAME_RATIO: Final = 0.02
_SAME_M: Final = 0.03
"""Two meshes show one surface if they are less than 3 cm and 2 % of the depth apart."""
MAX_VERTICES: Final = 160 * 120
"""Most vertices of a mesh. Against the 153,000 triangles of all pixels the mask of a 120 x 240 panorama is wrong in
2.4 % of its pixels; a mesh of 107 x 80 would be wrong in 4.7 %."""


@dataclass(frozen=True)
class PartialPanorama:
    """What a probe sees of one frame's mesh.

    Attributes:
        radiance: [H, 2H, 3] linear RGB, 0 where the mask is False.
        mask: [H, 2H] directions in which the mesh is seen.
        depth_m: [H, 2H] distance along the ray in metres, 0 where the mask is False.
        clipped: [H, 2H] share of the surface whose pixels were clipped, 0 to 1; None: nothing was clipped.
        guessed: [H, 2H] luminance of the radiance that was estimated for these pixels; None: nothing was clipped.
    """

    radiance: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]
    depth_m: Float[np.ndarray, "h w"]
    clipped: Float[np.ndarray, "h w"] | None = None
    guessed: Float[np.ndarray, "h w"] | None = None

    def within(self, farthest_m: float) -> "PartialPanorama":
        """Clamp the depth to `farthest_m`."""
        return replace(self, depth_m=np.minimum(self.depth_m, np.float32(farthest_m)))


@dataclass(frozen=True)
class MeshGrid:
    """The depth samples that are vertices of a mesh.

    Attributes:
        depth_m: [gh, gw] z-depth, 0 = unknown.
        measured: [gh, gw] where the sensor measured it; elsewhere it is completed.
        depth_shape: rows and columns of the depth image that the samples were taken from.
    """

    depth_m: Float[np.ndarray, "gh gw"]
    measured: Bool[np.ndarray, "gh gw"]
    depth_shape: tuple[int, int]

    @classmethod
    def of(
        cls, depth_m: Float[np.ndarray, "h w"], sensor_depth_m: Float[np.ndarray, "h w"], max_vertices: int
    ) -> "MeshGrid":
        """Take every n-th sample of a depth image, the smallest n with at most `max_vertices` (a mean would lie between
        two surfaces)."""
        height, width = depth_m.shape
        rows, columns = _samples(height, width, _stride(height, width, max_vertices))
        where = np.ix_(rows, columns)
        return cls(np.ascontiguousarray(depth_m[where]), sensor_depth_m[where] > 0, (height, width))

    def uv(self) -> Float[np.ndarray, "gh gw 2"]:
        """Return (u, v) of each vertex in the image, 0 to 1; float32, read-only."""
        return _uv(self.depth_shape, self.depth_m.size)


class DepthView(NamedTuple):
    """A depth grid and its camera.

    Attributes:
        world_to_camera: [4, 4].
        lens: fx, fy, cx, cy, in samples of the grid.
        depth: [gh, gw] z-depth.
    """

    world_to_camera: Float[np.ndarray, "4 4"]
    lens: Float[np.ndarray, "4"]
    depth: Float[np.ndarray, "gh gw"]


class _Triangles(NamedTuple):
    """What follows from a mesh's depth samples and camera.

    Attributes:
        vertices: [v, 3] world metres.
        faces: [n, 3] vertices.
        numbers: [2, quads] faces of each quad, -1 where one is left out.
        pixels: [v, 2] (column, row) of a vertex in the image.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "n 3"]
    numbers: Int[np.ndarray, "2 quads"]
    pixels: Float[np.ndarray, "v 2"]


class FrameMesh:
    """A frame's depth as a textured triangle mesh, ready to be ray traced from any point.

    It holds what it was made from, 1.5 MB. Triangles and the texture's pyramid, 1 to 2 MB, are kept until `forget`,
    and made again when they are wanted.
    """

    def __init__(
        self,
        frame: Frame,
        *,
        sensor_depth_m: Float[np.ndarray, "dh dw"] | None = None,
        sensor_clipped: Bool[np.ndarray, "h w"] | None = None,
    ) -> None:
        """Triangulate. A frame without depth has no triangle, and is seen from nowhere.

        Args:
            sensor_depth_m: Depth before it was completed, of the same size; default: the frame's depth.
            sensor_clipped: Clipped pixels before any was taken from other frames; default: the frame's.
        """
        sensor_depth_m = frame.depth_m if sensor_depth_m is None else sensor_depth_m
        clipped = frame.clipped if sensor_clipped is None else sensor_clipped
        grid = MeshGrid.of(frame.depth_m, sensor_depth_m, MAX_VERTICES)
        self._take(Texture.of(frame), frame.intrinsics, frame.camera_to_world, grid)
        self.sensor_clipped = clipped if clipped.any() else None
        self._made = self._triangulated()

    @classmethod
    def of_grid(
        cls,
        texture: Texture,
        image_camera: Intrinsics,
        camera_to_world: Float[np.ndarray, "4 4"],
        grid: MeshGrid,
        *,
        sensor_clipped: Bool[np.ndarray, "h w"] | None = None,
    ) -> "FrameMesh":
        """Make a mesh again from what another mesh kept: equal to the bit."""
        mesh = cls.__new__(cls)
        mesh._take(texture, image_camera, camera_to_world, grid)
        mesh.sensor_clipped = sensor_clipped
        return mesh

    def _take(self, texture: Texture, k: Intrinsics, camera_to_world: Float[np.ndarray, "4 4"], grid: MeshGrid) -> None:
        self.texture = texture
        self.camera_to_world = camera_to_world
        self.image_camera, self._depth_shape = k, grid.depth_shape
        self.grid_depth_m = grid.depth_m
        self.measured = grid.measured  # [gh, gw]; elsewhere depth is completed
        self.gain: tuple[float, float, float] | None = None  # of the texture against the image as pushed
        self._made: _Triangles | None = None

    def prepare(self) -> None:
        """Make what views need now, so that several threads may ask for views."""
        self._made, self._pyramid = self._triangles, self.levels

    def forget(self) -> None:
        """Release what can be made again."""
        self._made = self._pyramid = None

    def passing(self) -> "FrameMesh":
        """Return a copy that shares the arrays: what is made for it goes with it."""
        return copy(self)

    @property
    def texture(self) -> Texture:
        """The frame's image; a keyframe gets another one when a later frame knows more of its clipped pixels."""
        return self._texture

    @texture.setter
    def texture(self, texture: Texture) -> None:
        self._texture = texture
        self._pyramid: Pyramid | None = None

    @property
    def vertices(self) -> Float[np.ndarray, "v 3"]:
        """World metres, row by row of `grid_depth_m`."""
        return self._triangles.vertices

    @property
    def faces(self) -> Int[np.ndarray, "n 3"]:
        """Vertices of each triangle."""
        return self._triangles.faces

    @property
    def known(self) -> Bool[np.ndarray, " v"]:
        """Vertices whose depth is known."""
        return self.grid_depth_m.reshape(-1) > 0

    @property
    def _triangles(self) -> _Triangles:
        made = self._made  # once: another thread may forget it
        if made is None:
            made = self._made = self._triangulated()
        return made

    @property
    def levels(self) -> Pyramid:
        """The texture's pyramid."""
        pyramid = self._pyramid
        if pyramid is None:
            pyramid = self._pyramid = self.texture.pyramid()
        return pyramid

    def _triangulated(self) -> _Triangles:
        return self._triangles_of(self.grid_depth_m, np.s_[:, :])

    def _triangles_of(self, depth: Float[np.ndarray, "gh gw"], window: tuple[slice, slice]) -> _Triangles:
        """Return the triangles of depth samples in a window of the grid."""
        k, shape = self.image_camera, self.grid_depth_m.shape
        pixels = _pixels(self._depth_shape, self.grid_depth_m.size, (k.width, k.height)).reshape(*shape, 2)[window]
        return _Triangles(self._raised(depth, window), *_joined(depth), np.ascontiguousarray(pixels).reshape(-1, 2))

    def _raised(self, depth: Float[np.ndarray, "gh gw"], window: tuple[slice, slice]) -> Float[np.ndarray, "v 3"]:
        """Return the vertices of depth samples in a window of the grid, in world metres."""
        k, uv = self.image_camera, np.ascontiguousarray(self.grid.uv()[window]).reshape(-1, 2)
        vertices = np.empty((depth.size, 3), np.float32)
        camera = np.array([k.width, k.height, k.fx, k.fy, k.cx, k.cy], np.float32)
        raise_vertices(depth.reshape(-1), uv, camera, self.camera_to_world.astype(np.float32), vertices)
        return vertices

    @property
    def depth_view(self) -> DepthView:
        """The grid with its camera."""
        k, to_camera = self.grid_camera, rigid_inverse(self.camera_to_world).astype(np.float32)
        return DepthView(to_camera, np.array([k.fx, k.fy, k.cx, k.cy], np.float32), self.grid_depth_m)

    def without(self, others: Sequence[DepthView]) -> "FrameMesh | None":
        """Return a copy for views, without surfaces that the others show too; None if nothing is left.

        Every second vertex is looked up; what is around one that no other shows stays.
        """
        depth, every = self.grid_depth_m, np.s_[::_EVERY, ::_EVERY]
        corners = np.ascontiguousarray(depth[every])
        vertices, wanted = self._raised(corners, every), corners.reshape(-1) > 0
        for other in others:
            leave_out_shown(vertices, wanted, other, _SAME_RATIO, _SAME_M)
        size = 2 * _EVERY + 1  # its neighbours on both sides
        stays = np.zeros(depth.shape, np.uint8)
        stays[every] = wanted.reshape(corners.shape)
        stays = cv2.dilate(stays, np.ones((size, size), np.uint8))
        depth = np.where(stays > 0, depth, np.float32(0))
        rows, columns = (np.flatnonzero(depth.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return None
        window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        rest = self.passing()
        rest.grid_depth_m = np.ascontiguousarray(depth[window])
        rest._made = self._triangles_of(rest.grid_depth_m, window)
        return rest

    @property
    def grid(self) -> MeshGrid:
        """The depth samples of the vertices."""
        return MeshGrid(self.grid_depth_m, self.measured, self._depth_shape)

    @property
    def grid_camera(self) -> Intrinsics:
        """The camera whose pixel centres are the vertices: `grid_depth_m` is its depth image."""
        height, width = self.grid_depth_m.shape
        stride = _stride(*self._depth_shape, height * width)
        k = self.image_camera.resized(self._depth_shape[1], self._depth_shape[0])
        first = 0.5 + stride // 2  # `_samples` takes every n-th sample from n // 2 on
        cx, cy = (k.cx - first) / stride + 0.5, (k.cy - first) / stride + 0.5
        return Intrinsics(k.fx / stride, k.fy / stride, cx, cy, width, height)

    def render_panorama(self, position_world: Float[np.ndarray, "3"], *, height: int = 120) -> PartialPanorama:
        """Render what a world position (metres) sees of the mesh in the directions of an H x 2H panorama.

        The back of a surface hides what is behind it and is not seen itself: the camera saw its other side.
        """
        pixels, shape = 2 * height * height, (height, 2 * height)
        raster = empty_raster(pixels)
        self.rasterise(position_world, height, raster)
        seen, distance = np.empty(pixels, np.int32), np.empty(pixels, np.float32)
        maps, levels = np.empty((pixels, 2), np.float32), np.empty(pixels, np.int8)
        count = locate(raster, self.surface, self.per_pixel(height), seen, maps, levels, distance)
        radiance, clipping = self.levels.sample(pixels, seen[:count], maps[:count], levels[:count])
        clipped, guessed = (None, None) if clipping is None else (clipping[:, 0], clipping[:, 1])
        return PartialPanorama(
            radiance.reshape(*shape, 3),
            (distance > 0).reshape(shape),
            distance.reshape(shape),
            None if clipped is None else np.ascontiguousarray(clipped).reshape(shape),
            None if guessed is None else np.ascontiguousarray(guessed).reshape(shape),
        )

    @property
    def surface(self) -> Surface:
        """What triangles know of the image."""
        made = self._triangles
        return Surface(made.faces, made.pixels, self.grid_depth_m.reshape(-1))

    def per_pixel(self, height: int) -> np.float32:
        """Return the image pixels that a panorama pixel spans at a distance equal to the z-depth."""
        return np.float32((self.image_camera.fx + self.image_camera.fy) / 2 * np.pi / height)

    def rasterise(self, position_world: Float[np.ndarray, "3"], height: int, raster: Raster) -> tuple[int, int]:
        """Add the nearest triangles that a world position (metres) sees to a raster of an H x 2H panorama.

        Returns:
            The first row that may have changed, and the row after the last.
        """
        vertices, faces, numbers, _ = self._triangles
        offsets, places = np.empty((3, len(vertices)), np.float32), np.empty((2, len(vertices)), np.float32)
        place_vertices(vertices, np.asarray(position_world, np.float64), height, offsets, places)
        flags, chosen = np.empty(numbers.shape[1], np.bool_), np.empty(len(faces), np.int32)
        chosen = chosen[: near_centres(places, self.grid_depth_m.shape, numbers, flags, chosen)]
        return rasterise(faces, chosen, offsets, places, panorama_rays(height), height, raster)


def empty_raster(pixels: int) -> Raster:
    """Return a raster of so many pixels without triangles."""
    return Raster(
        np.full(pixels, np.inf, np.float32),
        np.full(pixels, -1, np.int32),
        np.empty((pixels, 2), np.float32),
        np.zeros(pixels, np.int32),
    )


def grid_faces(depth: Float[np.ndarray, "h w"]) -> Int[np.ndarray, "n 3"]:
    """Make two triangles of each quad of a depth grid, counter-clockwise seen from the camera.

    A triangle with an unknown corner, or across a depth edge (`EDGE_RATIO`), is left out.
    """
    return _joined(depth)[0]


def _joined(depth: Float[np.ndarray, "h w"]) -> tuple[Int[np.ndarray, "n 3"], Int[np.ndarray, "2 quads"]]:
    quads = (depth.shape[0] - 1) * (depth.shape[1] - 1)
    faces, numbers = np.empty((2 * quads, 3), np.int32), np.empty((2, quads), np.int32)
    return faces[: join_quads(depth, EDGE_RATIO, faces, numbers)], numbers


def _stride(height: int, width: int, max_vertices: int) -> int:
    """Return the smallest step between samples at which the grid has at most `max_vertices` vertices."""
    stride = 1
    while len(range(stride // 2, height, stride)) * len(range(stride // 2, width, stride)) > max_vertices:
        stride += 1
    return stride


def _samples(height: int, width: int, stride: int) -> tuple[Int[np.ndarray, " gh"], Int[np.ndarray, " gw"]]:
    """Return the rows and columns of the depth samples that are vertices."""
    return np.arange(stride // 2, height, stride), np.arange(stride // 2, width, stride)


@lru_cache(8)
def _uv(depth_shape: tuple[int, int], vertices: int) -> Float[np.ndarray, "gh gw 2"]:
    height, width = depth_shape
    rows, columns = _samples(height, width, _stride(height, width, vertices))
    u, v = np.meshgrid((columns + 0.5) / width, (rows + 0.5) / height)
    uv = np.stack([u, v], axis=-1).astype(np.float32)
    uv.setflags(write=False)
    return uv


@lru_cache(8)
def _pixels(depth_shape: tuple[int, int], vertices: int, size: tuple[int, int]) -> Float[np.ndarray, "v 2"]:
    """Return (column, row) of each vertex in an image of this (width, height)."""
    return (_uv(depth_shape, vertices).reshape(-1, 2) * np.array(size) - 0.5).astype(np.float32)
