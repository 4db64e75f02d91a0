"""Lights of a tracked probe from frame to frame: identity, bounded turning, hysteresis, fading.

`likely_lights` sees one panorama. Two lamps of almost equal strength would take turns as its main light, and a window
that comes into view would move it by a right angle between two frames. A tracker keeps the lights instead:

- A light found within `SAME_LIGHT_DEG` of a tracked one is the same light: it keeps its number, turns by half of the
  difference and at most `MAX_TURN_DEG` a frame, and changes its strength by half of the difference.
- A new light fades in by halves. One that is no longer found fades out by halves, and is dropped after `DROP_FRAMES`.
- The main light follows in the same way. It leaves for a place farther away after that was the likeliest for
  `CHALLENGE_FRAMES` frames in a row, and turns there by `MAX_TURN_DEG` a frame. Meanwhile its intensity is reduced: it
  tends to nothing while the place is 45 degrees or more away.

During the first `SETTLE_FRAMES` frames everything follows the estimate at once.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from roomlight.light.main_light import MAX_LIGHTS, NO_SOURCE, MainLight, TrackedLights, no_light

SAME_LIGHT_DEG: Final = 30.0
"""The outer radius of a light's lobe in `find_lights`: the same window is found within it."""
MAX_TURN_DEG: Final = 10.0
"""Per frame: half a turn takes 18 frames, 0.6 s at 30 frames a second."""
FOLLOW: Final = 0.5
"""Share of a change taken over at each frame, as for inferred radiance (`FILL_UPDATE` of the models)."""
DROP_FRAMES: Final = 6
"""A light that was not found for so many frames has 1.6 % of its strength."""
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
    _challenged_frames: int = 0

    def update(self, lights: TrackedLights) -> None:
        """Take the lights found after the next frame."""
        settled = self.frames >= SETTLE_FRAMES
        self._match(lights.sources, FOLLOW if settled else 1.0, MAX_TURN_DEG if settled else 180.0)
        ordered = sorted((track.light for track in self._tracks.values()), key=lambda light: -light.weight)
        main = self._numbered(self._followed_main(lights.main, settled=settled))
        self.lights = TrackedLights(main, tuple(ordered[:MAX_LIGHTS]))
        self.frames += 1

    def to_json(self) -> dict[str, Any]:
        """Return the state as plain JSON values; float64 keeps its bits in JSON."""
        return {
            "frames": self.frames,
            "main_light": self.lights.main.to_json(),
            "sources": [light.to_json() for light in self.lights.sources],
            "tracks": [[number, track.missed, track.light.to_json()] for number, track in self._tracks.items()],
            "next_number": self._next_number,
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

    def _followed_main(self, likely: MainLight, *, settled: bool) -> MainLight:
        last = self.lights.main
        if not settled:
            return likely
        apart_deg = _angle_deg(last.direction, likely.direction)
        self._challenged_frames = self._challenged_frames + 1 if apart_deg > SAME_LIGHT_DEG else 0
        if likely.intensity.max() <= 0:
            return _faded(last, 1 - FOLLOW)
        if 0 < self._challenged_frames < CHALLENGE_FRAMES:
            return last
        share = FOLLOW if apart_deg <= SAME_LIGHT_DEG else 1.0
        turn_deg = min(share * apart_deg, MAX_TURN_DEG)
        full_deg, none_deg = _ALIGNED_DEG
        aligned = float(np.clip((none_deg - (apart_deg - turn_deg)) / (none_deg - full_deg), 0, 1))
        direction = _turned(last.direction, likely.direction, turn_deg)
        return replace(_mixed(last, _faded(likely, aligned), FOLLOW), direction=direction)

    def _numbered(self, main: MainLight) -> MainLight:
        """Return the main light with the number of the tracked light that it is, or none."""
        near = [(_angle_deg(track.light.direction, main.direction), number) for number, track in self._tracks.items()]
        angle_deg, number = min(near, default=(180.0, NO_SOURCE))
        return replace(main, number=number if angle_deg < SAME_LIGHT_DEG else NO_SOURCE)


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
