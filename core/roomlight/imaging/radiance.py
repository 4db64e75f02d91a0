"""What the header of a Radiance HDR states beside its size: exposure, primaries, the order of its rows."""

import re
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.errors import ImageError
from roomlight.imaging.colour_spaces import REC709, to_rec709

_HEAD_BYTES: Final = 65_536
_SIZE: Final = re.compile(rb"\n\n([+-])Y +(\d{1,6}) +([+-])X +(\d{1,6})\n")
_EQUAL_ENERGY: Final = (1 / 3, 1 / 3)


@dataclass(frozen=True)
class RadianceHeader:
    """A header.

    Attributes:
        size: Width and height in pixels.
        from_bottom: Whether the last row comes first.
        from_right: Whether the last column comes first.
        matrix: From the stored values to linear Rec. 709.
        aspect: Width of a pixel by its height.
        end: Bytes of the header; the pixels follow.
    """

    size: tuple[int, int]
    from_bottom: bool
    from_right: bool
    matrix: Float[np.ndarray, "3 3"]
    aspect: float
    end: int

    def standard_file(self, data: bytes) -> bytes:
        """Return the file as OpenCV reads it: its header states the size alone; old run-length coding is undone."""
        (width, height), pixels = self.size, data[self.end :]
        if not (pixels.startswith(b"\2\2") and 8 <= width < 32768):  # which begins a row of the new coding
            pixels = _without_runs(pixels, width * height)
        return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width) + pixels

    def picture(self, stored: Float[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
        """Return stored RGB upright, in linear Rec. 709."""
        turned = stored[:: -1 if self.from_bottom else 1, :: -1 if self.from_right else 1]
        same = np.array_equal(self.matrix, np.eye(3))
        return np.ascontiguousarray(turned if same else turned @ self.matrix.T, np.float32)


def read_header(data: bytes, name: str) -> RadianceHeader:
    """Read the header of an HDR file. Raises ImageError for one that is damaged, or whose values are not read."""
    head = data[:_HEAD_BYTES]
    match = _SIZE.search(head)
    if match is None and b"\r\n" in head[:80]:
        raise ImageError(f"{name}: the HDR was transferred as text, which damages pixels; transfer it as binary")
    if match is None:
        raise ImageError(f"{name}: the HDR has no size as rows of pixels (-Y HEIGHT +X WIDTH); save it upright")
    matrix, primaries, aspect = np.eye(3), REC709, 1.0
    for line in head[: match.start()].split(b"\n"):
        key, _, value = line.partition(b"=")
        if key == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise ImageError(f"{name}: the HDR holds {value[:20].decode('latin-1')}; RGB (32-bit_rle_rgbe) is read")
        if key not in (b"EXPOSURE", b"COLORCORR", b"PRIMARIES", b"GAMMA", b"PIXASPECT"):
            continue
        try:
            numbers = np.array(value.split(), np.float64)
            if key == b"PRIMARIES":
                primaries = numbers
            elif key == b"PIXASPECT":  # a pixel's height by its width
                aspect /= float(numbers[0])
            elif key == b"GAMMA" and numbers[0] != 1:
                raise ImageError(f"{name}: the HDR states a gamma of {numbers[0]:g}; linear values are read")
            elif key != b"GAMMA":  # what the values were multiplied by; several lines multiply
                if not 0 < numbers.min() <= numbers.max() < np.inf:
                    raise ValueError(f"a factor of {value!r}")
                matrix = matrix / np.broadcast_to(numbers, 3)[None]
        except (ValueError, IndexError, ZeroDivisionError) as error:
            raise ImageError(f"{name}: the HDR's {line[:60].decode('latin-1')!r} is damaged") from error
    return RadianceHeader(
        (int(match[4]), int(match[2])),
        match[1] == b"+",
        match[3] == b"-",
        _of_primaries(primaries, name) @ matrix,
        aspect,
        match.end(),
    )


def _without_runs(stored: bytes, count: int) -> bytes:
    """Return `count` pixels in which (1, 1, 1, n) stood for n times the one before; the next n counts 256 times n.

    Other data unchanged: without runs, and of another number of pixels.
    """
    pixels = np.frombuffer(stored, np.uint8, len(stored) // 4 * 4).reshape(-1, 4)
    runs = (pixels[:count, :3] == 1).all(axis=1)
    if not runs.any() or runs[0]:
        return stored
    at = np.arange(len(runs))
    shown = np.maximum.accumulate(np.where(runs, 0, at))
    repeats = np.where(runs, pixels[:count, 3].astype(np.int64) << 8 * np.clip(at - shown - 1, 0, 3), 1)
    return np.repeat(pixels[shown], repeats, axis=0).tobytes() if repeats.sum() == count else stored


def _of_primaries(stated: Any, name: str) -> Float[np.ndarray, "3 3"]:
    """Return the matrix to Rec. 709; Radiance's own primaries differ from it only by their white, which is kept."""
    values = tuple(float(value) for value in stated)
    if len(values) != 8:
        raise ImageError(f"{name}: the HDR states {len(values)} numbers as primaries; 8 are needed")
    own = max(abs(a - b) for a, b in zip(values[:6], REC709, strict=False)) < 0.002
    if own or np.allclose(values, (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *_EQUAL_ENERGY), atol=0.002):
        return np.eye(3)
    try:
        return to_rec709(values)
    except ValueError as error:
        raise ImageError(f"{name}: the HDR {error}") from error
