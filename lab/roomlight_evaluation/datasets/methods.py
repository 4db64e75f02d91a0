"""Methods that light a room from a single image, as `evaluate_dataset` scores them: baselines and the engine.

Positions are world metres, y up. Panoramas are linear HDR radiance, float32 [120, 240, 3], world-aligned.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight.conventions import Position
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.engine.volume.sglv import render_panorama
from roomlight.frame import Frame
from roomlight_evaluation.baselines import MeanColour, WarpAndFill

HEIGHT: Final = 120
"""Rows of every panorama; columns are twice as many."""
BLENDED: Final = "full"
"""Name of the shipped networks: the volume (SGLV) blended with what the frame shows."""
UNBLENDED: Final = "SGLV alone"
"""Name of the same networks' volume before blending."""

Panorama = Float[np.ndarray, "h w 3"]


@runtime_checkable
class Method(Protocol):
    """One method, or several that share their computation."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its results in tables."""
        ...

    def light(self, frame: Frame, positions: Sequence[Position]) -> Mapping[str, Sequence[Panorama]]:
        """Estimate panoramas at the positions from this frame alone, for each name.

        Raises:
            FrameError: The frame cannot be used.
        """
        ...


@dataclass(frozen=True)
class BaselineMethod:
    """One of the two methods without learning: mean colour or warp-and-fill."""

    make: type[MeanColour] | type[WarpAndFill]

    @property
    def names(self) -> tuple[str, ...]:
        """The baseline's own name."""
        return (self.make.name,)

    def light(self, frame: Frame, positions: Sequence[Position]) -> Mapping[str, Sequence[Panorama]]:
        """Estimate panoramas at the positions from this frame alone."""
        baseline = self.make(HEIGHT)
        baseline.push(frame)
        return {baseline.name: [baseline.light_at(position) for position in positions]}


@dataclass(frozen=True)
class EngineMethod:
    """A session of the engine for each frame.

    Attributes:
        name: Name of its light in tables.
        options: Options of the session.
        graphs: What `choose_graphs(options)` returned; None is the classical model.
        unblended_name: Also give the volume's light before blending, under this name.
    """

    name: str
    options: SessionOptions
    graphs: LightingGraphs | None
    unblended_name: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The unblended volume's name, if it is given, then the method's."""
        return (self.name,) if self.unblended_name is None else (self.unblended_name, self.name)

    def light(self, frame: Frame, positions: Sequence[Position]) -> Mapping[str, Sequence[Panorama]]:
        """Estimate panoramas at the positions from this frame alone, in a new session."""
        session = Session(self.options, graphs=self.graphs)
        session.push(frame)
        lights = {self.name: [session.light_at(position).reflection for position in positions]}
        if self.unblended_name is not None:
            assert session.sglv is not None  # a session has its volume from the first frame on
            lights[self.unblended_name] = [
                render_panorama(session.sglv, position, height=HEIGHT)[0] for position in positions
            ]
        return lights
