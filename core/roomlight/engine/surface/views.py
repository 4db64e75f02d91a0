"""What a point sees of many frames' meshes, each direction of one of them."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.engine.kernels.rasterise import Nearest, take_nearer
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.surface.mesh import FrameMesh, PartialPanorama, empty_raster
from roomlight.threads import parallel_for

_CLOSER_M: Final = np.float32(CLOSER_M)


class MeshesView:
    """A point's panorama of meshes: those added first stay, unless a later one shows a surface closer by `CLOSER_M`."""

    def __init__(self, position_world: Float[np.ndarray, "3"], height: int) -> None:
        """Begin without meshes, at a position in world metres, with `height` rows."""
        self._position, self._height = position_world, height
        pixels, endless = 2 * height * height, np.float32(np.inf)
        self._nearest = Nearest(np.full(pixels, endless), np.full(pixels, endless), np.full(pixels, -1, np.int32))
        self._radiance, self._clipping = np.zeros((pixels, 3), np.float32), np.zeros((pixels, 2), np.float32)

    def add(self, meshes: Sequence[tuple[int, FrameMesh]]) -> None:
        """Add meshes with their numbers, in this order."""
        height, pixels = self._height, len(self._radiance)
        raster = empty_raster(pixels)
        seen, maps, levels = np.empty(pixels, np.int32), np.empty((pixels, 2), np.float32), np.empty(pixels, np.int8)
        for number, mesh in meshes:
            rows = mesh.rasterise(self._position, height, raster)
            some = rows[0] * 2 * height, rows[1] * 2 * height
            surface, per_pixel = mesh.surface, mesh.per_pixel(height)
            count = take_nearer(raster, *some, surface, per_pixel, number, _CLOSER_M, self._nearest, seen, maps, levels)
            mesh.levels.sample_into(self._radiance, self._clipping, seen[:count], maps[:count], levels[:count])

    def add_view(self, other: "MeshesView") -> None:
        """Add what another view from the same point shows, as if it were one mesh."""
        mine, theirs = self._nearest, other._nearest
        closer = np.flatnonzero((theirs.distance <= mine.limit) & (theirs.mesh >= 0))
        for own, new in zip(
            (*mine, self._radiance, self._clipping), (*theirs, other._radiance, other._clipping), strict=True
        ):
            own[closer] = new[closer]

    def partial(self) -> PartialPanorama:
        """Return what is seen."""
        shape = self._height, 2 * self._height
        mask = (self._nearest.mesh >= 0).reshape(shape)
        depth_m = np.where(mask, self._nearest.distance.reshape(shape), np.float32(0))
        clipped, guessed = (np.ascontiguousarray(self._clipping[:, part]).reshape(shape) for part in range(2))
        return PartialPanorama(self._radiance.reshape(*shape, 3), mask, depth_m, clipped, guessed)

    def viewed_from(self, cameras: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "h w 3"]:
        """Return the camera of each pixel's mesh, in metres from the point; 0 where nothing is seen.

        Args:
            cameras: World metres, by the meshes' numbers.
        """
        relative = np.vstack([cameras - self._position, np.zeros(3)]).astype(np.float32)
        return relative[self._nearest.mesh].reshape(self._height, 2 * self._height, 3)


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
