"""What can be scored on a capture: a session of the engine, a baseline, or panoramas read from files.

Positions are world metres, y up. Panoramas are linear HDR radiance, float32 [h, 2h, 3], world-aligned.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import CaptureError, ImageError
from roomlight.frame import Frame
from roomlight.images import read_bytes, read_panorama
from roomlight.imaging.exr import read_exr


@runtime_checkable
class Estimator(Protocol):
    """A method that takes frames one by one and estimates the light at a point, as the two of `baselines` do."""

    @property
    def name(self) -> str:
        """The method's name in tables."""
        ...

    def push(self, frame: Frame) -> None:
        """Take the next frame."""
        ...

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"] | None:
        """Estimate the panorama [h, 2h, 3] at a point after the frames so far; None: it has no estimate yet."""
        ...


class EngineEstimator:
    """A session of the engine as an estimator."""

    def __init__(self, options: SessionOptions, graphs: LightingGraphs | None) -> None:
        """Open a session with what `choose_graphs(options)` returned."""
        self._session = Session(options, graphs=graphs)
        self._handles: dict[Position, int] = {}
        self._late_handles: dict[Position, int] = {}
        self.name: str = self._session.model

    def push(self, frame: Frame) -> None:
        """Take the next frame."""
        self._session.push(frame)

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """Return the panorama [h, 2h, 3] at a point after the frames so far, tracked from the first call on."""
        return self._tracked(position, self._handles)

    def late_light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """Return the panorama [h, 2h, 3] of another probe at the point, tracked from the first call of this method."""
        return self._tracked(position, self._late_handles)

    def _tracked(self, position: Position, handles: dict[Position, int]) -> Float[np.ndarray, "h w 3"]:
        if position not in handles:
            handles[position] = self._session.track(position)
        return self._session.light(handles[position]).reflection


def beside_classical(options: SessionOptions) -> list[tuple[SessionOptions, LightingGraphs | None]]:
    """Return the classical model, and the model of these options unless it is that, each with its networks.

    Raises:
        ModelError: The weights are missing, damaged or untrained.
    """
    graphs = choose_graphs(options)
    classical = replace(options, model="classical", weights=None)
    return [(options, None)] if graphs is None else [(classical, None), (options, graphs)]


class PredictionFolder:
    """Panoramas in files, one per probe and frame: `probe-00/light.000000.exr` or `.hdr`, numbered by `Frame.index`.

    `roomlight replay --probes-from-capture --use reflection` writes such a folder; any other program may write one to
    be scored: RGB [h, 2h, 3] of any height, in the mapping of `roomlight.conventions`, linear, 1 being the white of the
    capture's pictures as `Frame.image` has them.
    """

    name = "predictions"

    def __init__(self, folder: Path, probes: Sequence[Position]) -> None:
        """Use `folder`, which holds `probe-00`, `probe-01`, ... in the order of `probes`.

        Raises:
            CaptureError: Two probes are at one position.
        """
        for number, position in enumerate(probes):
            if position in probes[:number]:
                raise CaptureError(
                    f"probes {probes.index(position)} and {number} are both at {position}: a prediction is found by "
                    "its position; remove one of them from the capture"
                )
        self._folders = {position: folder / f"probe-{number:02d}" for number, position in enumerate(probes)}
        self._paths: dict[Position, Path] = {}

    def push(self, frame: Frame) -> None:
        """Select the files of this frame.

        Raises:
            CaptureError: A probe has no file for this frame; the message names the first one.
        """
        name = f"light.{frame.index:06d}"
        for position, folder in self._folders.items():
            there = {path.suffix: path for path in sorted(folder.glob(f"{name}.*"))}
            path = there.get(".exr", there.get(".hdr"))
            if path is None or not path.is_file():
                remedy = (
                    f"there is {folder / name}{next(iter(there))}, but predictions are EXR or HDR"
                    if there
                    else "every frame of the capture needs one for each probe (use the `every` and `max_frames` that "
                    "they were made with)"
                )
                raise CaptureError(f"{folder / name}.exr: this prediction is missing; {remedy}")
            self._paths[position] = path

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """Read the panorama [h, 2h, 3] of the current frame.

        Raises:
            ImageError: The file does not decode, is no panorama, or has pixels that are not finite or negative.
        """
        path = self._paths[position]
        panorama = read_panorama(path)  # which takes what is not finite as dark
        if path.suffix == ".hdr":  # which holds neither
            return panorama
        stored = read_exr(read_bytes(path), str(path)).stored_colour()  # another colour space may lead below 0
        unusable = ~(np.isfinite(stored) & (stored >= 0)).all(axis=-1)
        if unusable.any():
            raise ImageError(
                f"{path}: {unusable.sum()} pixels are not finite or negative; a prediction needs radiance for each"
            )
        return panorama
