"""Cube maps: six square faces in OpenGL's order and orientation (see `cube_geometry`)."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float16

from roomlight.errors import OptionError
from roomlight.light.checks import check_observed, check_panorama
from roomlight.light.cube_geometry import FACES, cube_solid_angles
from roomlight.light.ktx2 import LARGEST_HALF, encode_ktx2
from roomlight.light.resample import MAX_ROWS, SparseMap, cube_to_panorama, panorama_to_cube
from roomlight.spheres import resize_panorama

SIZES: Final = (16, 32, 64, 128, 256)
"""Face widths in pixels that can be made; ARCore uses 16."""
DEFAULT_SIZE: Final = 32
"""A face of 16 shows next to nothing in a mirror; 32 (3 degrees a texel) is the resolution of 120 panorama rows."""


@dataclass(frozen=True, eq=False)
class CubeMap:
    """Faces +X -X +Y -Y +Z -Z, [6, s, s, 3] float32 linear RGB; row 0 is stored first (OpenGL's t = 0).

    Raises:
        ValueError: a value is not finite.

    Examples:
        >>> import numpy as np, roomlight as rl
        >>> rl.CubeMap(np.ones((6, 8, 8, 3), np.float32)).faces.dtype
        dtype('float32')
    """

    faces: Float[np.ndarray, "6 s s 3"]

    def __post_init__(self) -> None:
        if not np.isfinite(self.faces).all():
            face, row, column = np.argwhere(~np.isfinite(self.faces))[0, :3]
            where = f"face {FACES[face]}, row {row}, column {column}"
            raise ValueError(f"a cube map holds finite numbers only, got {self.faces[face, row, column]} in {where}")

    @classmethod
    def from_panorama(cls, panorama: Float[np.ndarray, "h w 3"], *, size: int = DEFAULT_SIZE) -> "CubeMap":
        """Average the panorama's light over each texel; size 16, 32, 64, 128 or 256.

        0.5 ms for 120 x 240 to 32 on one core, 8 ms to 256; the first of a size takes 0.2 to 2 s more.

        Raises:
            OptionError: another size.
            ValueError: the panorama is not [H, 2H, 3] with 4 to 4096 rows of finite floats.
        """
        panorama = check_panorama(panorama)
        resample = _to_cube(len(panorama), size)
        panorama = resize_panorama(panorama, _reduced_rows(len(panorama), size))
        return cls(resample(panorama.reshape(-1, 3)).reshape(6, size, size, 3))

    @property
    def size(self) -> int:
        """Pixels across a face."""
        return self.faces.shape[1]

    def to_panorama(self, height: int) -> Float[np.ndarray, "{height} 2*{height} 3"]:
        """Average the cube's light over each pixel of a panorama of 4 to 512 rows.

        Raises:
            OptionError: another height.
            ValueError: the faces are wider than 256 pixels.
        """
        if not 4 <= height <= MAX_ROWS:
            raise OptionError(f"a cube map becomes a panorama of 4 to {MAX_ROWS} rows, got {height}")
        if self.size > SIZES[-1]:
            raise ValueError(f"a cube map of up to {SIZES[-1]} pixels becomes a panorama, this has {self.size}")
        pixels = cube_to_panorama(height, self.size)(self.faces.reshape(-1, 3))
        return pixels.reshape(height, 2 * height, 3)

    def rgba16f(self, alpha: Float[np.ndarray, "6 s s"] | None = None) -> Float16[np.ndarray, "6 s s 4"]:
        """Return half floats with alpha (1 unless given), clipped to 65504 so that no infinity reaches a renderer."""
        image = np.empty((*self.faces.shape[:3], 4), np.float16)
        image[..., :3] = np.clip(self.faces, -LARGEST_HALF, LARGEST_HALF)
        image[..., 3] = 1 if alpha is None else alpha
        return image

    def to_bytes(self, alpha: Float[np.ndarray, "6 s s"] | None = None) -> bytes:
        """Encode `rgba16f`, little endian, face after face and row after row: 8 bytes a pixel, 6 s s pixels."""
        return self.rgba16f(alpha).astype("<f2").tobytes()

    def to_ktx2(self, alpha: Float[np.ndarray, "6 s s"] | None = None) -> bytes:
        """Encode `rgba16f` as a KTX2 file."""
        return encode_ktx2([self.rgba16f(alpha)])


def observed_cube(
    observed: Float[np.ndarray, "h w"], *, size: int = DEFAULT_SIZE
) -> Float[np.ndarray, "6 {size} {size}"]:
    """Average `observed` over each texel, 0 to 1: the alpha channel of a cube map.

    Raises:
        OptionError: a size that no cube map has.
        ValueError: `observed` is not [H, 2H] with 4 to 4096 rows of numbers in [0, 1].
    """
    observed = check_observed(observed)
    resample = _to_cube(len(observed), size)
    rows = _reduced_rows(len(observed), size)
    if rows < len(observed):
        observed = resize_panorama(np.repeat(observed[..., None], 3, axis=-1), rows)[..., 0]
    return np.clip(resample(observed.reshape(-1, 1)), 0, 1).reshape(6, size, size)


def halved(faces: Float[np.ndarray, "6 s s c"]) -> Float[np.ndarray, "6 t t c"]:
    """Return faces of half the width with the same light: the mean of four texels, weighted by solid angle."""
    size, channels = faces.shape[1], faces.shape[3]
    weight = cube_solid_angles(size)
    blocks = (faces * weight[..., None]).reshape(6, size // 2, 2, size // 2, 2, channels).sum(axis=(2, 4))
    return (blocks / cube_solid_angles(size // 2)[..., None]).astype(np.float32)


def _to_cube(height: int, size: int) -> SparseMap:
    if size not in SIZES:
        raise OptionError(f"size of a cube map's face must be {', '.join(map(str, SIZES))} pixels, got {size}")
    return panorama_to_cube(_reduced_rows(height, size), size)


def _reduced_rows(height: int, size: int) -> int:
    """Return the rows to reduce the panorama to first: an integer fraction, if its pixels are far finer than texels."""
    return height // -(-height // min(MAX_ROWS, 8 * size))
