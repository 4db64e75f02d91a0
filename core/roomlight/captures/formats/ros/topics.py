"""Topics of colour and of depth, chosen by their types and names."""

import re
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any, Final

from roomlight.captures.formats.ros.images import is_colour, is_range
from roomlight.errors import CaptureError
from roomlight.notes import Note

_COLOUR: Final = ("color", "rgb", "image")
_NO_COLOUR: Final = ("depth", "infra", "fisheye", "mask", "conf")
_NO_DEPTH: Final = re.compile("conf|disparity")
_NO_RANGE: Final = re.compile(
    r"conf|disparity|infra|mask|label|therm|intens|ampli|noise|gr[ae]y|mono|signal|reflec|range_|(^|[/_])ir([/_]|$)"
)
"""Names of 16-bit and float images that are no depth, where `depth` is not in the name."""
_RECTIFIED: Final = re.compile("(^|[/_])rect")


def colour_topic(
    path: Path, topics: Iterable[str], firsts: dict[str, Any], infos: Collection[str], notes: list[Note]
) -> str:
    """Return the topic of colour whose name fits best; others are noted.

    Args:
        path: The bag.
        topics: All topics.
        firsts: The first image of each topic of images.
        infos: Namespaces of cameras that have a CameraInfo.
        notes: Takes what is left out.

    Raises:
        CaptureError: There is none; says what there is.
    """
    images = [topic for topic in firsts if _rank(topic, _COLOUR) < len(_COLOUR) and not is_range(firsts[topic])]
    images = [topic for topic in images if _rank(topic, _NO_COLOUR) == len(_NO_COLOUR)]
    if not images:
        listed = ", ".join(sorted(topics)[:12]) or "nothing"
        raise CaptureError(f"{path}: has no topic of colour images; its topics are {listed}")
    spaces = {topic: space_of(topic, infos) for topic in images}

    def order(topic: str) -> tuple[bool, bool, int, bool, str]:
        guessed = space_of(topic) not in infos
        return spaces[topic] not in infos, guessed, _rank(topic, _COLOUR), "compressed" in topic, topic

    images.sort(key=order)
    known = dict.fromkeys(spaces[topic] for topic in images if spaces[topic] in infos)
    if others := [space or "/" for space in known if space != spaces[images[0]]]:
        left = f"{path}: the cameras {', '.join(others[:4])}"
        notes.append(Note(left, f"{images[0]} alone is read", "leave it out of the bag to read another"))
    return images[0]


def depth_topic(path: Path, colour: str, firsts: dict[str, Any], notes: list[Note]) -> str | None:
    """Return the topic of depth of the colour's frame, or nearest to its name; None without one.

    Noted are colours that are called depth, and depth that is not.
    """
    named = sorted(topic for topic in firsts if "depth" in topic.lower() and not _NO_DEPTH.search(topic.lower()))
    depths = [topic for topic in named if firsts[topic] is None or not is_colour(firsts[topic])]
    if not depths:
        depths = [topic for topic in firsts if is_range(firsts[topic]) and not _NO_RANGE.search(topic.lower())]
        if named and not depths:
            left, text = f"{path}: {', '.join(named[:4])}", "holds colours, so that no depth is read"
            notes.append(Note(left, text, "record depth (16UC1 or 32FC1)"))
    own, frame = colour.split("/"), _frame_of(firsts[colour])

    def order(topic: str) -> tuple[bool, int, int, bool, str]:
        parts = enumerate(zip(topic.split("/"), own, strict=False))
        shared = next((at for at, (part, other) in parts if part != other), len(own))
        other = _frame_of(firsts[topic]) != frame
        return other, -shared, _rank(topic, ("aligned", "registered")), "compressed" in topic, topic

    best = min(depths, key=order, default=None)
    if best is not None and best not in named:
        text = f"{path}: {best}, of {firsts[best].encoding}"
        notes.append(Note(text, "taken for depth, which its name does not say", "leave it out if it is not"))
    return best


def _frame_of(message: Any) -> str | None:
    """Return the frame of an image; None without one."""
    return None if message is None else message.header.frame_id.lstrip("/")


def other_trees(trees: Iterable[str], colour: str) -> list[str]:
    """Return the topics of tf of other robots than that of colour, which is known by its namespace."""
    spaces = {topic: topic.rpartition("/")[0] for topic in trees}
    own = {"", *(space for space in spaces.values() if colour.startswith(f"{space}/"))}
    return [topic for topic, space in spaces.items() if len(own) > 1 and space not in own]


def is_raw(topic: str) -> bool:
    """Whether images are as the lens shows them."""
    return _RECTIFIED.search(topic) is None


def _rank(topic: str, words: tuple[str, ...]) -> int:
    """Return the place of the first of these words that a topic has; their number without one."""
    return next((at for at, word in enumerate(words) if word in topic.lower()), len(words))


def space_of(topic: str, infos: Collection[str] = ()) -> str:
    """Return the namespace of a camera: of `camera/color/image_raw/compressed` it is `camera/color`.

    Of `sim/rgb` it is `sim` where `sim/rgb` is not among the namespaces that have a CameraInfo (Isaac Sim).
    """
    parts = topic.split("/")
    for end in ("image", "info", "camera_info"):
        for at, part in enumerate(parts):
            if at and (part == end or part.startswith("image")):
                return "/".join(parts[:at])
    own = re.sub("/compressed(Depth)?$", "", topic)
    return own.rpartition("/")[0] if infos and own not in infos else own
