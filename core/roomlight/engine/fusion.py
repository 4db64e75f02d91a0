"""Fusion of the frames' initial volumes: the mean over the frames that observed a voxel."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class FusedVolume:
    """Sums over frames of one grid, updated in place; float32.

    Attributes:
        colour: sum of alpha C.
        opacity: sum of alpha.
        count: number of frames that observed the voxel, as surface or as empty.
    """

    colour: Float[np.ndarray, "z y x 3"]
    opacity: Float[np.ndarray, "z y x"]
    count: Float[np.ndarray, "z y x"]

    @classmethod
    def fresh(cls, shape: tuple[int, int, int]) -> "FusedVolume":
        """Return empty sums; `shape` is (z, y, x)."""
        return cls(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32))

    def add(self, volume: Float[np.ndarray, "5 z y x"]) -> None:
        """Add the initial volume of one more frame."""
        opacity = volume[3]
        self.opacity[:] += opacity  # 0 where not observed
        self.count[:] += (opacity > 0) | (volume[4] < 0)
        for channel in range(3):
            self.colour[..., channel] += volume[channel]

    def write(self, out: Float[np.ndarray, "5 z y x"]) -> None:
        """Write the mean as an initial volume: c and alpha are means, e = -1 where every observation was empty.

        The mean of one frame is that frame's volume, to the bit.
        """
        frames = np.maximum(self.count, 1)
        for channel in range(3):
            np.divide(self.colour[..., channel], frames, out=out[channel])
        np.divide(self.opacity, frames, out=out[3])
        out[4] = np.where((self.count > 0) & (self.opacity == 0), np.float32(-1), np.float32(0))
