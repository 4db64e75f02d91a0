"""A folder of equirectangular HDR panoramas: its files, which split each is in, its digest, its pixels.

All panoramas of one building are on one side of the split. Files whose names differ only in a number at the end, or in
a resolution such as `_2k`, are taken to show one building.
"""

import hashlib
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float32

from roomlight.dataset.recording import Split
from roomlight.errors import DatasetError, ImageError
from roomlight.images import read_panorama

SUFFIXES: Final = (".exr", ".hdr")
TEST_SHARE: Final = 0.2
"""Share of the buildings that are in the test split."""
MAX_HEIGHT: Final = 1024
"""Larger panoramas are reduced to this many rows: 0.18 degrees a pixel, as fine as a frame's pixel."""

_RESOLUTION: Final = re.compile(r"_[0-9]{1,2}k$")
_NUMBER: Final = re.compile(r"[-_ ]*[0-9]+$")


def panorama_files(folder: Path) -> list[Path]:
    """Return the panoramas of a folder, ordered by name.

    Raises:
        DatasetError: if the folder cannot be read, or holds none.
    """
    try:
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    except OSError as error:
        raise DatasetError(
            f"{folder}: cannot be read ({error.strerror or error}); name a folder of panoramas"
        ) from error
    if not files:
        raise DatasetError(f"{folder}: holds no panorama; put equirectangular HDR images there, .exr or .hdr")
    return files


def building(path: Path) -> str:
    """Return the building that a panorama shows: its name without resolution and number."""
    stem = _RESOLUTION.sub("", path.stem.lower())
    return _NUMBER.sub("", stem) or stem


def split_of(path: Path) -> Split:
    """Return the split of a panorama: a hash of its building, so that other files do not change it."""
    number = int.from_bytes(hashlib.sha256(building(path).encode()).digest()[:8], "big")
    return "test" if number < TEST_SHARE * 2**64 else "train"


def split_files(folder: Path, split: Split) -> list[Path]:
    """Return the panoramas of a split, ordered by name.

    Raises:
        DatasetError: if the folder cannot be read, or the split has none.
    """
    files = panorama_files(folder)
    chosen = [path for path in files if split_of(path) == split]
    if not chosen:
        raise DatasetError(
            f"{folder}: its {len(files)} panoramas show {len({building(path) for path in files})} buildings, of which "
            f"none is in the {split} split (test has a fifth, by a hash of the name); add panoramas of other buildings"
        )
    return chosen


def panoramas_digest(folder: Path) -> str:
    """Return the SHA-256 of a folder's panoramas and their names.

    Raises:
        DatasetError: if one cannot be read.
    """
    return files_digest((path.name, path) for path in panorama_files(folder))


def files_digest(files: Iterable[tuple[str, Path]]) -> str:
    """Return the SHA-256 of named files, in their order.

    Raises:
        DatasetError: if one cannot be read.
    """
    sha = hashlib.sha256()
    for name, path in files:
        try:
            sha.update(f"{name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
        except OSError as error:
            raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from error
    return sha.hexdigest()


@lru_cache(maxsize=8)
def load_panorama(path: Path) -> Float32[np.ndarray, "h w 3"]:
    """Read a panorama's linear RGB, at most `MAX_HEIGHT` rows; cached and read-only.

    Raises:
        DatasetError: if it does not decode, is not twice as wide as high, or is black.
    """
    try:
        image = read_panorama(path)
    except ImageError as error:
        raise DatasetError(f"{error}; repair it or take it out of the folder") from error
    if image.shape[0] > MAX_HEIGHT:
        image = cv2.resize(image, (2 * MAX_HEIGHT, MAX_HEIGHT), interpolation=cv2.INTER_AREA)
    if image.max() <= 0 or image.shape[0] < 16:
        what = "is black" if image.max() <= 0 else f"has {image.shape[0]} rows, fewer than 16"
        raise DatasetError(f"{path}: {what}; take it out of the folder")
    image = np.ascontiguousarray(image, np.float32)
    image.setflags(write=False)
    return image
