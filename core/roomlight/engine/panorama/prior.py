"""The light of directions that no frame has shown, from what rooms are like: a Gaussian over log panoramas.

The logarithm of a room's light, log(L + `OFFSET`) on a coarse panorama, has a mean that depends on the row alone
(ceilings are brighter than floors) and a covariance of two pixels that depends on their rows and on their difference in
azimuth (rooms have no preferred heading). Given the pixels that were seen, y_s, the others have the mean

    m_u = mu_u + K_us (K_ss + `NOISE` I)^-1 (y_s - mu_s)

for each channel: bright walls make bright walls likely, a bright ceiling a bright floor, and far from what was seen
the mean of all rooms remains. exp(m) is the best guess of each single direction in the logarithm.

Fitted on the ground-truth panoramas of a dataset (`roomlight dataset prior`), in a second; about 2 ms for a panorama.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from roomlight.engine.kernels.cholesky import multiply, solve_in_place
from roomlight.engine.networks.graphs import SHIPPED, PartFiles
from roomlight.errors import ModelError
from roomlight.files import write_atomic

ROWS: Final = 16
COLUMNS: Final = 2 * ROWS
OFFSET: Final = 0.05
"""Relative to white: differences between darker values do not count. log(L + 1) is worse (1.05 of the push-pull fill's
log-L2 on 11 artists' captures, where this has 0.96)."""
NOISE: Final = 0.1
"""Variance of a seen pixel beside the model: what the panorama's coarse pixels average over."""
SEEN_SHARE: Final = 0.5
"""A coarse pixel counts as seen from this share of its area on."""
FILE: Final = "prior.npz"


@dataclass(frozen=True, eq=False)
class PanoramaPrior:
    """Mean and covariance of log(L + `OFFSET`).

    Attributes:
        mean: [rows] of each row, from the top.
        covariance: [rows, rows, columns] of a pixel in the first row and one in the second that lies so many columns
            to the left.
    """

    mean: Float32[np.ndarray, " rows"]
    covariance: Float32[np.ndarray, "rows rows columns"]

    @classmethod
    def fit(cls, panoramas: Iterable[Float[np.ndarray, "h w 3"]]) -> "PanoramaPrior":
        """Fit to true panoramas. Each counts in all headings and mirrored, and each channel counts as a sample.

        Raises:
            ValueError: there are none.
        """
        total, product, count = np.zeros(ROWS), np.zeros((ROWS, ROWS, COLUMNS)), 0
        for panorama in panoramas:
            for channel in np.moveaxis(np.log(_reduced(panorama) + OFFSET), -1, 0).astype(np.float64):
                for sample in (channel, channel[:, ::-1]):
                    spectrum = np.fft.fft(sample, axis=-1)
                    product += np.fft.ifft(spectrum[:, None] * spectrum[None].conj(), axis=-1).real / COLUMNS
                    total += sample.mean(axis=-1)
                    count += 1
        if count == 0:
            raise ValueError("a prior needs at least one panorama; got none")
        mean = total / count
        covariance = product / count - mean[:, None, None] * mean[None, :, None]
        return cls(mean.astype(np.float32), covariance.astype(np.float32))

    def fill(
        self, radiance: Float[np.ndarray, "h w 3"], seen: Float[np.ndarray, "h w"]
    ) -> Float32[np.ndarray, "h w 3"]:
        """Return the likeliest light of all directions, smooth, given the radiance where `seen` is 1 (0: unknown)."""
        height = len(seen)
        share = _reduced(seen[..., None])[..., 0]
        known = (share > SEEN_SHARE).reshape(-1)
        values = _reduced(radiance * seen[..., None]) / np.maximum(share, 1e-4)[..., None]
        logs = self._given(np.log(np.maximum(values, 0) + OFFSET).reshape(-1, 3), known)
        return np.maximum(np.exp(_enlarged(logs.reshape(ROWS, COLUMNS, 3), height)) - np.float32(OFFSET), 0)

    def _given(self, logs: Float[np.ndarray, "n 3"], known: Bool[np.ndarray, " n"]) -> Float32[np.ndarray, "n 3"]:
        mean = np.repeat(self.mean, COLUMNS)
        if not known.any():
            return np.repeat(mean[:, None], 3, axis=1)
        deviation = np.where(known, logs.T - mean, 0).astype(np.float32)
        # (K_ss + noise)^-1 y through the precision of all pixels, whose block of unseen pixels is inverted instead
        # where these are fewer: a solve takes the third power of the number of pixels. Products take all pixels, of
        # which those that do not count are 0: that is faster than to gather a matrix.
        fewer = known if 2 * known.sum() <= len(known) else ~known
        if fewer is known:
            solved = np.ascontiguousarray(deviation[:, known])
            solve_in_place(self._covariance_with_noise[np.ix_(known, known)], solved)
            deviation[:, known] = solved
        else:
            across = np.ascontiguousarray(_product(self._precision, deviation)[:, fewer])
            solve_in_place(self._precision[np.ix_(fewer, fewer)], across)
            deviation[:, fewer] = -across
            deviation = np.where(known, _product(self._precision, deviation), np.float32(0))
        return (mean + _product(self._matrix, deviation)).T.astype(np.float32)

    @cached_property
    def _covariance_with_noise(self) -> Float32[np.ndarray, "n n"]:
        return self._matrix + np.float32(NOISE) * np.eye(ROWS * COLUMNS, dtype=np.float32)

    @cached_property
    def _precision(self) -> Float32[np.ndarray, "n n"]:
        """The inverse of the covariance with noise."""
        return np.linalg.inv(self._covariance_with_noise.astype(np.float64)).astype(np.float32)

    @cached_property
    def _matrix(self) -> Float32[np.ndarray, "n n"]:
        """The covariance of all pairs of pixels, row by row."""
        column = np.arange(COLUMNS)
        difference = (column[:, None] - column[None, :]) % COLUMNS
        pairs = self.covariance[:, :, difference]  # [row, row, column, column]
        return np.ascontiguousarray(pairs.transpose(0, 2, 1, 3).reshape(ROWS * COLUMNS, ROWS * COLUMNS))

    def save(self, path: Path) -> None:
        """Write the arrays to a file of NumPy's, atomically. Raises OutputError."""
        buffer = BytesIO()
        np.savez_compressed(buffer, mean=self.mean, covariance=self.covariance)
        write_atomic(path, buffer.getvalue())

    @classmethod
    def load(cls, path: Path) -> "PanoramaPrior":
        """Read what `save` wrote.

        Raises:
            ModelError: the file is missing or damaged.
        """
        try:
            with np.load(path, allow_pickle=False) as arrays:
                mean, covariance = arrays["mean"], arrays["covariance"]
        except (OSError, ValueError, KeyError) as error:
            raise ModelError(f"{path}: cannot be read as a prior over panoramas ({error})") from error
        if mean.shape != (ROWS,) or covariance.shape != (ROWS, ROWS, COLUMNS):
            raise ModelError(
                f"{path}: must hold mean {(ROWS,)} and covariance {(ROWS, ROWS, COLUMNS)}; "
                f"got {mean.shape} and {covariance.shape}"
            )
        return cls(mean.astype(np.float32), covariance.astype(np.float32))


def _product(matrix: Float32[np.ndarray, "m n"], values: Float32[np.ndarray, "c n"]) -> Float32[np.ndarray, "c m"]:
    out = np.empty((len(values), len(matrix)), np.float32)
    multiply(matrix, np.ascontiguousarray(values), out)
    return out


@cache
def shipped_prior(
    folder: Path = SHIPPED / "prior",
    files: PartFiles = (),  # noqa: ARG001 - of the cache's key
) -> PanoramaPrior:
    """Load the prior inside the package, or of another folder, once as long as its `files` are these.

    Raises:
        ModelError: it is missing or damaged.
    """
    return PanoramaPrior.load(folder / FILE)


def _reduced(plane: Float[np.ndarray, "h w c"]) -> Float32[np.ndarray, "rows columns c"]:
    small = cv2.resize(np.asarray(plane, np.float32), (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    return small.reshape(ROWS, COLUMNS, -1)


def _enlarged(plane: Float[np.ndarray, "rows columns c"], height: int) -> Float32[np.ndarray, "h w c"]:
    """Enlarge bilinearly; columns wrap around."""
    wrapped = np.concatenate([plane[:, -1:], plane, plane[:, :1]], axis=1).astype(np.float32)
    return cv2.remap(wrapped, *_places(height), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@lru_cache(4)
def _places(height: int) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Return column and row of each pixel in the wrapped coarse panorama."""
    scale = COLUMNS / (2 * height)
    column, row = np.meshgrid((np.arange(2 * height) + 0.5) * scale + 0.5, (np.arange(height) + 0.5) * scale - 0.5)
    return column.astype(np.float32), row.astype(np.float32)
