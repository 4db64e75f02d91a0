"""What a renderer of rooms is asked for."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from roomlight.dataset.recording import Recording, Split


@dataclass(frozen=True)
class RoomRequest:
    """Sequences of one room; the same request gives the same recordings.

    Attributes:
        index: Number of the room in its split.
        count: Number of sequences.
        furniture: Furniture library or cache; None: the installed libraries.
        panoramas: Folder of panoramas, for rooms that they light.
        furniture_share: Share of the rooms lit by panoramas that have furniture.
        scenes: Blender files, of which the one with the number `index` is the room.
        samples: Paths a pixel of frames of Blender files.
    """

    index: int
    seed: int
    split: Split
    count: int
    frames: int
    furniture: Path | None = None
    panoramas: Path | None = None
    furniture_share: float = 0.0
    scenes: tuple[Path, ...] = ()
    samples: int = 0


RenderRoom = Callable[[RoomRequest], Iterator[Recording]]
"""Yields the recordings of a room: `render_room` and `render_views` of `sequences` and `panoramas`."""
