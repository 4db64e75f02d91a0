"""The partial mesh of one frame, and what a probe sees of one or several: LDR panorama, mask, depth (paper, 4.1, 4.2).

Vertices are depth pixels in world metres; no triangle crosses a depth edge. A probe's panorama of the mesh is
rasterised (`roomlight.engine.kernels.rasterise`) and textured with the frame's image
(`roomlight.engine.surface.texture`): what rays through its pixel centres meet, without a tree.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics, rigid_inverse, transform_points
from roomlight.conventions import Position, panorama_rays
from roomlight.engine.kernels.blend import count_seen_through
from roomlight.engine.kernels.rasterise import (
    Nearest,
    Raster,
    Surface,
    join_quads,
    leave_out_shown,
    near_centres,
    place_vertices,
    raise_vertices,
    rasterise,
    take_nearer,
)
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.panorama.blend import PanoramaState, PartialPanorama, farthest_depth_m, unseen_depth_m
from roomlight.engine.surface.texture import Pyramid, Texture
from roomlight.frame import Frame
from roomlight.threads import parallel_for

EDGE_RATIO = 1.08
"""Neighbouring vertices whose depths differ by more than this ratio belong to two surfaces. With a vertex every 0.36
degrees, a plane exceeds it only under 5 degrees of grazing angle; sofa edges against walls are at 1.2 and more."""
_EVERY: Final = 2
_SAME_RATIO: Final = 0.02
_SAME_M: Final = 0.03
"""Two meshes show one surface if they are less than 3 cm and 2 % of the depth apart."""
_CLOSER_M: Final = np.float32(CLOSER_M)
MAX_VERTICES: Final = 160 * 120
"""Most vertices of a mesh. Against the 153,000 triangles of all pixels the mask of a 120 x 240 panorama is wrong in
2.4 % of its pixels; a mesh of 107 x 80 would be wrong in 4.7 %."""


@dataclass(frozen=True)
class MeshGrid:
    """The depth samples that are vertices of a mesh.

    Attributes:
        depth_m: z-depth, 0 = unknown.
        measured: where the sensor measured it; elsewhere it is completed.
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
    """A grid of z-depth and its camera; `lens` is fx, fy, cx, cy in samples of the grid."""

    world_to_camera: Float[np.ndarray, "4 4"]
    lens: Float[np.ndarray, "4"]
    depth: Float[np.ndarray, "gh gw"]


class _Triangles(NamedTuple):
    """What follows from a mesh's depth samples and camera; `numbers` are the faces of each quad (`grid_faces`)."""

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
        self._made = self._triangles_of(grid.depth_m, np.s_[:, :])

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
        self.contradicted = False  # by later frames, as a keyframe that shows what no other one does
        self._made: _Triangles | None = None

    def prepare(self) -> None:
        """Make what views need now, so that several threads may ask for views."""
        self._made, self._pyramid = self.triangles, self.levels

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
        return self.triangles.vertices

    @property
    def faces(self) -> Int[np.ndarray, "n 3"]:
        """Vertices of each triangle."""
        return self.triangles.faces

    @property
    def known(self) -> Bool[np.ndarray, " v"]:
        """Vertices whose depth is known."""
        return self.grid_depth_m.reshape(-1) > 0

    @property
    def triangles(self) -> _Triangles:
        """What is traced, and where each vertex lies in the image."""
        made = self._made  # once: another thread may forget it
        if made is None:
            made = self._made = self._triangles_of(self.grid_depth_m, np.s_[:, :])
        return made

    @property
    def levels(self) -> Pyramid:
        """The texture's pyramid."""
        pyramid = self._pyramid
        if pyramid is None:
            pyramid = self._pyramid = self.texture.pyramid()
        return pyramid

    def _triangles_of(self, depth: Float[np.ndarray, "gh gw"], window: tuple[slice, slice]) -> _Triangles:
        """Return the triangles of depth samples in a window of the grid."""
        k, shape = self.image_camera, self.grid_depth_m.shape
        pixels = _pixels(self._depth_shape, self.grid_depth_m.size, (k.width, k.height)).reshape(*shape, 2)[window]
        return _Triangles(self._raised(depth, window), *grid_faces(depth), np.ascontiguousarray(pixels).reshape(-1, 2))

    def _raised(self, depth: Float[np.ndarray, "gh gw"], window: tuple[slice, slice]) -> Float[np.ndarray, "v 3"]:
        """Return the vertices of depth samples in a window of the grid, in world metres."""
        k, uv = self.image_camera, np.ascontiguousarray(self.grid.uv()[window]).reshape(-1, 2)
        vertices = np.empty((depth.size, 3), np.float32)
        camera = np.array([k.width, k.height, k.fx, k.fy, k.cx, k.cy], np.float32)
        raise_vertices(depth.reshape(-1), uv, camera, self.camera_to_world.astype(np.float32), vertices)
        return vertices

    def vertices_at(self, window: tuple[slice, slice]) -> Float[np.ndarray, "v 3"]:
        """Return the vertices in a window of the grid, row by row, in world metres."""
        return self._raised(np.ascontiguousarray(self.grid_depth_m[window]), window)

    def find(
        self, world: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
        """Return which points (world metres) are in view, their (column, row) in the grid and their z-depth."""
        xy, z = self.grid_camera.project(transform_points(rigid_inverse(self.camera_to_world), world))
        height, width = self.grid_depth_m.shape
        inside = np.flatnonzero(np.all((xy >= 0) & (xy < (width, height)), axis=1))
        return inside, xy[inside], z[inside]

    @property
    def depth_view(self) -> DepthView:
        """The grid with its camera."""
        k, to_camera = self.grid_camera, rigid_inverse(self.camera_to_world).astype(np.float32)
        return DepthView(to_camera, np.array([k.fx, k.fy, k.cx, k.cy], np.float32), self.grid_depth_m)

    @property
    def measured_view(self) -> DepthView:
        """The grid with the least measured depth around each sample; 0 where not all around it are measured."""
        depth = np.where(self.measured, self.grid_depth_m, np.float32(0))
        around = cv2.erode(depth, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
        return self.depth_view._replace(depth=around)

    def without(self, others: Sequence[DepthView]) -> "FrameMesh | None":
        """Return a copy for views, without surfaces that the others show too; None if nothing is left.

        Every second vertex is looked up; what is around one that no other shows stays.
        """
        depth, every = self.grid_depth_m, np.s_[::_EVERY, ::_EVERY]
        vertices, wanted = self.vertices_at(every), depth[every].reshape(-1) > 0
        for other in others:
            leave_out_shown(vertices, wanted, other, _SAME_RATIO, _SAME_M)
        size = 2 * _EVERY + 1  # its neighbours on both sides
        stays = np.zeros(depth.shape, np.uint8)
        stays[every] = wanted.reshape(stays[every].shape)
        stays = cv2.dilate(stays, np.ones((size, size), np.uint8))
        depth = np.where(stays > 0, depth, np.float32(0))
        rows, columns = (np.flatnonzero(depth.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return None
        window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        rest = self.passing()
        rest.grid_depth_m, rest.measured = (np.ascontiguousarray(plane[window]) for plane in (depth, self.measured))
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
        view = MeshesView(position_world, height)
        view.add([(0, self)])
        return view.partial()

    def rasterise(self, position_world: Float[np.ndarray, "3"], height: int, raster: Raster) -> tuple[int, int]:
        """Add the nearest triangles that a world position (metres) sees to a raster of an H x 2H panorama.

        Returns:
            The first row that may have changed, and the row after the last.
        """
        vertices, faces, numbers, _ = self.triangles
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


class MeshesView:
    """A point's panorama of meshes: those added first stay, unless a later one shows a surface closer by `CLOSER_M`.

    Surfaces whose depth was measured win over those whose depth was completed: beyond the sensor's range that is the
    depth of the rim, which moves with the camera.
    """

    def __init__(self, position_world: Float[np.ndarray, "3"], height: int) -> None:
        """Begin without meshes, at a position in world metres, with `height` rows."""
        self._position, self._height = position_world, height
        pixels, endless = 2 * height * height, np.float32(np.inf)
        distance, limit, mesh = np.full(pixels, endless), np.full(pixels, endless), np.full(pixels, -1, np.int32)
        self._nearest = Nearest(distance, limit, mesh, np.zeros(pixels, np.bool_))
        self._radiance, self._clipping = np.zeros((pixels, 3), np.float32), np.zeros((pixels, 2), np.float32)
        self._clips = False

    def add(self, meshes: Sequence[tuple[int, FrameMesh]]) -> None:
        """Add meshes with their numbers, in this order."""
        height, pixels = self._height, len(self._radiance)
        raster = empty_raster(pixels)
        seen, maps, levels = np.empty(pixels, np.int32), np.empty((pixels, 2), np.float32), np.empty(pixels, np.int8)
        for number, mesh in meshes:
            rows = mesh.rasterise(self._position, height, raster)
            some = rows[0] * 2 * height, rows[1] * 2 * height
            made, pyramid = mesh.triangles, mesh.levels
            surface = Surface(made.faces, made.pixels, mesh.grid_depth_m.reshape(-1), mesh.measured.reshape(-1))
            # image pixels that a panorama pixel spans at a distance equal to the z-depth
            per_pixel = np.float32((mesh.image_camera.fx + mesh.image_camera.fy) / 2 * np.pi / height)
            count = take_nearer(raster, *some, surface, per_pixel, number, _CLOSER_M, self._nearest, seen, maps, levels)
            pyramid.sample_into(self._radiance, self._clipping, seen[:count], maps[:count], levels[:count])
            self._clips |= bool(pyramid.clipping)

    def add_view(self, other: "MeshesView") -> None:
        """Add what another view from the same point shows, as if it were one mesh."""
        mine, theirs = self._nearest, other._nearest
        closer = (theirs.measured == mine.measured) & (theirs.distance <= mine.limit)
        closer = np.flatnonzero((theirs.measured > mine.measured) | (closer & (theirs.mesh >= 0)))
        for own, new in zip(
            (*mine, self._radiance, self._clipping), (*theirs, other._radiance, other._clipping), strict=True
        ):
            own[closer] = new[closer]
        self._clips |= other._clips

    def partial(self) -> PartialPanorama:
        """Return what is seen."""
        shape = self._height, 2 * self._height
        mask = (self._nearest.mesh >= 0).reshape(shape)
        depth_m = np.where(mask, self._nearest.distance.reshape(shape), np.float32(0))
        radiance, measured = self._radiance.reshape(*shape, 3), self._nearest.measured.reshape(shape)
        if not self._clips:
            return PartialPanorama(radiance, mask, depth_m, measured=measured)
        clipped, guessed = (np.ascontiguousarray(self._clipping[:, part]).reshape(shape) for part in range(2))
        return PartialPanorama(radiance, mask, depth_m, clipped, guessed, measured)

    def viewed_from(self, cameras: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "h w 3"]:
        """Return the camera of each pixel's mesh, in metres from the point; 0 where nothing is seen.

        Args:
            cameras: World metres, by the meshes' numbers.
        """
        relative = np.vstack([cameras - self._position, np.zeros(3)]).astype(np.float32)
        return relative[self._nearest.mesh].reshape(self._height, 2 * self._height, 3)


def forget_seen_through(
    state: PanoramaState, partial: PartialPanorama, mesh: FrameMesh, position: Position, depth_max_m: float
) -> None:
    """Forget of a panorama what a frame and the one before see through.

    Args:
        partial: What is seen of the frame's mesh.
        position: Of the panorama, world metres.
        depth_max_m: D_max of the room's volume.
    """
    gone, place, view = np.empty(state.observed.shape, np.bool_), np.asarray(position, np.float32), mesh.measured_view
    farthest_m, rays = np.float32(farthest_depth_m(depth_max_m) - CLOSER_M), panorama_rays(len(gone))
    if count_seen_through(state.arrays, partial.depth_m, rays, place, view, _CLOSER_M, farthest_m, gone):
        state.forget(gone, unseen_depth_m(depth_max_m))


def distinct(meshes: Sequence[FrameMesh]) -> list[tuple[int, FrameMesh]]:
    """Return copies of meshes, with their numbers, without surfaces that those before them show too, on all cores.

    Those that show nothing of their own are left out.
    """
    rest: dict[int, FrameMesh] = {}
    views = [mesh.depth_view for mesh in meshes]

    def leave_out(first: int, last: int) -> None:
        for number in range(first, last):
            mesh = meshes[number].without(views[:number])
            if mesh is not None:
                mesh.prepare()
                rest[number] = mesh

    parallel_for(leave_out, len(meshes), most=1)
    return sorted(rest.items())


def most_alike(camera_to_world: Float[np.ndarray, "4 4"], meshes: Sequence[FrameMesh], count: int) -> list[int]:
    """Return the numbers of those meshes, at most `count`, whose heading is the most similar to a camera's."""
    ahead = -camera_to_world[:3, 2]
    return sorted(range(len(meshes)), key=lambda n: float(ahead @ meshes[n].camera_to_world[:3, 2]))[:count]


def grid_faces(depth: Float[np.ndarray, "h w"]) -> tuple[Int[np.ndarray, "n 3"], Int[np.ndarray, "2 quads"]]:
    """Make two triangles of each quad of a depth grid, counter-clockwise seen from the camera.

    A triangle with an unknown corner, or across a depth edge (`EDGE_RATIO`), is left out.

    Returns:
        Vertices of the triangles, and the numbers of each quad's, -1 where one is left out.
    """
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
