"""Lights of a tracked probe from frame to frame: identity, bounded turning, hysteresis, fading.

`find_lights` sees one panorama. Two lamps of almost equal strength would take turns as its main light, and a window
that comes into view would move it by a right angle between two frames. A tracker keeps the lights instead:

- A light found within `SAME_LIGHT_DEG` of a tracked one is the same light: it keeps its number, turns by half of the
  difference and at most `MAX_TURN_DEG` a frame, and changes its strength by half of the difference.
- A new light fades in by halves. One that is no longer found fades out by halves, and is dropped after `DROP_FRAMES`.
- The main light changes to another one that is `CHALLENGE_RATIO` times as strong for `CHALLENGE_FRAMES` frames in a
  row, or when it is dropped. Its direction then turns by at most `MAX_TURN_DEG` a frame. Meanwhile its intensity is
  reduced: it tends to nothing while the light is 45 degrees or more away.

During the first `SETTLE_FRAMES` frames everything follows the estimate at once. The constants are plain values:
at 33 probes in path-traced rooms the mean error of direction is 39.8 to 40.5 degrees for turning rates of 10 to 20
degrees, 2 to 5 frames and ratios of 1.2 to 1.5.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.light.main_light import MAX_LIGHTS, MainLight, TrackedLights, no_light

SAME_LIGHT_DEG: Final = 30.0
"""The outer radius of a light's lobe in `find_lights`: the same window is found within it."""
MAX_TURN_DEG: Final = 10.0
"""Per frame: half a turn takes 18 frames, 0.6 s at 30 frames a second."""
FOLLOW: Final = 0.5
"""Share of a change taken over at each frame, as for inferred radiance (`FILL_UPDATE` of the models)."""
DROP_FRAMES: Final = 6
"""A light that was not found for so many frames has 1.6 % of its strength."""
CHALLENGE_RATIO: Final = 1.3
CHALLENGE_FRAMES: Final = 3
SETTLE_FRAMES: Final = 5
_ALIGNED_DEG: Final = (10.0, 45.0)  # the turning main light has all of its intensity up to the first angle


@dataclass(frozen=True)
class _Track:
    light: MainLight
    missed: int = 0  # frames since it was last found


@dataclass
class LightTracker:
    """State of one probe's lights: `update` after every frame, then read `lights`."""

    lights: TrackedLights = field(default_factory=lambda: TrackedLights(no_light(), ()))
    frames: int = 0
    _tracks: dict[int, _Track] = field(default_factory=dict[int, _Track])  # by number
    _next_number: int = 0
    _main: int | None = None  # number of the main light
    _challenged_frames: int = 0

    def update(self, lights: tuple[MainLight, ...]) -> None:
        """Take the lights found after the next frame."""
        settled = self.frames >= SETTLE_FRAMES
        self._match(lights, FOLLOW if settled else 1.0, MAX_TURN_DEG if settled else 180.0)
        ordered = sorted((track.light for track in self._tracks.values()), key=lambda light: -light.weight)
        self._choose_main(ordered, settled=settled)
        self.lights = TrackedLights(self._turned_main(settled=settled), tuple(ordered[:MAX_LIGHTS]))
        self.frames += 1

    def to_json(self) -> dict[str, Any]:
        """Return the state as plain JSON values; float64 keeps its bits in JSON."""
        return {
            "frames": self.frames,
            "main_light": self.lights.main.to_json(),
            "sources": [light.to_json() for light in self.lights.sources],
            "tracks": [[number, track.missed, track.light.to_json()] for number, track in self._tracks.items()],
            "next_number": self._next_number,
            "main": self._main,
            "challenged_frames": self._challenged_frames,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "LightTracker":
        """Return a tracker in the state that `to_json` returned."""
        sources = tuple(MainLight.from_json(light) for light in values["sources"])
        return cls(
            lights=TrackedLights(MainLight.from_json(values["main_light"]), sources),
            frames=values["frames"],
            _tracks={number: _Track(MainLight.from_json(light), missed) for number, missed, light in values["tracks"]},
            _next_number=values["next_number"],
            _main=values["main"],
            _challenged_frames=values["challenged_frames"],
        )

    def _match(self, lights: tuple[MainLight, ...], follow: float, limit_deg: float) -> None:
        """Move each tracked light toward the one found near it; fade the others in and out."""
        before, self._tracks = self._tracks, {}
        matches = _closest_pairs({number: track.light for number, track in before.items()}, lights)
        for number, track in before.items():
            if number in matches:
                new = lights[matches[number]]
                angle_deg = min(follow * _angle_deg(track.light.direction, new.direction), limit_deg)
                direction = _turned(track.light.direction, new.direction, angle_deg)
                self._tracks[number] = _Track(replace(_mixed(track.light, new, follow), direction=direction))
            elif follow < 1 and track.missed + 1 < DROP_FRAMES:
                self._tracks[number] = _Track(_faded(track.light, 1 - follow), track.missed + 1)
        for index in sorted(set(range(len(lights))) - set(matches.values())):
            number, self._next_number = self._next_number, self._next_number + 1
            self._tracks[number] = _Track(replace(_faded(lights[index], follow), number=number))

    def _choose_main(self, ordered: list[MainLight], *, settled: bool) -> None:
        strongest = ordered[0].number if ordered else None
        current = self._tracks.get(self._main) if self._main is not None else None
        challenged = current is not None and ordered[0].weight > CHALLENGE_RATIO * current.light.weight
        self._challenged_frames = self._challenged_frames + 1 if challenged else 0
        if not settled or current is None or self._challenged_frames >= CHALLENGE_FRAMES:
            self._main, self._challenged_frames = strongest, 0

    def _turned_main(self, *, settled: bool) -> MainLight:
        last = self.lights.main
        if self._main is None:
            return _faded(last, 1 - FOLLOW)
        light = self._tracks[self._main].light
        if not settled:
            return light
        angle_deg = _angle_deg(last.direction, light.direction)
        direction = _turned(last.direction, light.direction, min(angle_deg, MAX_TURN_DEG))
        full_deg, none_deg = _ALIGNED_DEG
        left_deg = angle_deg - min(angle_deg, MAX_TURN_DEG)
        aligned = float(np.clip((none_deg - left_deg) / (none_deg - full_deg), 0, 1))
        return replace(_mixed(last, _faded(light, aligned), FOLLOW), direction=direction, number=light.number)


def _closest_pairs(tracked: dict[int, MainLight], lights: tuple[MainLight, ...]) -> dict[int, int]:
    """Return the index in `lights` of each tracked number that has a light near it, the closest pairs first."""
    angles = [
        (_angle_deg(light.direction, other.direction), number, index)
        for number, light in tracked.items()
        for index, other in enumerate(lights)
    ]
    pairs: dict[int, int] = {}
    for angle_deg, number, index in sorted(angles):
        if angle_deg < SAME_LIGHT_DEG and number not in pairs and index not in pairs.values():
            pairs[number] = index
    return pairs


def _mixed(last: MainLight, new: MainLight, share: float) -> MainLight:
    """Move every value but direction and number from `last` toward `new`."""
    return replace(
        last,
        intensity=last.intensity + share * (new.intensity - last.intensity),
        radius_deg=last.radius_deg + share * (new.radius_deg - last.radius_deg),
        shadow_strength=last.shadow_strength + share * (new.shadow_strength - last.shadow_strength),
        emitted=last.emitted + share * (new.emitted - last.emitted),
    )


def _faded(light: MainLight, share: float) -> MainLight:
    return replace(light, intensity=share * light.intensity, shadow_strength=share * light.shadow_strength)


def _angle_deg(first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"]) -> float:
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()  # np.cross takes 0.1 ms
    across = math.hypot(b * z - c * y, c * x - a * z, a * y - b * x)
    return math.degrees(math.atan2(across, a * x + b * y + c * z))


def _turned(start: Float[np.ndarray, "3"], stop: Float[np.ndarray, "3"], angle_deg: float) -> Float[np.ndarray, "3"]:
    """Turn `start` by an angle toward `stop`, along the great circle; over the zenith if they are opposite."""
    if angle_deg >= _angle_deg(start, stop):
        return stop
    for goal in (stop, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])):
        across = goal - (goal @ start) * start
        length = np.linalg.norm(across)
        if length > 1e-6:
            turned = np.cos(np.radians(angle_deg)) * start + np.sin(np.radians(angle_deg)) * across / length
            return turned / np.linalg.norm(turned)
    raise AssertionError("one of three axes is not along the start")
