"""Contact sheets of a dataset, to inspect its rooms by eye: a row per sequence.

A row shows frames over time in the phone's exposure, depth in colours (dark blue near to red far), the kind of surface
of each pixel (glass blue, mirror green, light yellow), and the probes twice: above in the frames' exposure, below so
under-exposed that the brightest source is just white. What is visible there is what lights the room.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8, UInt16

from roomlight.conventions import srgb8_to_linear
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import GLASS, LIGHT, MIRROR, Recording
from roomlight.images import write_png
from roomlight.imaging.drawing import HEADING, LABEL_ROWS, Canvas

ProgressCallback = Callable[[int, int], None]
"""Called with (rooms drawn, rooms in all)."""

TIMES: Final = 4
"""Frames shown of each sequence."""
ROWS_PER_SHEET: Final = 8
"""As many as a screen shows without shrinking."""

_MARGIN: Final = 16
_GAP: Final = 6
_TILE: Final = (200, 150)
_PROBES: Final = 3
_PROBE: Final = (2 * (_TILE[1] - _GAP) // 2, (_TILE[1] - _GAP) // 2)
_LEGEND: Final = (
    "Frames over time | depth: near blue, far red | surfaces: glass blue, mirror green, light yellow | "
    "probes: exposed as the frames above, under-exposed below"
)
_LEGEND_ROWS: Final = 32
_TINTS: Final = {GLASS: (0.05, 0.2, 0.8), MIRROR: (0.05, 0.6, 0.15), LIGHT: (1.0, 0.8, 0.1)}


def write_previews(dataset: Dataset, out: Path, *, rooms: int, progress: ProgressCallback | None = None) -> list[Path]:
    """Write sheets `preview-00.png`, ... of the first sequence of `rooms` rooms, spread evenly over the dataset.

    Returns:
        The sheets' paths.

    Raises:
        DatasetError: A sequence is damaged.
        OutputError: A sheet cannot be written.
    """
    per_room = dataset.manifest.settings.sequences_per_room
    firsts = [number for number, name in enumerate(dataset.names) if int(name.rpartition("-")[2]) % per_room == 0]
    count = min(rooms, len(firsts))
    chosen = [firsts[round(k)] for k in np.linspace(0, len(firsts) - 1, count).tolist()] if count else []
    written: list[Path] = []
    for start in range(0, len(chosen), ROWS_PER_SHEET):
        recordings: list[Recording] = []
        for number in chosen[start : start + ROWS_PER_SHEET]:
            recordings.append(dataset.read(number))
            if progress:
                progress(start + len(recordings), len(chosen))
        path = out / f"preview-{start // ROWS_PER_SHEET:02d}.png"
        write_png(path, compose_preview(recordings))
        written.append(path)
    return written


def compose_preview(recordings: Sequence[Recording]) -> UInt8[np.ndarray, "h w 3"]:
    """Return the sheet of some sequences as 8-bit sRGB."""
    row_height = LABEL_ROWS + _TILE[1] + 2 * _GAP
    times = min(TIMES, max((len(recording.colour) for recording in recordings), default=1))
    width = 2 * _MARGIN + (times + 2) * (_TILE[0] + _GAP) + _PROBES * (_PROBE[0] + _GAP) - _GAP
    canvas = Canvas(width, 2 * _MARGIN + _LEGEND_ROWS + len(recordings) * row_height)
    canvas.text((_MARGIN, _MARGIN), _LEGEND, width=width - 2 * _MARGIN)
    for number, recording in enumerate(recordings):
        top = _MARGIN + _LEGEND_ROWS + number * row_height
        _row(canvas, top, recording, width - 2 * _MARGIN, times)
    return canvas.image


def caption(recording: Recording, *, under_ev: float) -> str:
    """Return a row's caption; `under_ev` is the exposure of the lower probes in stops."""
    facts = recording.facts
    made: dict[str, Any] = facts.get("made", {})
    light: dict[str, Any] = facts.get("light", {})
    change = float(np.log2(recording.exposure.max() / recording.exposure.min()))
    parts = [recording.name, str(facts.get("room_type", "unknown room")).replace("_", " ")]
    if made:
        parts.append(f"seed {made['seed']} room {made['room']}" + (f" retry {made['attempt']}" * bool(made["attempt"])))
    if light.get("scenario"):
        parts.append(str(light["scenario"]).replace("_", " "))
    if "white_kcd_m2" in facts:
        parts.append(f"white {1000 * float(facts['white_kcd_m2']):.3g} cd/m2")
    parts.append(f"exposure within {change:.1f} stops")
    parts.append(f"depth to {_far_m(recording.depth_mm[0]):.1f} m")
    parts.append(f"lower probes {under_ev:+.1f} EV")
    return ", ".join(parts)


def _row(canvas: Canvas, top: int, recording: Recording, width: int, times: int) -> None:
    brightest = float(recording.probe_panoramas.max(initial=1.0))
    under_ev = -max(1.0, float(np.log2(brightest)))
    canvas.text((_MARGIN, top), caption(recording, under_ev=under_ev), grey=HEADING, width=width)
    left, row = _MARGIN, top + LABEL_ROWS
    frames = dict.fromkeys(np.rint(np.linspace(0, len(recording.colour) - 1, times)).astype(int).tolist())
    pictures = [srgb8_to_linear(recording.colour[k]) for k in frames]
    left += (times - len(pictures)) * (_TILE[0] + _GAP)
    pictures += [depth_colours(recording.depth_mm[0]), _surface_colours(recording)]
    for picture in pictures:
        canvas.picture((left, row), picture, size=_TILE)
        left += _TILE[0] + _GAP
    for panorama in recording.probe_panoramas[:_PROBES]:
        canvas.picture((left, row), panorama, size=_PROBE)
        under = (panorama * np.float32(2.0**under_ev)).astype(np.float32)
        peaks = cv2.dilate(under, np.ones((3, 3), np.uint8))  # a bulb of one pixel must survive the shrinking
        canvas.picture((left, row + _PROBE[1] + _GAP), peaks, size=_PROBE)
        left += _PROBE[0] + _GAP


def depth_colours(depth_mm: UInt16[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return depth, from 0 to its 98th percentile, as linear RGB; unknown depth is black."""
    share = np.clip(depth_mm / (1000 * _far_m(depth_mm)), 0, 1)
    colours = cv2.applyColorMap(np.rint(255 * share).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return srgb8_to_linear(np.where(depth_mm[..., None] > 0, colours, 0).astype(np.uint8))


def _far_m(depth_mm: UInt16[np.ndarray, "h w"]) -> float:
    known = depth_mm[depth_mm > 0]
    return float(np.percentile(known, 98)) / 1000 if known.size else 1.0


def _surface_colours(recording: Recording) -> Float[np.ndarray, "h w 3"]:
    """Return the first frame dimmed and grey, with glass, mirrors and lights tinted; linear RGB."""
    grey = 0.3 * srgb8_to_linear(recording.colour[0]).mean(axis=-1, keepdims=True)
    image = np.repeat(grey, 3, axis=-1).astype(np.float32)
    for kind, tint in _TINTS.items():
        image[recording.surface[0] == kind] = tint
    return image
