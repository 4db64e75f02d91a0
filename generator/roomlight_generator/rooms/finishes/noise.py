"""What textures are made of: tileable noise, blocks laid in a pattern, and the step from sRGB floats to a `Texture`.

Images here are float32, sRGB-encoded, 0 to 1: shades are multiplied in the encoded space, which is cheap and close to
how one judges them. Everything wraps around both ways unless it says otherwise. `styled` gives each split its own
half of all parameter seeds, so that no texture of one split can come up in the other.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.colour import to_srgb
from roomlight_generator.rooms.scene import Rgb, Texture


def style_seed(split: Split, rng: np.random.Generator) -> int:
    """The seed of one texture's parameters: even in the train split, odd in the test split."""
    return 2 * int(rng.integers(1 << 40)) + (split == "test")


def styled(split: Split, rng: np.random.Generator) -> np.random.Generator:
    """A generator for one texture, from the split's own seeds."""
    return np.random.default_rng(style_seed(split, rng))


def texture(image: Float[np.ndarray, "h w 3"], size_m: tuple[float, float] = (1.0, 1.0)) -> Texture:
    """Rounded to 8 bits and given its size."""
    return Texture(np.clip(image * np.float32(255), 0, 255).astype(np.uint8), (float(size_m[0]), float(size_m[1])))


def fbm(
    rng: np.random.Generator,
    shape: tuple[int, int],
    cells: tuple[int, int],
    *,
    octaves: int = 4,
    gain: float = 0.55,
) -> Float[np.ndarray, "h w"]:
    """Smooth tileable fractal noise of variance about 0.15, mean about 0; `cells` are the coarsest rows and columns."""
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        rows, columns = _fitting(cells[0] << octave, shape[0]), _fitting(cells[1] << octave, shape[1])
        grid = rng.random((rows, columns), np.float32) * 2 - 1
        total += _stretched(grid, shape) * np.float32(gain**octave)
        if rows >= shape[0] and columns >= shape[1]:
            break
    return total


@lru_cache(maxsize=256)
def _fitting(cells: int, size: int) -> int:
    """The number of cells nearest to the one wanted (within a third) that divides the size: others cost three times."""
    divisors = [n for n in range(1, size + 1) if size % n == 0]
    best = min(divisors, key=lambda n: abs(np.log(n / cells)))
    return best if 3 * abs(best - cells) <= cells else min(cells, size)


def _stretched(grid: Float[np.ndarray, "r c"], shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Cubic interpolation around the torus: padded by two cells, enlarged by whole factors, then fitted."""
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
    """White noise blurred by sigma pixels (rows, columns), tileable, scaled back to a standard deviation of 1."""
    pad = [int(np.ceil(3 * s)) + 1 for s in sigma]
    grain = rng.standard_normal(shape, np.float32)
    grain = np.pad(grain, [(pad[0], pad[0]), (pad[1], pad[1])], mode="wrap")
    blurred = cv2.GaussianBlur(grain, (0, 0), sigmaX=max(sigma[1], 0.05), sigmaY=max(sigma[0], 0.05))
    blurred = blurred[pad[0] : pad[0] + shape[0], pad[1] : pad[1] + shape[1]]
    return (blurred / max(float(blurred.std()), 1e-6)).astype(np.float32)


def smooth(image: Float[np.ndarray, "h w 3"], sigma: int | float) -> Float[np.ndarray, "h w 3"]:
    """Blurred around the torus."""
    pad = int(np.ceil(3 * sigma)) + 1
    wrapped = np.pad(image, [(pad, pad), (pad, pad), (0, 0)], mode="wrap")
    return cv2.GaussianBlur(wrapped, (0, 0), sigma)[pad:-pad, pad:-pad]


def grid_uv(shape: tuple[int, int]) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """u (right) and v (down) of pixel centres, 0 to 1."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    return (u + np.float32(0.5)) / np.float32(shape[1]), (v + np.float32(0.5)) / np.float32(shape[0])


def flat(colour: Rgb, shape: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """One colour everywhere."""
    return np.broadcast_to(to_srgb(colour), (*shape, 3)).astype(np.float32)


def shaded(colour: Rgb, shade: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """A colour times a shade around 1."""
    return (to_srgb(colour) * shade[..., None]).astype(np.float32)


def mixed(a: Rgb, b: Rgb, share: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """From a (share 0) to b (share 1)."""
    start, end = to_srgb(a), to_srgb(b)
    return (start + (end - start) * np.clip(share, 0, 1)[..., None]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Blocks:
    """A pattern of blocks (planks, tiles, bricks): which one each pixel belongs to, how far the joint is (in pixels),
    and whether its grain runs down instead of along."""

    index: Int[np.ndarray, "h w"]
    joint_px: Float[np.ndarray, "h w"]
    turned: Bool[np.ndarray, "h w"] | None = None

    def tones(self, rng: np.random.Generator, spread: float, tint: float = 0.0) -> Float[np.ndarray, "h w 3"]:
        """A factor for each block: lightness within +- spread, and each channel within +- tint."""
        count = int(self.index.max()) + 1
        tone = 1 + spread * rng.uniform(-1, 1, (count, 1)) + tint * rng.uniform(-1, 1, (count, 3))
        return tone.astype(np.float32)[self.index]

    def cut(self, rng: np.random.Generator, atlas: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """Each block cut out of another place of the atlas (same shape, tileable; turned blocks transpose it)."""
        height, width = self.index.shape
        count = int(self.index.max()) + 1
        down = rng.integers(0, height, count)[self.index]
        right = rng.integers(0, width, count)[self.index]
        rows, columns = np.arange(height)[:, None], np.arange(width)[None, :]
        if self.turned is not None:
            rows, columns = np.where(self.turned, columns, rows), np.where(self.turned, rows, columns)
        return np.take(atlas.ravel(), ((rows + down) % height) * width + (columns + right) % width)

    def grout(
        self,
        image: Float[np.ndarray, "h w 3"],
        colour: Float[np.ndarray, "3"],
        width_px: int | float,
        bevel: int | float = 0.0,
    ) -> Float[np.ndarray, "h w 3"]:
        """Joints of the given full width and sRGB colour, antialiased; `bevel` darkens the blocks' rims."""
        inside = np.clip(self.joint_px - np.float32(width_px / 2) + np.float32(0.5), 0, 1)[..., None]
        if bevel > 0:
            rim = np.clip((self.joint_px - width_px / 2) / 3, 0, 1)[..., None]
            image = image * (1 - bevel * (1 - rim)).astype(np.float32)
        return (colour + (image - colour) * inside).astype(np.float32)


def laid_rows(
    rng: np.random.Generator, shape: tuple[int, int], *, rows: int, columns: int, shift: float | None = None
) -> Blocks:
    """Courses of equal blocks; each is shifted against the last by `shift` of a block, or at random where None.

    A fixed shift must come round after all rows (0.5 with an even number, 1/3 with a multiple of 3).
    """
    u, v = grid_uv(shape)
    row = (v * rows).astype(np.int32)
    shifts = rng.uniform(0, 1, rows) if shift is None else (np.arange(rows) * shift) % 1
    along = u * columns + shifts.astype(np.float32)[row]
    column = along.astype(np.int32) % columns
    across = np.minimum(v * rows - row, 1 - (v * rows - row)) * shape[0] / rows
    ends = np.minimum(along % 1, 1 - along % 1) * shape[1] / columns
    return Blocks((row * columns + column).astype(np.int32), np.minimum(across, ends).astype(np.float32))


def laid_herringbone(shape: tuple[int, int], *, length: int, repeats: int = 1) -> Blocks:
    """Blocks of length : 1, at right angles to each other along the diagonals."""
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


def laid_basket(shape: tuple[int, int], *, squares: int, strips: int) -> Blocks:
    """Parquet squares of parallel strips, every other one turned; `squares` must be even."""
    u, v = grid_uv(shape)
    x, y = u * squares, v * squares
    i, j = x.astype(np.int32), y.astype(np.int32)
    turned = (i + j) % 2 == 1
    across = np.where(turned, x % 1, y % 1) * strips
    along = np.where(turned, y % 1, x % 1) * strips
    strip = across.astype(np.int32)
    edge = np.minimum(np.minimum(along, strips - along), np.minimum(across % 1, 1 - across % 1))
    index = (j * squares + i) * strips + strip
    return Blocks(index.astype(np.int32), (edge * shape[1] / (squares * strips)).astype(np.float32), turned)


def laid_hexagons(shape: tuple[int, int], *, columns: int, rows: int) -> Blocks:
    """Regular hexagons (pointed at the top) where the repeat measures columns x rows sqrt(3) units; `rows` counts pairs
    of courses."""
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
