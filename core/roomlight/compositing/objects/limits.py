"""Limits on the files of virtual objects, checked before memory is spent on what a file declares."""

import re
from dataclasses import dataclass
from typing import Final

from roomlight.errors import ObjectError

NAN: Final = re.compile(rb"nan\([^()\s]*\)", re.IGNORECASE)
"""As Windows writes it: `-nan(ind)`."""


class PassedLimitError(ObjectError):
    """A limit is passed, which refuses the object also where damage would be noted."""


@dataclass(frozen=True)
class ObjectLimits:
    """The most that a file may hold.

    Attributes:
        file_bytes: The file itself, with the files beside it that it names.
        json_bytes: JSON of a glTF file, without its binary part.
        triangles: Triangles, each instance of a mesh counted.
        vertices: Vertices, each instance of a mesh counted.
        nodes: Nodes of a glTF file.
        node_depth: Nodes above each other.
        parts: Pairs of a mesh and its material, each instance counted.
        image_pixels: Pixels of one image.
        total_pixels: Pixels of all images together: 16 bytes each while they are converted.
    """

    file_bytes: int = 64_000_000
    json_bytes: int = 4_000_000
    triangles: int = 1_000_000
    vertices: int = 1_500_000
    nodes: int = 10_000
    node_depth: int = 1_000
    parts: int = 2_000
    materials: int = 256
    images: int = 64
    image_pixels: int = 4096 * 4096
    total_pixels: int = 4 * 4096 * 4096

    def check(self, field: str, value: int, name: str) -> None:
        """Raise PassedLimitError if `value` passes the limit `field`; the message begins with `name`."""
        limit = getattr(self, field)
        if value > limit:
            words = f"{field.replace('_', ' ')} {'are' if field.endswith('s') else 'is'}"
            raise PassedLimitError(f"{name}: {words} limited to {limit}, the file has {value}")


def plain_text(data: bytes) -> bytes:
    """Return text as UTF-8 without a byte order mark; UTF-16 with its mark is converted."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace").encode()
    return data.removeprefix(b"\xef\xbb\xbf")


def statement(line: bytes) -> tuple[str, str]:
    """Return a line's keyword in small letters, and what follows it. Text that is not UTF-8 is read as Latin-1, which
    keeps names of every code page apart."""
    words = [*line.strip().split(None, 1), b"", b""]  # of bytes: a letter's second byte can look like a space
    try:
        keyword, rest = words[0].decode(), words[1].decode()
    except UnicodeDecodeError:
        keyword, rest = words[0].decode("latin-1"), words[1].decode("latin-1")
    return keyword.lower(), rest
