"""Sequences of a room, given its index: choose a panorama, project it onto a shell, render several walks.

World frame: y up, metres; poses camera-to-world, OpenGL axes; radiance in kcd/m2.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.conventions import LUMINANCE
from roomlight.dataset.recording import Recording
from roomlight_generator.panoramas.furniture import furnish_shell
from roomlight_generator.panoramas.library import building, load_panorama, split_files
from roomlight_generator.panoramas.room import PanoramaRoom, classify_surfaces, describe, percentile
from roomlight_generator.panoramas.shell import draw_shell
from roomlight_generator.room_request import RoomRequest
from roomlight_generator.rooms.build import room_generator
from roomlight_generator.rooms.scene import attributions
from roomlight_generator.sequences.exposure import Exposure, MeterSettings, settle
from roomlight_generator.sequences.render import catalogue_for, find_camera_path, record
from roomlight_generator.sequences.walk import FRAME_INTERVAL_S

MEDIAN_KCD_M2: Final = (0.01, 0.2)
"""Range of a room's median luminance: a home in the evening, an office by day. It decides the sensor's noise."""
_AIM: Final = (0.3, 0.6)
"""Range of the first frame's 80th percentile, of white: 0.41 to 0.45 in the mean of real recordings."""
_TINT: Final = 0.06
"""Deviation of the logarithm of the white balance's gains, in half of the sequences: panoramas are neutral already."""
_WALKS: Final = 6
"""Walks drawn, until one has places for its probes."""
_FURNITURE: Final = 1 << 20
"""Purpose of the random numbers that decide whether a room has furniture."""


def render_room(request: RoomRequest) -> Iterator[Recording]:
    """Yield sequences of a room.

    Raises:
        DatasetError: if the folder of panoramas cannot be read or has none for this split.
        ValueError: if no walk through the room is found; the generator then takes another room.
    """
    room, facts = lit_room(request)
    free = room.free_space()
    for walk in range(request.count):
        rng = room_generator(request.index, seed=request.seed, split=request.split, purpose=1 + walk)
        name = f"panorama-{request.index}-{walk}"
        path = find_camera_path(free, room, rng, name=name, walks=_WALKS, frames=request.frames)
        yield record(room, path, rng, name=name, facts=facts, expose=expose)


def lit_room(request: RoomRequest) -> tuple[PanoramaRoom, dict[str, Any]]:
    """Choose a room's panorama, project it onto a shell and furnish it; returns the room and its facts.

    Raises:
        DatasetError: if the folder of panoramas cannot be read or has none for this split.
    """
    assert request.panoramas is not None
    index, seed, split = request.index, request.seed, request.split
    path = _choose(split_files(request.panoramas, split), index, seed)
    rng = room_generator(index, seed=seed, split=split)
    image, facts = _varied(load_panorama(path), rng)
    kinds = classify_surfaces(image, rng)
    facts |= {"panorama": path.name, "building": building(path), **describe(kinds)}
    shell = draw_shell(rng)
    pieces = None
    if room_generator(index, seed=seed, split=split, purpose=_FURNITURE).random() < request.furniture_share:
        pieces = furnish_shell(shell, catalogue_for(request.furniture), rng, split=split)
    room = PanoramaRoom(shell, image, kinds, pieces)
    facts |= shell.facts
    return room, {
        "room_type": "panorama",
        "light": {"scenario": "panorama", "sources": [], **facts},
        "panorama": path.name,
        "furniture": {} if pieces is None else pieces.roles,
        "attributions": [] if pieces is None else attributions(pieces.items),
    }


def _choose(files: list[Path], room_index: int, seed: int) -> Path:
    """Return a room's panorama: each is used once before any is used again, in an order of the seed."""
    turn, place = divmod(room_index, len(files))
    return files[int(np.random.default_rng([seed, turn]).permutation(len(files))[place])]


def _varied(
    image: Float32[np.ndarray, "h w 3"], rng: np.random.Generator
) -> tuple[Float32[np.ndarray, "h w 3"], dict[str, Any]]:
    """Mirror and rotate a panorama at random, and give it a luminance (kcd/m2)."""
    mirrored = bool(rng.random() < 0.5)
    columns = int(rng.integers(image.shape[1]))
    median = float(np.exp(rng.uniform(*np.log(MEDIAN_KCD_M2))))
    scale = median / max(percentile(image @ LUMINANCE, 50.0), 1e-3 * float(image.mean()))
    turned = np.roll(image[:, ::-1] if mirrored else image, columns, axis=1) * np.float32(scale)
    facts = {
        "mirrored": mirrored,
        "rotation_degrees": round(360 * columns / image.shape[1], 2),
        "median_kcd_m2": round(median, 5),
    }
    return np.ascontiguousarray(turned), facts


def expose(
    radiance: Float[np.ndarray, "f h w 3"], rng: np.random.Generator, *, interval_s: float = FRAME_INTERVAL_S
) -> Exposure:
    """Draw a phone's exposure of a sequence: the first frame's 80th percentile is 0.3 to 0.6 of white."""
    settings = replace(MeterSettings.draw(rng), first_error=0.0)
    aim = rng.uniform(*_AIM)
    gains = np.exp(rng.normal(0, _TINT, 3)) if rng.random() < 0.5 else np.ones(3)
    gains /= gains @ LUMINANCE
    bright = np.percentile(radiance @ (gains * LUMINANCE), 80, axis=(1, 2))
    return Exposure(2.0 ** settle(np.log2(aim / np.maximum(bright, 1e-6)), settings, interval_s), gains)
