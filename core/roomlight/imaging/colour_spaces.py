"""Colour spaces by their code points (ITU-T H.273, as video and PNG state them), to linear Rec. 709 RGB.

A camera's picture is encoded by a transfer curve between primaries. RoomLight's radiance is linear, between the
primaries of Rec. 709 and sRGB; colours outside them are clipped at 0. The curves of BT.601, BT.709 and BT.2020 are
decoded as sRGB's, because pictures are graded on displays that decode them so.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Shaped

from roomlight.conventions import srgb_to_linear

Chromaticities = tuple[float, float, float, float, float, float, float, float]
"""x and y of red, green, blue and white."""

_D65: Final = (0.3127, 0.3290)
_C: Final = (0.310, 0.316)
REC709: Final[Chromaticities] = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *_D65)
ADOBE_RGB: Final[Chromaticities] = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *_D65)
ACES_AP0: Final[Chromaticities] = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767)
"""Of an EXR that is an ACES image container (SMPTE ST 2065-4)."""
DISPLAY_P3: Final[Chromaticities] = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_D65)

UNSPECIFIED: Final = (2, 0, 3)
"""Code points of primaries and curves that are not stated: H.273's own, and reserved ones that recorders write."""

PRIMARIES: Final[dict[int, Chromaticities]] = {
    **dict.fromkeys((1, *UNSPECIFIED), REC709),
    4: (0.67, 0.33, 0.21, 0.71, 0.14, 0.08, *_C),
    5: (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *_D65),
    6: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65),
    7: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65),
    8: (0.681, 0.319, 0.243, 0.692, 0.145, 0.049, *_C),
    9: (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65),
    11: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    12: DISPLAY_P3,
    22: (0.630, 0.340, 0.295, 0.605, 0.155, 0.077, *_D65),
}
"""Primaries by code point."""

LIKE_SRGB: Final = (1, *UNSPECIFIED, 6, 7, 11, 12, 13, 14, 15)
_GAMMAS: Final = {4: 2.2, 5: 2.8, 8: 1.0, 17: 2.6}
PQ, HLG = 16, 18
_BRADFORD: Final = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


@dataclass(frozen=True)
class ColourSpace:
    """Primaries and a transfer curve.

    Attributes:
        primaries: Chromaticities of red, green, blue and white.
        transfer: Code point of the curve; 13 is sRGB.
        gamma: Exponent of the curve, in place of `transfer`.
    """

    primaries: Chromaticities = REC709
    transfer: int = 13
    gamma: float | None = None

    @classmethod
    def of_codes(cls, primaries: int, transfer: int) -> "ColourSpace":
        """Make the colour space of two code points.

        Raises:
            ValueError: A code point is another reserved one or of a curve that no camera writes; the message names it.
        """
        if primaries not in PRIMARIES:
            raise ValueError(f"has colour primaries of code {primaries}, which are not read; convert it to sRGB")
        if transfer not in (*LIKE_SRGB, *_GAMMAS, PQ, HLG):
            raise ValueError(f"has a transfer curve of code {transfer}, which is not read; convert it to sRGB")
        return cls(PRIMARIES[primaries], 13 if transfer in LIKE_SRGB else transfer)

    @property
    def is_srgb(self) -> bool:
        """Whether pixels decode as sRGB."""
        return self.primaries == REC709 and self.transfer == 13 and self.gamma is None

    def to_linear(self, encoded: Shaped[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
        """Decode integer pixels (their type's range is 0 to 1) to linear Rec. 709; negative values become 0.

        1 is the encoding's largest value; for PQ it is 1000 cd/m^2, HLG's nominal peak.
        """
        levels = int(np.iinfo(encoded.dtype).max)
        table = self._curve(np.arange(levels + 1, dtype=np.float64) / levels).astype(np.float32)
        linear = table[encoded]
        if self.primaries != REC709:
            linear = linear @ to_rec709(self.primaries).T.astype(np.float32)
        return np.maximum(linear, np.float32(0))

    def _curve(self, encoded: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        gamma = _GAMMAS.get(self.transfer) if self.gamma is None else self.gamma
        if gamma is not None:
            return encoded**gamma
        if self.transfer == HLG:  # BT.2100, scene light
            a, b, c = 0.17883277, 0.28466892, 0.55991073
            return np.where(encoded <= 0.5, encoded**2 / 3, (np.exp((encoded - c) / a) + b) / 12)
        if self.transfer == PQ:  # BT.2100, display light
            power = encoded ** (32 / 2523)
            light = np.maximum(power - 107 / 128, 0) / (2413 / 128 - 2392 / 128 * power)
            return 10 * light ** (8192 / 1305)
        return srgb_to_linear(encoded)


@lru_cache(maxsize=16)
def to_rec709(primaries: Chromaticities) -> Float[np.ndarray, "3 3"]:
    """Return the matrix from linear RGB of these primaries to linear Rec. 709, white to white (Bradford).

    Raises:
        ValueError: The chromaticities are not those of three colours.
    """
    if not all(map(math.isfinite, primaries)) or min(map(abs, primaries[1::2])) < 1e-6:  # ACES' blue lies below 0
        raise ValueError(f"has impossible chromaticities {primaries}")
    source, target = _to_xyz(primaries), _to_xyz(REC709)
    cones = (_BRADFORD @ target @ np.ones(3)) / (_BRADFORD @ source @ np.ones(3))
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(cones) @ _BRADFORD
    matrix = np.linalg.inv(target) @ adapted @ source
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 100:
        raise ValueError(f"has impossible chromaticities {primaries}")
    return matrix


def _to_xyz(primaries: Chromaticities) -> Float[np.ndarray, "3 3"]:
    x, y = np.array(primaries[0::2]), np.array(primaries[1::2])
    columns = np.stack([x / y, np.ones(4), (1 - x - y) / y])
    if abs(np.linalg.det(columns[:, :3])) < 1e-9:
        raise ValueError(f"has impossible chromaticities {primaries}")
    return columns[:, :3] * np.linalg.solve(columns[:, :3], columns[:, 3])
