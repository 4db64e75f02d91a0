"""What the server and its processes of recordings (`worker`, `film_worker`) both know; it imports neither."""

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from roomlight.engine.options import SessionOptions
from roomlight.wire.compositing import CompositeQuality

if TYPE_CHECKING:
    from roomlight.compositing.placement.scene import Scene

RECORD: Final = struct.Struct("<II")
"""Lengths of the JSON and of the body of a record of these processes."""
MAX_FILM_BYTES: Final = 128 * 2**20
"""Largest film; 300 frames of 1280 x 960 take about 40 MB."""


class FilmJob(NamedTuple):
    """A film that is to be made: options of the session that lights it, its objects, and which of its frames."""

    options: SessionOptions
    scene: "Scene"
    quality: CompositeQuality
    first: int
    frames: int
