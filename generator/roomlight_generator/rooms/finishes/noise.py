"""Building blocks of textures: tileable noise, block patterns, and conversion of sRGB floats to a `Texture`.

Images here are float32, sRGB-encoded, 0 to 1: shades are multiplied in the encoded space, which is cheap and close to
perception. Everything tiles in both directions unless stated otherwise. `split_rng` gives each split its own half of
all parameter seeds, so that the splits share no texture.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.colour import to_srgb
from roomlight_generator.rooms.scene import Rgb, Texture


def texture_seed(split: Split, rng: np.random.Generator) -> int:
    """Return the seed of one texture's parameters: even in the train split, odd in the test split."""
    return 2 * int(rng.integers(1 << 40)) + (split == "test")


def split_rng(split: Split, rng: np.random.Generator) -> np.random.Generator:
    """Return the random generator of one texture, seeded from the split's own seeds."""
    return np.random.default_rng(texture_seed(split, rng))


def to_texture(image: Float[np.ndarray, "h w 3"], size_m: tuple[float, float] = (1.0, 1.0)) -> Texture:
    """Convert an image to a `Texture`: 8 bits, with a physical size."""
    return Texture(np.clip(image * np.float32(255), 0, 255).astype(np.uint8), (float(size_m[0]), float(size_m[1])))


def fbm(
    rng: np.random.Generator,
    shape: tuple[int, int],
    cells: tuple[int, int],
    *,
    octaves: int = 4,
    gain: float = 0.55,
) -> Float[np.ndarray, "h w"]:
    """Return smooth tileable fractal noise of variance about 0.15 and mean about 0; `cells` are the coarsest rows
    and columns."""
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        rows, columns = _nearest_divisor(cells[0] << octave, shape[0]), _nearest_divisor(cells[1] << octave, shape[1])
        grid = rng.random((rows, columns), np.float32) * 2 - 1
        total += _upsampled(grid, shape) * np.float32(gain**octave)
        if rows >= shape[0] and columns >= shape[1]:
            break
    return total


@lru_cache(maxsize=256)
def _nearest_divisor(cells: int, size: int) -> int:
    """Return the divisor of `size` nearest to `cells` (within a third): sizes that do not divide cost three times as
    much."""
    divisors = [n for n in range(1, size + 1) if size % n == 0]
    best = min(divisors, key=lambda n: abs(np.log(n / cells)))
    return best if 3 * abs(best - cells) <= cells else min(cells, size)


def _upsampled(grid: Float[np.ndarray, "r c"], shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Interpolate cubically on the torus: padded by two cells, enlarged by whole factors, then cropped."""
    factors = [-(-shape[k] // grid.shape[k]) for k in (0, 1)]
    if factors == [1, 1]:
        return grid
    padded = np.pad(grid, 2, mode="wrap")
    size = (padded.shape[1] * factors[1], padded.shape[0] * factors[0])
    large = cv2.resize(padded, size, interpolation=cv2.INTER_CUBIC)
    top, left = 2 * factors[0], 2 * factors[1]
    large = large[top : top + grid.shape[0] * factors[0], left : left + grid.shape[1] * factors[1]]
    if large.shape != shape:
        large = cv2.resize(large, (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
    return large


def speckle(
    rng: np.random.Generator, shape: tuple[int, int], sigma: tuple[int | float, int | float]
) -> Float[np.ndarray, "h w"]:
    """Return white noise blurred by sigma pixels (rows, columns), tileable, rescaled to a standard deviation of 1."""
    pad = [int(np.ceil(3 * s)) + 1 for s in sigma]
    grain = rng.standard_normal(shape, np.float32)
    grain = np.pad(grain, [(pad[0], pad[0]), (pad[1], pad[1])], mode="wrap")
    blurred = cv2.GaussianBlur(grain, (0, 0), sigmaX=max(sigma[1], 0.05), sigmaY=max(sigma[0], 0.05))
    blurred = blurred[pad[0] : pad[0] + shape[0], pad[1] : pad[1] + shape[1]]
    return (blurred / max(float(blurred.std()), 1e-6)).astype(np.float32)


def blurred(image: Float[np.ndarray, "h w 3"], sigma: int | float) -> Float[np.ndarray, "h w 3"]:
    """Blur an image on the torus."""
    pad = int(np.ceil(3 * sigma)) + 1
    wrapped = np.pad(image, [(pad, pad), (pad, pad), (0, 0)], mode="wrap")
    return cv2.GaussianBlur(wrapped, (0, 0), sigma)[pad:-pad, pad:-pad]


def grid_uv(shape: tuple[int, int]) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return u (right) and v (down) of pixel centres, 0 to 1."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    return (u + np.float32(0.5)) / np.float32(shape[1]), (v + np.float32(0.5)) / np.float32(shape[0])


def flat(colour: Rgb, shape: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """Return an image of one colour."""
    return np.broadcast_to(to_srgb(colour), (*shape, 3)).astype(np.float32)


def shaded(colour: Rgb, shade: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return a colour multiplied by a shade around 1."""
    return (to_srgb(colour) * shade[..., None]).astype(np.float32)


def lerp(a: Rgb, b: Rgb, share: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Interpolate linearly from a (share 0) to b (share 1)."""
    start, end = to_srgb(a), to_srgb(b)
    return (start + (end - start) * np.clip(share, 0, 1)[..., None]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Blocks:
    """A pattern of blocks (planks, tiles, bricks): the block of each pixel, its distance to the joint (in pixels),
    and whether the block's grain runs down instead of along."""

    index: Int[np.ndarray, "h w"]
    joint_px: Float[np.ndarray, "h w"]
    rotated: Bool[np.ndarray, "h w"] | None = None

    def tones(self, rng: np.random.Generator, spread: float, tint: float = 0.0) -> Float[np.ndarray, "h w 3"]:
        """Return a factor for each block: lightness within +- spread, and each channel within +- tint."""
        count = int(self.index.max()) + 1
        tone = 1 + spread * rng.uniform(-1, 1, (count, 1)) + tint * rng.uniform(-1, 1, (count, 3))
        return tone.astype(np.float32)[self.index]

    def sample(self, rng: np.random.Generator, atlas: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """Give each block a random part of the atlas (same shape, tileable; rotated blocks transpose it)."""
        height, width = self.index.shape
        count = int(self.index.max()) + 1
        down = rng.integers(0, height, count)[self.index]
        right = rng.integers(0, width, count)[self.index]
        rows, columns = np.arange(height)[:, None], np.arange(width)[None, :]
        if self.rotated is not None:
            rows, columns = np.where(self.rotated, columns, rows), np.where(self.rotated, rows, columns)
        return np.take(atlas.ravel(), ((rows + down) % height) * width + (columns + right) % width)

    def grout(
        self,
        image: Float[np.ndarray, "h w 3"],
        colour: Float[np.ndarray, "3"],
        width_px: int | float,
        bevel: int | float = 0.0,
    ) -> Float[np.ndarray, "h w 3"]:
        """Draw joints of the given full width and sRGB colour, antialiased; `bevel` darkens the blocks' rims."""
        inside = np.clip(self.joint_px - np.float32(width_px / 2) + np.float32(0.5), 0, 1)[..., None]
        if bevel > 0:
            rim = np.clip((self.joint_px - width_px / 2) / 3, 0, 1)[..., None]
            image = image * (1 - bevel * (1 - rim)).astype(np.float32)
        return (colour + (image - colour) * inside).astype(np.float32)


def row_blocks(
    rng: np.random.Generator, shape: tuple[int, int], *, rows: int, columns: int, shift: float | None = None
) -> Blocks:
    """Lay rows of equal blocks; each is shifted against the last by `shift` of a block, or at random if None.

    The total of a fixed shift over all rows must be whole (0.5 with an even number of rows, 1/3 with a multiple of 3).
    """
    u, v = grid_uv(shape)
    row = (v * rows).astype(np.int32)
    shifts = rng.uniform(0, 1, rows) if shift is None else (np.arange(rows) * shift) % 1
    along = u * columns + shifts.astype(np.float32)[row]
    column = along.astype(np.int32) % columns
    across = np.minimum(v * rows - row, 1 - (v * rows - row)) * shape[0] / rows
    ends = np.minimum(along % 1, 1 - along % 1) * shape[1] / columns
    return Blocks((row * columns + column).astype(np.int32), np.minimum(across, ends).astype(np.float32))


def herringbone_blocks(shape: tuple[int, int], *, length: int, repeats: int = 1) -> Blocks:
    """Lay blocks of aspect length : 1 at right angles to each other along the diagonals."""
    u, v = grid_uv(shape)
    period = 2 * length
    x, y = u * period * repeats, v * period * repeats
    i, j = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
    offset = (i - j) % period
    lying = offset < length
    along = np.where(lying, offset + x % 1, (offset - length) + 1 - (y % 1))
    across = np.where(lying, y % 1, x % 1)
    edge = np.minimum(np.minimum(along, length - along), np.minimum(across, 1 - across))
    cells = period * repeats
    start = np.where(lying, (i - offset) % cells, i % cells)
    level = np.where(lying, j % cells, (j + offset - length) % cells)
    index = (np.where(lying, 0, 1) * cells + level) * cells + start
    return Blocks(index.astype(np.int32), (edge * shape[1] / cells).astype(np.float32), np.asarray(~lying))


def basket_weave_blocks(shape: tuple[int, int], *, squares: int, strips: int) -> Blocks:
    """Lay parquet squares of parallel strips, alternating in direction; `squares` must be even."""
    u, v = grid_uv(shape)
    x, y = u * squares, v * squares
    i, j = x.astype(np.int32), y.astype(np.int32)
    rotated = (i + j) % 2 == 1
    across = np.where(rotated, x % 1, y % 1) * strips
    along = np.where(rotated, y % 1, x % 1) * strips
    strip = across.astype(np.int32)
    edge = np.minimum(np.minimum(along, strips - along), np.minimum(across % 1, 1 - across % 1))
    index = (j * squares + i) * strips + strip
    return Blocks(index.astype(np.int32), (edge * shape[1] / (squares * strips)).astype(np.float32), rotated)


def hexagon_blocks(shape: tuple[int, int], *, columns: int, rows: int) -> Blocks:
    """Lay regular hexagons (pointed at the top) in a repeat of columns x rows sqrt(3) units; `rows` counts pairs of
    rows."""
    u, v = grid_uv(shape)
    x, y = u * columns, v * rows * np.float32(np.sqrt(3))
    tall = float(np.sqrt(3))
    best = np.full(shape, np.inf, np.float32)
    second = best.copy()
    index = np.zeros(shape, np.int32)
    for half in (0.0, 0.5):
        for left in (-1, 0, 1):
            i = np.floor(x - half) + left
            row = np.floor(y / tall - half)
            squared = (x - (i + half + 0.5)) ** 2 + (y - (row + half + 0.5) * tall) ** 2
            nearer = squared < best
            second = np.where(nearer, best, np.minimum(second, squared))
            best = np.where(nearer, squared, best)
            label = (row.astype(np.int32) % rows) * columns + i.astype(np.int32) % columns
            index = np.where(nearer, 2 * label + (half > 0), index)
    # The perpendicular bisector of two centres at distance 1: half of the difference of squared distances.
    return Blocks(index.astype(np.int32), ((second - best) / 2 * shape[1] / columns).astype(np.float32))
