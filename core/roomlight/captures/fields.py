"""Values out of files that may hold anything: each helper returns what its name says or raises ValueError.

The message says which field and which value; `naming` puts the file in front and chooses the error's class.
"""

import json
import math
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from jaxtyping import Float

from roomlight.errors import CaptureError, FrameError, RoomLightError


@contextmanager
def naming(label: str, error: type[CaptureError] | type[FrameError]) -> Generator[None]:
    """Turn a ValueError inside the block into `error`, with the file's name in front."""
    try:
        yield
    except RoomLightError:
        raise
    except (ValueError, OverflowError) as cause:
        raise error(f"{label}: {cause}") from cause


def parse_json(data: bytes, label: str) -> dict[str, Any]:
    """The JSON object in these bytes; anything else is a CaptureError that says where it breaks."""
    try:
        value: Any = json.loads(data)
    except RecursionError as error:
        raise CaptureError(f"{label}: the JSON is nested too deeply to be a capture's index") from error
    except ValueError as error:  # JSONDecodeError, UnicodeDecodeError, integers of thousands of digits
        raise CaptureError(f"{label}: is not valid JSON ({_short(error)}); the file is truncated or damaged") from error
    if not isinstance(value, dict):
        raise CaptureError(f"{label}: holds a {type(value).__name__} where an object with keys is expected")
    return value


def parse_text(data: bytes, label: str) -> list[str]:
    """The lines of a text file."""
    try:
        return data.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise CaptureError(f"{label}: is not text ({error.reason} at byte {error.start})") from error


def number(value: object, what: str) -> float:
    """A finite number (not a string, not a truth value)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{what} is {_short(value)}, not a number")
    try:
        result = float(value)
    except OverflowError as error:
        raise ValueError(f"{what} is too large a number") from error
    if not math.isfinite(result):
        raise ValueError(f"{what} is {result}, not a finite number")
    return result


def positive(value: object, what: str) -> float:
    """A finite number above zero."""
    result = number(value, what)
    if result <= 0:
        raise ValueError(f"{what} is {result}; it must be positive")
    return result


def pixels(value: object, what: str) -> int:
    """A count of pixels: a whole number from 1 to 65535, possibly written as 640.0."""
    result = number(value, what)
    if result != int(result) or not 1 <= result <= 65535:
        raise ValueError(f"{what} is {result:g}, not a number of pixels from 1 to 65535")
    return int(result)


def text(value: object, what: str) -> str:
    """A non-empty string."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{what} is {_short(value)}, not a file name")
    return value


def vector(value: object, length: int, what: str) -> Float[np.ndarray, " {length}"]:
    """So many numbers, float64; NaN and infinity pass, for a lost pose is judged as a pose."""
    if not isinstance(value, list | tuple) or len(value) != length:
        raise ValueError(f"{what} is {_short(value)}, not {length} numbers")
    for item in value:
        if isinstance(item, bool) or not isinstance(item, int | float):
            raise ValueError(f"{what} holds {_short(item)}, not a number")
    return coordinates(value, what)


def coordinates(values: list[Any] | tuple[Any, ...], what: str) -> Float[np.ndarray, " n"]:
    """Numbers of a pose or a lens, float64: NaN and infinity pass, but nothing whose square would overflow."""
    try:
        array = np.array(values, np.float64)
    except OverflowError as error:
        raise ValueError(f"{what} holds too large a number") from error
    if (np.abs(array[np.isfinite(array)]) > 1e12).any():
        raise ValueError(f"{what} holds too large a number: {_short(values)}")
    return array


def matrix4(value: object, what: str) -> Float[np.ndarray, "4 4"]:
    """A 4 x 4 (or 3 x 4) matrix from nested lists."""
    if not isinstance(value, list) or len(value) not in (3, 4):
        raise ValueError(f"{what} is {_short(value)}, not a 4 x 4 matrix")
    rows = [vector(row, 4, f"row {index} of {what}") for index, row in enumerate(value)]
    if len(rows) == 3:
        rows.append(np.array([0.0, 0.0, 0.0, 1.0]))
    return np.stack(rows)


def objects(value: object, what: str) -> list[dict[str, Any]]:
    """A list of JSON objects; an entry that is none becomes an empty one, which fails by itself."""
    if not isinstance(value, list):
        raise ValueError(f"{what} is {_short(value)}, not a list")
    return [item if isinstance(item, dict) else {} for item in value]


def unit(value: object, what: str) -> float:
    """Metres for one stored unit: from a nanometre to a kilometre."""
    result = positive(value, what)
    if not 1e-9 <= result <= 1e3:
        raise ValueError(f"{what} is {result:g} m; nothing is stored in such a unit")
    return result


def first_of(entry: Mapping[str, Any], shared: Mapping[str, Any], *keys: str) -> Any:
    """The first of these keys that the entry has, else that the shared defaults have, else None."""
    for place in (entry, shared):
        for key in keys:
            if place.get(key) is not None:
                return place[key]
    return None


def numbers_of_line(line: str, count: int, what: str) -> list[float]:
    """So many numbers from a line of text, apart by blanks or commas; NaN and infinity pass."""
    parts = line.replace(",", " ").split()
    if len(parts) < count:
        raise ValueError(f"{what} has {len(parts)} values where {count} are needed: {_short(line)}")
    try:
        return [float(part) for part in parts[:count]]
    except ValueError as error:
        raise ValueError(f"{what} holds something that is no number: {_short(line)}") from error


def matrix_of_text(data: bytes, size: int, label: str) -> Float[np.ndarray, "{size} {size}"]:
    """A size x size matrix from a text file of at least as many rows; ValueError when it is none."""
    lines = [line for line in parse_text(data, label) if line.strip()]
    if len(lines) < size:
        raise ValueError(f"has {len(lines)} rows of numbers where {size} are needed")
    rows = [numbers_of_line(line, size, f"row {row}") for row, line in enumerate(lines[:size])]
    return np.stack([coordinates(values, f"row {row}") for row, values in enumerate(rows)])


def _short(value: object) -> str:
    shown = repr(value) if not isinstance(value, Exception) else str(value)
    return shown if len(shown) <= 80 else shown[:77] + "..."
