"""Times of a capture's frames, checked: their unit is recognised, and gaps are capped.

Files state seconds; some tools write nanoseconds, and a single wrong stamp would stall whoever plays the recording for
years.
"""

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from roomlight.imaging.rates import usual_rate
from roomlight.notes import Note

MAX_GAP_S: Final = 5.0
"""A longer gap between frames is played as one of this length."""
_REGULAR: Final = 0.5
"""Interquartile range of the steps, relative to their median, up to which they are those of a camera."""
_EVEN: Final = 0.25
"""Most that a time of even steps differs from its place among them, relative to the step."""
_ROUNDED: Final = 5e-3
"""Most, as a share, by which rounding of the times is taken to have moved a rate."""
_UNITS: Final = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}
_TICK_S: Final = 1e-7
_TICKS: Final = (1e17, 1e18)
"""Ticks since the year 1 or 1601, as Windows counts them; microseconds or nanoseconds since 1970 are below or above."""
_EPOCH_S: Final = (1e9, 3e9)
"""Seconds since 1970, from 2001 to 2065. With steps above `MAX_GAP_S` they may be a smaller unit's since a device
was started."""
_CAMERA_STEP_S: Final = 1 / 30
_LEAST_STEP_S: Final = 1e-3
"""Of what records rooms; numbers of frames, taken for microseconds, are closer."""


@dataclass(frozen=True)
class Timeline:
    """The time of each record in seconds, None where none is known, and what was changed."""

    times_s: tuple[float | None, ...]
    notes: tuple[Note, ...] = ()

    @property
    def step_s(self) -> float | None:
        """The step between records; None without times that go on.

        Where steps are even, it is their mean, or that of a usual rate if times rounded as these may be of it; else it
        is their median.
        """
        known = [(index, time) for index, time in enumerate(self.times_s) if time is not None]
        if len(known) < 2:
            return None
        indices, times = np.array(known, np.float64).T
        count, step = int(indices[-1] - indices[0]), float(np.median(np.diff(times)))
        mean = float(times[-1] - times[0]) / count
        off = float(np.abs(times - times[0] - mean * (indices - indices[0])).max())
        if mean > 0 and off <= _EVEN * mean:
            step = 1 / usual_rate(1 / mean, within=min(2 * off / (count * mean), _ROUNDED))
        return step if step > 1e-6 else None


def nearest(times: Sequence[float], time_s: float) -> int:
    """Return the index of the time that is nearest, of increasing ones."""
    at = bisect.bisect_left(times, time_s)
    return min(range(max(0, at - 1), min(len(times), at + 1)), key=lambda index: abs(times[index] - time_s))


def timeline(stored: list[float | None], name: str, *, seconds: bool = False) -> Timeline:
    """Make the times of records in order from what the file states.

    Args:
        stored: A time of each record; None or not finite where there is none.
        name: The capture in messages.
        seconds: Whether their unit is known to be the second, as that of a video's is.

    Returns:
        Times in seconds that never go backwards and have no gap above `MAX_GAP_S`.
    """
    places = [index for index, time in enumerate(stored) if time is not None and math.isfinite(time)]
    values = np.array([stored[index] for index in places], np.float64)
    times: list[float | None] = [None] * len(stored)
    notes: list[Note] = []
    if wrong := sum(time is not None for time in stored) - len(places):
        text = f"{name}: {wrong} timestamps are no numbers"
        notes.append(Note(text, "these frames have no time", "store seconds"))
    if len(values) > 1:
        steps = np.diff(values)
        unit = 1.0 if seconds else _unit(values)
        if unit != 1:
            notes.append(_unit_note(name, float(np.median(steps)), unit))
        elif not seconds and len(steps) > 1 and np.median(steps) == 1 and (values % 1 == 0).all():
            text = f"{name}: timestamps are whole numbers, 1 apart as numbers of frames are"
            notes.append(Note(text, "they are taken for seconds: a frame a second", "store seconds"))
        values, steps = values * unit, steps * unit
        forward = steps[steps > 0]
        if forward.size and np.median(forward) < _LEAST_STEP_S:
            text = f"{name}: timestamps a median of {np.median(forward):.2g} s apart, which no camera is"
            return Timeline((None,) * len(stored), (*notes, Note(text, "frames have no time", "store seconds")))
        usual = min(float(np.median(forward)), MAX_GAP_S) if forward.size else 0.0
        long, back = steps > MAX_GAP_S, steps < 0
        if long.any() or back.any():
            wrong = np.flatnonzero(long | back)
            text = f"{name}: {len(wrong)} steps of time, the first of {steps[wrong[0]]:g} s before record"
            effect = f"longer steps are played as {MAX_GAP_S:g} s, backward ones as the usual step"
            notes.append(Note(f"{text} {places[wrong[0] + 1]}", effect, "correct the timestamps if the pace matters"))
            steps = np.where(back, usual, np.minimum(steps, MAX_GAP_S))
            values = values[0] + np.concatenate([[0.0], np.cumsum(steps)])
    for index, value in zip(places, values.tolist(), strict=True):
        times[index] = value
    return Timeline(tuple(times), tuple(notes))


def in_seconds(times: Sequence[float], name: str, notes: list[Note]) -> tuple[float, ...]:
    """Return increasing times in seconds, by the step between them, as `timeline`; another unit is noted."""
    values = np.array(times, np.float64)
    if (unit := _unit(values)) == 1:
        return tuple(times)
    notes.append(_unit_note(name, float(np.median(np.diff(values))), unit))
    return tuple(time * unit for time in times)


def _unit_note(name: str, step: float, unit: float) -> Note:
    text = f"{name}: timestamps a median of {step:g} apart"
    return Note(text, f"read as {_UNITS.get(unit, 'ticks of 100 nanoseconds')}", "store seconds if that is wrong")


def _unit(values: np.ndarray) -> float:
    """Return the seconds of one stored unit, by the size of times since 1970, else by the step that a camera has."""
    steps = np.diff(values)
    forward = steps[steps > 0]
    if forward.size == 0:
        return 1.0
    low, step, high = np.percentile(forward, [25, 50, 75])
    for unit in _UNITS:
        if _EPOCH_S[0] <= values[0] * unit < _EPOCH_S[1] and step * unit <= MAX_GAP_S:
            return unit
    regular = high - low <= _REGULAR * step
    if step <= 10 or (step <= 600 and not regular):
        return 1.0
    if _TICKS[0] <= values[0] < _TICKS[1]:
        return _TICK_S
    return min(_UNITS, key=lambda unit: abs(math.log(step * unit / _CAMERA_STEP_S)))
