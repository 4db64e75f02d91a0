"""Notes on what a file states and RoomLight leaves out, guesses or changes."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

_OF_USE: Final = re.compile(
    r"k[1-6]|p[12]|is_?bad|.*distort.*|.*(lens|camera)_?model.*|lens_?type|.*units?|.*scale"
    r"|.*(orientation|rotation|rotated?|mirror(ed)?|flip(ped)?|crop(ped)?)",
    re.IGNORECASE,
)
"""Keys of a lens, a unit, or of what was done to a picture."""
_OBLONG: Final = re.compile(r": its pixels are (\S+) times as wide as high$")
_CALIBRATED: Final = 0.03


@dataclass(frozen=True)
class Note:
    """A fact of a file that was not used as it stands.

    Attributes:
        left_out: What was left out, guessed or changed, with the file's own word for it.
        effect: What this changes in the result.
        advice: What to do about it.
    """

    left_out: str
    effect: str
    advice: str

    def __str__(self) -> str:
        return f"{self.left_out}: {self.effect}; {self.advice}"


def keys_of_use(stated: Iterable[str]) -> set[str]:
    """Return the keys, of those that a reader does not know, that bear on geometry or light."""
    return {key for key in stated if _OF_USE.fullmatch(key)}


def unread_keys(name: str, keys: set[str]) -> list[Note]:
    """Make the note for keys of an index that are not read; none without keys."""
    if not keys:
        return []
    listed = ", ".join(key[:40] for key in sorted(keys)[:8]) + (" and more" if len(keys) > 8 else "")
    effect, advice = "they are not read", "undo them first if they change poses, lens, depth or exposure"
    return [Note(f"{name}: the keys {listed}", effect, advice)]


def oblong_pixels(name: str, aspect: float) -> list[Note]:
    """Make the note for pixels that are `aspect` times as wide as high; none for squares."""
    if abs(aspect - 1) <= 0.01:
        return []
    effect = "pixels are read as squares, as intrinsics count them"
    return [Note(f"{name}: its pixels are {aspect:.3g} times as wide as high", effect, "resample it")]


def states_aspect(note: Note, aspect: float) -> bool:
    """Return whether the note is of `oblong_pixels`, with this aspect within what a calibration may differ by."""
    stated = _OBLONG.search(note.left_out)
    return stated is not None and abs(float(stated[1]) / aspect - 1) <= _CALIBRATED


def distinct(notes: Iterable[Note]) -> tuple[Note, ...]:
    """Return the notes without repetitions, in order."""
    return tuple(dict.fromkeys(notes))
