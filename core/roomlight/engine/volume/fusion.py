"""Fusion of the frames' initial volumes: the mean over the frames that observed a voxel.

Clipped observations of a voxel are not averaged with better ones: of the sum so far and the new frame, the one that
knows less takes the colour of the other (`roomlight.engine.observations.better_share`), whatever the order.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

from roomlight.conventions import LUMINANCE
from roomlight.engine.kernels.fusion import add_volume, write_mean, write_surfaces
from roomlight.engine.observations import better_share
from roomlight.engine.volume.sglv import Sglv


@dataclass(frozen=True)
class FusedVolume:
    """Sums over frames of one grid, updated in place; float32.

    Attributes:
        colour: sum of alpha C.
        opacity: sum of alpha.
        count: number of frames that observed the voxel, as surface or as empty.
        clipping: sums of alpha times the share of clipped pixels, and of alpha times the luminance estimated for them.
    """

    colour: Float[np.ndarray, "z y x 3"]
    opacity: Float[np.ndarray, "z y x"]
    count: Float[np.ndarray, "z y x"]
    clipping: Float[np.ndarray, "2 z y x"]

    @classmethod
    def fresh(cls, shape: tuple[int, int, int]) -> "FusedVolume":
        """Return empty sums; `shape` is (z, y, x)."""
        return cls(*(np.zeros(size, np.float32) for size in ((*shape, 3), shape, shape, (2, *shape))))

    def save(self) -> dict[str, np.ndarray]:
        """Return copies of the sums, by name."""
        return {plane.name: getattr(self, plane.name).copy() for plane in fields(self)}

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Take over saved sums."""
        for plane in fields(self):
            getattr(self, plane.name)[:] = saved[plane.name]

    def add(self, volume: Float[np.ndarray, "5 z y x"], clipping: Float[np.ndarray, "2 z y x"] | None = None) -> None:
        """Add the initial volume of one more frame.

        Args:
            clipping: As `roomlight.engine.volume.grid.initial_volume` writes it; None: the frame has no clipped pixel.
        """
        opacity = volume[3]
        doubtful = self.clipping[0] > 0 if clipping is None else (self.clipping[0] > 0) | (clipping[0] > 0)
        where = np.flatnonzero(doubtful & (opacity > 0))
        reconciled = self._reconciled(where, volume, clipping) if len(where) else None
        add_volume(volume.reshape(5, -1), *self._flat)
        if reconciled is not None:
            self.colour.reshape(-1, 3)[where] = reconciled[:, :3]
            self.clipping.reshape(2, -1)[:, where] = reconciled[:, 3:].T

    def _reconciled(
        self,
        where: Int[np.ndarray, " n"],
        volume: Float[np.ndarray, "5 z y x"],
        clipping: Float[np.ndarray, "2 z y x"] | None,
    ) -> Float[np.ndarray, "n 5"]:
        """Return the sums of colour (3) and clipping (2) with the frame, at these voxels (flat indices)."""
        alpha, total = volume[3].reshape(-1)[where, None], self.opacity.reshape(-1)[where, None]
        planes = np.zeros((2, len(where)), np.float32) if clipping is None else clipping.reshape(2, -1)[:, where]
        new = np.concatenate([volume[:3].reshape(3, -1)[:, where], planes]).T
        old = np.concatenate([self.colour.reshape(-1, 3)[where], self.clipping.reshape(2, -1)[:, where].T], axis=1)
        new_mean, old_mean = new / alpha, old / np.maximum(total, np.float32(1e-6))
        new_bound, old_bound = (mean[:, :3] @ LUMINANCE - mean[:, 4] for mean in (new_mean, old_mean))
        by_new = better_share(old_mean[:, 3], old_bound, new_mean[:, 3], new_bound)[:, None]
        by_old = better_share(new_mean[:, 3], new_bound, old_mean[:, 3], old_bound)[:, None]
        by_old = np.where(total > 0, by_old, 0)
        return old + by_new * (total * new_mean - old) + new + by_old * (alpha * old_mean - new)

    def write(self, out: Float[np.ndarray, "5 z y x"]) -> None:
        """Write the mean as an initial volume: c and alpha are means, e = -1 where every observation was empty.

        The mean of one frame is that frame's volume, to the bit.
        """
        write_mean(*self._flat, out.reshape(5, -1))

    def write_surfaces(self, sglv: Sglv, volume: Float[np.ndarray, "5 z y x"] | None) -> None:
        """Write the means into an SGLV: opacity over the frames that observed a voxel, colour weighted by opacity.

        Args:
            volume: Of the last frame: the rest has not changed; None: write all.
        """
        channels = sglv.lobes.shape[-1]
        observed = None if volume is None else volume.reshape(5, -1)
        write_surfaces(*self._flat, sglv.alpha.reshape(-1), sglv.lobes.reshape(-1, channels), observed)

    @property
    def _flat(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        return self.colour.reshape(-1, 3), self.opacity.reshape(-1), self.count.reshape(-1)
