"""Visibility of the lights from each part of a room, learned from the shadow rays of its patches."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, UInt8

from roomlight_generator.transport.kernels import patches as kernels
from roomlight_generator.transport.lights.direct import OnRays, ShadowRays
from roomlight_generator.transport.tables import Table

PRIOR_RAYS: Final = 4.0
"""Number of the patch's own rays that the share in its surroundings counts as."""


class LightVisibility:
    """Counts of the shadow rays of each patch toward each light, and of the visible rays.

    There are more lights than a patch has rays. If it tried a light too seldom, its surroundings decide; if these did
    too, the whole room decides.
    """

    def __init__(
        self,
        position: Float32[np.ndarray, "p k 3"],
        used: Int32[np.ndarray, " p"],
        material: Int32[np.ndarray, " p"],
        *,
        lights: int,
        materials: int,
    ) -> None:
        """Take the patches' points, how many of each are used, and the patches' materials; no light is tried yet."""
        count = len(used)
        self.tried, self.seen = np.zeros((count, lights), np.uint16), np.zeros((count, lights), np.uint16)
        self.coarse = Table(count)
        self.owner = np.empty(count, np.int32)
        self.material, self.materials = material, materials
        self.wide = kernels.fill_coarse(position, used, material, self.coarse.arrays, self.owner)

    def counting(self, patch: Int32[np.ndarray, " n"]) -> OnRays:
        """Return an `OnRays` that counts the shadow rays of points that belong to these patches."""

        def count(start: int, rays: ShadowRays, seen: Bool[np.ndarray, " n"], written: int) -> None:
            kernels.count_visible(rays, seen, written, patch[start:], self.tried, self.seen)

        return count

    def visibility(self) -> UInt8[np.ndarray, "rows l"]:
        """Return the share of each light that each row of the `RoomCache` sees, in 255ths."""
        whole = (self.seen.sum(0) + 1.0) / (self.tried.sum(0) + 1.5)
        around = self._share(self.owner, self.wide, whole)
        alike = self._share(self.material, self.materials, whole)
        rows = len(self.tried)
        table = np.empty((rows + self.wide + self.materials + 1, len(whole)), np.uint8)
        kernels.shares(self.tried, self.seen, self.owner, around, np.float32(PRIOR_RAYS), table[:rows])
        table[rows:] = np.rint(np.concatenate([around, alike, whole[None]]) * 255)
        return table

    def _share(
        self, owner: Int32[np.ndarray, " p"], count: int, whole: Float[np.ndarray, " l"]
    ) -> Float32[np.ndarray, "{count} l"]:
        tried, seen = (np.zeros((count, len(whole)), np.float32) for _ in range(2))
        kernels.add_counts(self.tried, self.seen, owner, tried, seen)
        return ((seen + PRIOR_RAYS * whole) / (tried + PRIOR_RAYS)).astype(np.float32)
