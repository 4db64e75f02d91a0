"""Surfaces of the room: a session's frame meshes fused into one mesh that rays can be cast against.

Each mesh adds the triangles that no finer mesh has shown already; a triangle that a later frame sees through is
removed. What is fused stays when the session drops the keyframe. World metres, y up.

Cost on one core for a mesh of 38,000 triangles: 5 ms to compare it with 24 others, then Embree's tree of the fused
triangles, built at the first ray (0.4 ms for each 1,000).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.camera import Intrinsics
from roomlight.compositing.kernels.depth_views import FREE, ON_SURFACE, classify_points
from roomlight.engine.session import Session
from roomlight.engine.surface.mesh import DepthView, FrameMesh
from roomlight.rays import RayTree
from roomlight.threads import parallel_for

MARGIN_M: Final = 0.03
MARGIN_SHARE: Final = 0.02
"""Two depths belong to one surface within 3 cm and 2 % of the depth: three times the noise of LiDAR and of Kinect."""
FINER: Final = 0.6
"""A mesh replaces the triangles of an older one if its samples are spaced at this share of the older one's, or less."""
MAX_PIECES: Final = 96
"""Most frames in the fused mesh; the one with the fewest triangles left is dropped. 96 pieces take 40 MB."""


@dataclass
class _Piece:
    """What one frame added.

    Attributes:
        measured: Whether the sensor gave depth that no later frame saw through [h, w].
        vertices, faces, centres: Triangles left, with their centroids [n, 3].
        spacing_m: Distance between samples at each centroid.
    """

    index: int
    view: DepthView
    measured: Bool[np.ndarray, "h w"]
    focal_px: float
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "n 3"]
    centres: Float[np.ndarray, "n 3"]
    spacing_m: Float[np.ndarray, " n"]

    def keep(self, kept: Bool[np.ndarray, " n"]) -> None:
        self.faces, self.centres, self.spacing_m = self.faces[kept], self.centres[kept], self.spacing_m[kept]


@dataclass(frozen=True)
class Hits:
    """First surfaces along rays.

    Attributes:
        distance_m: [n] along the unit direction, infinite where nothing is hit.
        normals: [n, 3] unit, toward the ray's origin; 0 where nothing is hit.
    """

    distance_m: Float[np.ndarray, " n"]
    normals: Float[np.ndarray, "n 3"]


class RoomGeometry:
    """The fused surfaces of a session."""

    def __init__(self) -> None:
        """Begin without surfaces; `update` adds those of a session."""
        self._pieces: list[_Piece] = []
        self._added: set[int] = set()
        self._tree: RayTree | None = None
        self._corners: Float[np.ndarray, "n 3 3"] = np.zeros((0, 3, 3), np.float32)
        self.version = 0

    @property
    def triangles(self) -> int:
        """Number of triangles of the fused mesh."""
        return sum(len(piece.faces) for piece in self._pieces)

    def update(self, session: Session, *, latest: bool = True) -> None:
        """Add the meshes that the session gained.

        Args:
            latest: also add the last frame if it is no keyframe.
        """
        meshes = session.meshes
        if not latest and len(meshes) > session.keyframes:
            meshes = meshes[:-1]
        for index, mesh in meshes:
            if index not in self._added:
                self.add(index, mesh)

    def add(self, index: int, mesh: FrameMesh) -> None:
        """Fuse one frame's mesh; `index` identifies the frame."""
        self._added.add(index)
        piece = _piece_of(index, mesh)
        for other in self._pieces:
            seen = _classify(other.centres, piece)
            replaced = (seen == ON_SURFACE) & (
                _spacing(other.centres, piece.view, piece.focal_px) < FINER * other.spacing_m
            )
            other.measured.reshape(-1)[_classify(other.vertices, piece) == FREE] = False
            other.keep((seen != FREE) & ~replaced)
        new = np.ones(len(piece.faces), bool)
        for other in self._pieces:
            covered = _classify(piece.centres, other) == ON_SURFACE
            new &= ~(covered & (_spacing(piece.centres, other.view, other.focal_px) * FINER <= piece.spacing_m))
        piece.keep(new)
        self._pieces.append(piece)
        if len(self._pieces) > MAX_PIECES:
            self._pieces.remove(min(self._pieces, key=lambda smallest: len(smallest.faces)))
        self._tree = None
        self.version += 1

    def points(self) -> Float[np.ndarray, "n 3"]:
        """Return the centroids of all triangles: samples of the surface."""
        if not self._pieces:
            return np.zeros((0, 3), np.float32)
        return np.concatenate([piece.centres for piece in self._pieces])

    def mesh(self) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "n 3"]]:
        """Return vertices [v, 3] and faces [n, 3] of the fused mesh."""
        vertices, faces, offset = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.int32)], 0
        for piece in self._pieces:
            vertices.append(piece.vertices)
            faces.append(piece.faces + np.int32(offset))
            offset += len(piece.vertices)
        return np.concatenate(vertices), np.concatenate(faces)

    def cast(self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Hits:
        """Cast rays with unit directions; surfaces are hit from both sides."""
        tree = self._built()
        if tree is None or len(origins) == 0:
            return Hits(np.full(len(origins), np.inf, np.float32), np.zeros((len(origins), 3), np.float32))
        hits = tree.trace(origins, directions)
        a, b, c = (self._corners[hits.face, corner] for corner in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        normals *= -np.sign((normals * directions).sum(axis=1, keepdims=True))
        normals[hits.face < 0] = 0
        return Hits(hits.distance_m, normals.astype(np.float32))

    def depth_image(
        self,
        camera: Intrinsics,
        camera_to_world: Float[np.ndarray, "4 4"],
        mask: Bool[np.ndarray, "h w"] | None = None,
    ) -> Float[np.ndarray, "h w"]:
        """Return the z-depth that a camera sees of the fused surfaces; 0 where there is none, or beyond `mask`."""
        depth = np.zeros((camera.height, camera.width), np.float32)
        wanted = np.ones(depth.shape, bool) if mask is None else mask
        rays = camera.rays()[wanted]
        length = np.linalg.norm(rays, axis=1)
        directions = (rays / length[:, None]) @ camera_to_world[:3, :3].T.astype(np.float32)
        origins = np.broadcast_to(camera_to_world[:3, 3].astype(np.float32), directions.shape)
        measured = self.cast(origins, directions).distance_m / length
        depth[wanted] = np.where(np.isfinite(measured), measured, np.float32(0))
        return depth

    def _built(self) -> RayTree | None:
        if self._tree is None and self.triangles:
            vertices, faces = self.mesh()
            self._corners = vertices[faces]
            self._tree = RayTree(vertices, faces)  # robust: rays through vertices must not slip between triangles
        return self._tree


def _piece_of(index: int, mesh: FrameMesh) -> _Piece:
    lens, view = mesh.grid_camera, mesh.depth_view
    faces = mesh.faces[mesh.measured.reshape(-1)[mesh.faces].all(axis=1)]
    corners = mesh.vertices[faces]
    centres = corners.mean(axis=1, dtype=np.float32)
    focal_px = (lens.fx + lens.fy) / 2
    spacing_m = _spacing(centres, view, focal_px)
    return _Piece(index, view, mesh.measured.copy(), focal_px, mesh.vertices, faces, centres, spacing_m)


def _spacing(points: Float[np.ndarray, "n 3"], view: DepthView, focal_px: float) -> Float[np.ndarray, " n"]:
    """Return the distance between neighbouring samples of a view at the depth of each point."""
    row = view.world_to_camera[2]
    return np.abs(points @ row[:3] + row[3]) / np.float32(focal_px)


def _classify(points: Float[np.ndarray, "n 3"], piece: _Piece) -> Int[np.ndarray, " n"]:
    out = np.empty(len(points), np.int8)
    arguments = points, piece.view, piece.measured, np.float32(MARGIN_M), np.float32(MARGIN_SHARE), out
    parallel_for(lambda start, stop: classify_points(*arguments, start, stop), len(points))
    return out
