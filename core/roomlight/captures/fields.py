"""Checked values from untrusted index files: each helper returns the value it is named for or raises ValueError.

The message names the field and the value; `naming` adds the file and chooses the error's class. Pydantic is no
shorter here: a bad frame must not refuse the capture, so that every entry is checked by itself when it is read, and
the same checks serve CSV and text files.
"""

import codecs
import csv
import json
import math
import re
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from typing import Any, Final, TypeVar

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.errors import CaptureError, FrameError, RoomLightError
from roomlight.notes import Note

_Parsed = TypeVar("_Parsed")

_DECIMAL_COMMA: Final = re.compile(r"(?=.*,)[-+]?\d*(,\d+)?(e[-+]?\d+)?(\s++[-+]?\d*(,\d+)?(e[-+]?\d+)?)+", re.I)
"""A line of numbers between blanks. Linear in its length."""

_COMMENT: Final = re.compile(r'("(?:[^"\\]|\\.)*+"?)|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL)
"""A string of JSON, or a comment as C has them. Linear in the text's length."""


@contextmanager
def naming(label: str, error: type[CaptureError] | type[FrameError]) -> Generator[None]:
    """Convert a ValueError raised inside the block to `error`, with the file's name in front."""
    try:
        yield
    except RoomLightError:
        raise
    except (ValueError, OverflowError) as cause:
        raise error(f"{label}: {cause}") from cause


def parse_json(data: bytes, label: str) -> dict[str, Any]:
    """Parse a JSON object, also one with comments. Raises CaptureError, which says where the JSON breaks."""
    try:
        data = data.removeprefix(codecs.BOM_UTF8)
        try:
            text = data.decode(json.detect_encoding(data), "surrogatepass")
        except UnicodeDecodeError:  # programs of Windows write names in the code page
            text = data.decode("latin-1")
        value = _json_value(text)
    except RecursionError as error:
        raise CaptureError(f"{label}: the JSON is nested too deeply") from error
    except ValueError as error:  # JSONDecodeError, UnicodeDecodeError, integers of thousands of digits
        raise CaptureError(f"{label}: is not valid JSON ({_short(error)}); the file is truncated or damaged") from error
    if not isinstance(value, dict):
        raise CaptureError(f"{label}: holds a {type(value).__name__} where an object with keys is expected")
    return value


def _json_value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        bare = _COMMENT.sub(lambda match: match[1] or " ", text)
        if bare == text:
            raise
        return json.loads(bare)


def parse_text(data: bytes, label: str) -> list[str]:
    """Split a text file into lines. UTF-8, and UTF-16 with its mark; other bytes are Latin-1, as in old comments.

    Raises:
        CaptureError: The bytes are not text.
    """
    data = data.removeprefix(codecs.BOM_UTF8)
    if b"\0" in data and data[:2] not in (b"\xff\xfe", b"\xfe\xff"):
        raise CaptureError(f"{label}: is not text (a zero at byte {data.index(0)})")
    return decoded(data).splitlines()


def parsed_lines(data: bytes, label: str, parse: Callable[[str], _Parsed], notes: list[Note]) -> list[_Parsed]:
    """Return what `parse` makes of each line that is neither empty nor a comment (#).

    Lines for which it raises ValueError are left out and noted. Raises CaptureError where no other is there, and for
    bytes that are not text.
    """
    values: list[_Parsed] = []
    wrong: list[str] = []
    for row, line in enumerate(parse_text(data, label), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                values.append(parse(line))
            except (ValueError, OverflowError) as error:
                wrong.append(f"{label}: line {row}: {error}")
    if wrong and not values:
        raise CaptureError(wrong[0])
    if wrong:
        more = f" (the first of {len(wrong)} such lines)" if len(wrong) > 1 else ""
        notes.append(Note(f"{wrong[0]}{more}", "what cannot be read is left out", "write the file again"))
    return values


def decoded(data: bytes) -> str:
    """Return bytes as text, by the rule of `parse_text`."""
    try:
        return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def parse_table(data: bytes, label: str) -> list[list[str]]:
    """Split a CSV file into rows of values, without empty rows.

    Values are separated by commas, or by semicolons or tabs as spreadsheet programs of other countries write them; with
    these a comma is a decimal point. Quotes around values are removed. Raises CaptureError for bytes that are not text.
    """
    lines = [line for line in parse_text(data, label) if line.strip()]
    head = lines[0] if lines else ""
    separator = next((mark for mark in ("\t", ";") if mark in head), ",")
    try:
        rows = [
            [value.strip() for value in row] for row in csv.reader(lines, delimiter=separator, skipinitialspace=True)
        ]
    except csv.Error as error:
        raise CaptureError(f"{label}: is not a table ({error})") from error
    if separator != ",":
        rows = [[value.replace(",", ".") for value in row] for row in rows]
    return rows


def number(value: object, what: str) -> float:
    """Check for a finite number; strings and booleans are refused."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{what} is {_short(value)}, not a number")
    try:
        result = float(value)
    except OverflowError as error:
        raise ValueError(f"{what} is too large a number") from error
    if not math.isfinite(result):
        raise ValueError(f"{what} is {result}, not a finite number")
    return result


def of_text(value: object) -> object:
    """Return a number that is written as text, anything else as it is."""
    if isinstance(value, str):
        with suppress(ValueError):
            return float(value)
    return value


def time(value: object) -> float | None:
    """Return a stated time in the file's unit: a number, also as text, or seconds of an ISO 8601 date; NaN for other
    values, None for none.
    """
    value = of_text(value)
    try:
        if isinstance(value, str):
            date = datetime.fromisoformat(value)
            value = (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
        return None if value is None else number(value, "the time")
    except ValueError:
        return math.nan


def positive(value: object, what: str) -> float:
    """Check for a finite number above zero."""
    result = number(value, what)
    if result <= 0:
        raise ValueError(f"{what} is {result}; it must be positive")
    return result


def pixels(value: object, what: str) -> int:
    """Check for a number of pixels: a whole number from 1 to 65535; 640.0 counts as whole."""
    result = number(value, what)
    if result != int(result) or not 1 <= result <= 65535:
        raise ValueError(f"{what} is {result:g}, not a number of pixels from 1 to 65535")
    return int(result)


def text(value: object, what: str) -> str:
    """Check for a non-empty string."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{what} is {_short(value)}, not a file name")
    return value


def vector(value: object, length: int, what: str) -> Float[np.ndarray, " {length}"]:
    """Check for a list of `length` numbers, float64. NaN and infinity pass: the pose check reports lost tracking."""
    if not isinstance(value, list | tuple) or len(value) != length:
        raise ValueError(f"{what} is {_short(value)}, not {length} numbers")
    for item in value:
        if isinstance(item, bool) or not isinstance(item, int | float):
            raise ValueError(f"{what} holds {_short(item)}, not a number")
    return coordinates(value, what)


def coordinates(values: list[Any] | tuple[Any, ...], what: str) -> Float[np.ndarray, " n"]:
    """Convert numbers of a pose or a lens to float64. NaN and infinity pass; values above 1e12 do not, so that
    products of them cannot overflow.
    """
    try:
        array = np.array(values, np.float64)
    except OverflowError as error:
        raise ValueError(f"{what} holds too large a number") from error
    if (np.abs(array[np.isfinite(array)]) > 1e12).any():
        raise ValueError(f"{what} holds too large a number: {_short(values)}")
    return array


def matrix4(value: object, what: str) -> Float[np.ndarray, "4 4"]:
    """Convert nested lists, or 16 numbers row by row, to a 4 x 4 matrix; a 3 x 4 matrix gets the last row 0 0 0 1."""
    if isinstance(value, list) and len(value) == 16:
        if value[12:] != [0, 0, 0, 1]:
            raise ValueError(f"{what} is 16 numbers, not row by row, whose last are 0 0 0 1; write it as 4 rows of 4")
        value = [value[at : at + 4] for at in range(0, 16, 4)]
    if not isinstance(value, list) or len(value) not in (3, 4):
        raise ValueError(f"{what} is {_short(value)}, not a 4 x 4 matrix")
    whole = value if len(value) == 4 else [*value, [0.0, 0.0, 0.0, 1.0]]
    return np.stack([vector(row, 4, f"row {index} of {what}") for index, row in enumerate(whole)])


def matrix3(value: object, what: str) -> Float[np.ndarray, "3 3"]:
    """Convert nested lists to a 3 x 3 matrix."""
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{what} is {_short(value)}, not a 3 x 3 matrix")
    return np.stack([vector(row, 3, f"row {index} of {what}") for index, row in enumerate(value)])


def camera(stated: Mapping[str, Any]) -> Intrinsics:
    """Check for `fx`, `fy`, `cx`, `cy`, `width` and `height` of a pinhole camera, in pixels."""
    fx, fy, cx, cy = (number(stated.get(key), key) for key in ("fx", "fy", "cx", "cy"))
    return Intrinsics(fx, fy, cx, cy, pixels(stated.get("width"), "width"), pixels(stated.get("height"), "height"))


def objects(value: object, what: str) -> list[dict[str, Any]]:
    """Check for a list of JSON objects. Other entries become empty objects, which fail when they are read."""
    if not isinstance(value, list):
        raise ValueError(f"{what} is {_short(value)}, not a list")
    return [item if isinstance(item, dict) else {} for item in value]


def flag(value: object) -> bool:
    """Return whether a flag is set, as JSON, numbers or words state it."""
    return value.strip().lower() in ("true", "1", "yes") if isinstance(value, str) else value is True or value == 1


def unit(value: object, what: str) -> float:
    """Check for a length unit in metres: from a nanometre to a kilometre."""
    result = positive(value, what)
    if not 1e-9 <= result <= 1e3:
        raise ValueError(f"{what} is {result:g} m; a unit lies between 1e-9 and 1000 m")
    return result


def first_of(entry: Mapping[str, Any], shared: Mapping[str, Any], *keys: str) -> Any:
    """Return the entry's value for the first key it has, else the shared defaults', else None."""
    for place in (entry, shared):
        for key in keys:
            if place.get(key) is not None:
                return place[key]
    return None


def numbers_of_line(line: str, count: int, what: str, *, more: bool = False) -> list[float]:
    """Parse the first `count` numbers of a line, or all if it may hold more, separated by blanks or commas.

    NaN and infinity pass. A comma is a decimal point beside semicolons, and inside numbers that blanks separate.
    """
    is_point = ";" in line or _DECIMAL_COMMA.fullmatch(line.strip())
    parts = (line.replace(",", ".").replace(";", " ") if is_point else line.replace(",", " ")).split()
    if len(parts) < count:
        raise ValueError(f"{what} has {len(parts)} values where {count} are needed: {_short(line)}")
    try:
        return [float(part) for part in (parts if more else parts[:count])]
    except ValueError as error:
        raise ValueError(f"{what} holds a word that is not a number: {_short(line)}") from error


def matrix_of_text(data: bytes, size: int, label: str) -> Float[np.ndarray, "{size} {size}"]:
    """Parse a size x size matrix from the first rows of a text file; only the row 0 0 0 1 may follow."""
    lines = [line for line in parse_text(data, label) if line.strip()]
    if len(lines) < size:
        raise ValueError(f"has {len(lines)} rows of numbers where {size} are needed")
    rest = " ".join(lines[size:])
    if numbers_of_line(rest, 0, "what follows the matrix", more=True) not in ([], [0, 0, 0, 1]):
        raise ValueError(f"what follows the matrix is not read: {_short(rest)}; if it is a lens, undistort the images")
    rows = [numbers_of_line(line, size, f"row {row}") for row, line in enumerate(lines[:size])]
    return np.stack([coordinates(values, f"row {row}") for row, values in enumerate(rows)])


def natural_key(name: str) -> list[tuple[int, str]]:
    """Return a sort key that puts `9.jpg` before `10.jpg`: digits by length, then by digit; other text as is."""
    parts = re.findall(r"\d+|\D+", name)
    digits = [part.lstrip("0") if part[0].isdigit() else None for part in parts]
    return [(-1, part) if value is None else (len(value), value) for part, value in zip(parts, digits, strict=True)]


def _short(value: object) -> str:
    text = repr(value) if not isinstance(value, Exception) else str(value)
    return text if len(text) <= 80 else text[:77] + "..."
