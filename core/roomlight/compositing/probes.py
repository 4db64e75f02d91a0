"""The light at the objects of a scene: tracked probes of a session, eased over time.

An object that rests has one probe at its centre; one longer than `BIG_M` has two along each long axis. An object that
moves has probes along its path, and the light between them is interpolated.
"""

from collections.abc import Callable
from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.compositing.lighting import LightSampler, ProbeSet
from roomlight.compositing.missing_light import with_missing_light
from roomlight.compositing.temporal import EasedLight
from roomlight.conventions import Position
from roomlight.engine.session import Session

BIG_M: Final = 0.5
"""Longest side of an object that one probe is enough for."""
PATH_STEP_M: Final = 0.3
MAX_PER_OBJECT: Final = 8
MAX_TOTAL: Final = 16
"""Most tracked probes of a scene: the session takes about 10 ms for each and frame. Later objects share them."""


LightAt = Callable[[Position], Float[np.ndarray, "h w 3"]]
"""Returns the panorama [h, 2h, 3] of the light that arrives at a world position."""


def box_probes(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], matrix: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "n 3"]:
    """Return the probe positions of an object whose bounding box is transformed by `matrix` to the world."""
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    centre, size = (low + high) / 2, high - low
    sides = [(-0.25, 0.25) if length > BIG_M else (0.0,) for length in size * scale]
    points = np.array([centre + np.array(offset) * size for offset in product(*sides)])
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def path_probes(positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 3"]:
    """Return the positions at which a path is probed: every `PATH_STEP_M`, wider on paths that need too many."""
    step = PATH_STEP_M
    while True:
        chosen = [positions[0]]
        for position in positions[1:]:
            if min(np.linalg.norm(position - held) for held in chosen) >= step:
                chosen.append(position)
        if len(chosen) <= MAX_PER_OBJECT:
            return np.array(chosen)
        step *= 1.3


class SceneProbes:
    """Tracked probes of all objects of a scene."""

    def __init__(self, session: Session, light: LightAt | None = None) -> None:
        """Begin without probes; `light` replaces the session's, does not change over time and is used as it is."""
        self._session, self._light = session, light
        self._lights: dict[int, EasedLight] = {}  # by the session's handle
        self._set: ProbeSet | None = None
        self._at: dict[Position, LightSampler] = {}  # of the present set
        self._frames = 0
        self._waiting_s = 0.0

    def __len__(self) -> int:
        return len(self._lights)

    def add(self, positions: Float[np.ndarray, "n 3"]) -> None:
        """Track probes at these positions, as far as `MAX_TOTAL` allows."""
        for position in positions[: MAX_TOTAL - len(self._lights)]:
            x, y, z = position.tolist()
            handle = self._session.track((x, y, z))
            self._lights[handle] = EasedLight((x, y, z), self._panorama(handle, (x, y, z)))
        self._set = None
        self._frames = self._session.frames

    def advance(self, elapsed_s: float, *, every_s: float = 0.0) -> bool:
        """Follow the session's light for a time; return whether any changed.

        every_s:  change the light at most this often: each change costs 12 ms a probe.
        """
        if self._session.frames != self._frames and self._light is None:
            for handle, light in self._lights.items():
                light.aim(self._panorama(handle, light.position))
            self._frames = self._session.frames
        self._waiting_s += elapsed_s
        if self._waiting_s < every_s:
            return False
        changed = [light.advance(self._waiting_s) for light in self._lights.values()]
        self._waiting_s = 0.0
        if any(changed):
            self._set = None
        return any(changed)

    def lights(self) -> ProbeSet:
        """Return the probes as the renderer takes them."""
        if self._set is None or len(self._at) >= MAX_TOTAL:
            self._at.clear()
        if self._set is None:
            self._set = ProbeSet([light.sampler for light in self._lights.values()])
        return self._set

    def at(self, position: Position) -> LightSampler:
        """Return the light at a position, mixed from the probes around it."""
        probes = self.lights()
        if len(probes.samplers) == 1:
            return probes.samplers[0]
        shares = probes.weights(position)
        if shares.max() > 0.98:
            return probes.samplers[int(shares.argmax())]
        if position not in self._at:
            self._at[position] = probes.mixed(position)
        return self._at[position]

    def _panorama(self, handle: int, position: Position) -> Float[np.ndarray, "h w 3"]:
        if self._light is not None:
            return self._light(position)
        light = self._session.light(handle)
        return with_missing_light(light.panorama, light.observed)

    def close(self) -> None:
        """Stop tracking."""
        for handle in self._lights:
            self._session.untrack(handle)
        self._lights.clear()
        self._set = None
