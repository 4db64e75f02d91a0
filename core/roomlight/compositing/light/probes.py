"""The light at the objects of a scene: tracked probes of a session, eased over time.

An object that rests has one probe at its centre; one longer than `BIG_M` has two along each long axis. An object that
moves has probes along its path, and the light between them is interpolated.
"""

from collections.abc import Callable
from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.compositing.light.lighting import LightSampler, ProbeSet
from roomlight.compositing.light.temporal import EasedLight
from roomlight.conventions import Position
from roomlight.engine.session import Session
from roomlight.errors import OptionError
from roomlight.frame import MAX_RADIANCE
from roomlight.light.checks import check_panorama
from roomlight.light.light import Light

BIG_M: Final = 0.5
"""Longest side of an object that one probe is enough for."""
PATH_STEP_M: Final = 0.3
MAX_PER_OBJECT: Final = 8
MAX_TOTAL: Final = 16
"""Most tracked probes of a scene: the session takes about 10 ms for each and frame. Later objects share them."""


LightAt = Callable[[Position], Float[np.ndarray, "h w 3"]]
"""Returns the panorama [h, 2h, 3] of the light that arrives at a world position."""
OneLight = Light | Float[np.ndarray, "h w 3"]
"""A `Light`, or its panorama [h, 2h, 3]."""
GivenLight = OneLight | Callable[[Position], OneLight]
"""Light from elsewhere: one for all places, or that at each place."""


def given_light(light: GivenLight | None) -> LightAt | None:
    """Return the light of the caller at each position; None for the session's.

    What a function returns is checked when it is called.

    Raises:
        OptionError: It is neither a `Light` nor a panorama nor a function that returns one of them.
        RoomLightError: It is a server's, and its panorama was not requested.
    """
    if light is None:
        return None
    if callable(light) and not isinstance(light, Light | type):
        return lambda position: _checked(light(position))
    panorama = _checked(light)
    return lambda _: panorama


def _checked(light: object) -> Float[np.ndarray, "h w 3"]:
    try:
        panorama = check_panorama(np.array(light.panorama if isinstance(light, Light) else light))
        if panorama.min() < 0 or panorama.max() > MAX_RADIANCE:
            extremes = f"{panorama.min():.4g} to {panorama.max():.4g}"
            raise ValueError(f"radiance is 0 to {MAX_RADIANCE:g}, got {extremes}")
    except (TypeError, ValueError) as error:
        raise OptionError(f"light must be a Light, a panorama or a function of the position: {error}") from error
    return panorama


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
            if min(np.linalg.norm(position - probe) for probe in chosen) >= step:
                chosen.append(position)
        if len(chosen) <= MAX_PER_OBJECT:
            return np.array(chosen)
        step *= 1.3


class ObjectProbes:
    """Tracked probes of all objects of a scene, with a session's light for both uses.

    Matte and glossy surfaces are lit by `Light.panorama`; mirrors show `Light.reflection`, which also casts shadows.

    Attributes:
        given: Whether the caller gave the light.
        lighting: What objects reflect.
        reflection: What casts their shadows; the same object as `lighting` where the caller gave the light.
    """

    def __init__(self, session: Session, light: LightAt | None = None) -> None:
        """Begin without probes; `light` replaces the session's, does not change over time and is used as it is."""
        self._session, self._light = session, light
        self.given = light is not None
        self._handles: list[int] = []
        self._positions: list[Position] = []
        self.lighting = EasedLights()
        self.reflection = self.lighting if self.given else EasedLights()
        self._joined: tuple[ProbeSet, ProbeSet, ProbeSet] | None = None
        self._frames = 0
        self._waiting_s = 0.0

    def add(self, positions: Float[np.ndarray, "n 3"], *, blend: bool = False) -> None:
        """Track probes at these positions, as far as `MAX_TOTAL` allows.

        Args:
            blend: the probes are those of one object at rest: its faces pass some closely, and shall not show where.
        """
        spread_m2 = 0.5 * float(positions.var(axis=0).sum()) if blend else 0.0  # 0 for a single probe
        if not self._handles:
            self._frames = self._session.frames
        for position in positions[: MAX_TOTAL - len(self._handles)]:
            x, y, z = position.tolist()
            handle = self._session.track((x, y, z))
            self._handles.append(handle)
            self._positions.append((x, y, z))
            if self._light is not None:
                self.lighting.add((x, y, z), self._light((x, y, z)), spread_m2)
            else:
                light = self._session.light(handle)
                self.lighting.add((x, y, z), light.panorama, spread_m2)
                self.reflection.add((x, y, z), light.reflection, spread_m2)

    def advance(self, elapsed_s: float, *, every_s: float = 0.0) -> None:
        """Follow the session's light for a time.

        Args:
            every_s: change the light at most this often: each change costs 12 ms a probe.
        """
        self._waiting_s += elapsed_s
        if self._waiting_s < every_s:
            return
        if self._session.frames != self._frames and self._light is None:
            for number, handle in enumerate(self._handles):
                light = self._session.light(handle)
                self.lighting.aim(number, light.panorama)
                self.reflection.aim(number, light.reflection)
            self._frames = self._session.frames
        self.lighting.advance(self._waiting_s)
        if self.reflection is not self.lighting:
            self.reflection.advance(self._waiting_s)
        self._waiting_s = 0.0

    def lights(self) -> ProbeSet:
        """Return the probes as the renderer takes them."""
        lighting, reflection = self.lighting.lights(), self.reflection.lights()
        if lighting is reflection:
            return lighting
        if self._joined is None or self._joined[0] is not lighting or self._joined[1] is not reflection:
            joined = ProbeSet(lighting.samplers, spread_m2=lighting.spread_m2, mirrored=reflection.samplers)
            self._joined = lighting, reflection, joined
        return self._joined[2]

    def observed_at(self, position: Position) -> Float[np.ndarray, "h w"]:
        """Return how far the session's frames have shown each direction from the nearest probe."""
        distances = np.linalg.norm(np.array(self._positions) - np.array(position), axis=1)
        return self._session.light(self._handles[int(distances.argmin())]).observed

    def close(self) -> None:
        """Stop tracking."""
        for handle in self._handles:
            self._session.untrack(handle)
        self._handles.clear()
        self._positions.clear()
        self.lighting.clear()
        self.reflection.clear()


class EasedLights:
    """Light at several positions, eased over time."""

    def __init__(self) -> None:
        """Begin without positions."""
        self._lights: list[EasedLight] = []
        self._spread_m2: list[float] = []
        self._set: ProbeSet | None = None
        self._at: dict[Position, LightSampler] = {}  # of the present set

    def add(self, position: Position, panorama: Float[np.ndarray, "h w 3"], spread_m2: float) -> None:
        """Add a position with its light and its `ProbeSet.spread_m2`."""
        self._lights.append(EasedLight(position, panorama))
        self._spread_m2.append(spread_m2)
        self._set = None

    def clear(self) -> None:
        """Forget all positions."""
        self._lights.clear()
        self._spread_m2.clear()
        self._set = None

    def aim(self, number: int, panorama: Float[np.ndarray, "h w 3"]) -> None:
        """Change the light toward which that of a position, by its number, moves."""
        self._lights[number].aim(panorama)

    def advance(self, elapsed_s: float) -> None:
        """Move all lights for a time."""
        changes = [light.advance(elapsed_s) for light in self._lights]
        if any(changes):
            self._set = None

    def lights(self) -> ProbeSet:
        """Return the lights at this moment."""
        if self._set is None or len(self._at) >= MAX_TOTAL:
            self._at.clear()
        if self._set is None:
            self._set = ProbeSet([light.sampler for light in self._lights], spread_m2=self._spread_m2)
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
