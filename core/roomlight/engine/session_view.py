"""A session after one frame: light at any point, from the keyframes and that frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from roomlight.conventions import Position
from roomlight.engine.lighting import LightingModel
from roomlight.engine.probe import Probe
from roomlight.engine.room import AnyRoom, room_at
from roomlight.engine.volume.sglv import check_position
from roomlight.light.light import Light

_PIXELS_AT_ONCE: Final = 8 * 2 * 120**2
"""Pixels of panoramas that are made at once, about 150 bytes each."""


@dataclass(frozen=True)
class SessionView:
    """What a session knows of its room, for points that it does not track.

    Examples:
        >>> import roomlight as rl
        >>> session = rl.Session(rl.SessionOptions(height=32))
        >>> report = session.push(next(iter(rl.open_capture(rl.sample_capture()))))
        >>> session.view().light_at((0.0, 0.0, -0.5)).frame
        0

    Attributes:
        rooms: Those that are remembered, the present one last: of a session that goes on, or views of them.
        height: Rows of panoramas.
        frame: Index of the last frame.
        load: Returns the network that makes light of a panorama.
    """

    rooms: Sequence[AnyRoom]
    height: int
    frame: int
    load: Callable[[], LightingModel]

    def light_at(self, position: Position) -> Light:
        """Return the light at a position: world metres, y up.

        Raises:
            ProbeError: The position is not usable.
        """
        return self.lights_at([position])[0]

    def lights_at(self, positions: Sequence[Position]) -> list[Light]:
        """Return the light at several positions, equal to the bit to that of each alone; computed on all cores.

        Raises:
            ProbeError: A position is not usable.
        """
        places: list[Position] = []
        inside: dict[int, list[int]] = {}  # numbers of positions by that of their room
        for number, position in enumerate(positions):
            x, y, z = check_position(position).tolist()
            room = room_at((x, y, z), self.rooms)
            places.append((x, y, z))
            inside.setdefault(next(n for n, other in enumerate(self.rooms) if other is room), []).append(number)
        probes: dict[int, Probe] = {}
        at_once = max(1, _PIXELS_AT_ONCE // (2 * self.height**2))
        for room, numbers in inside.items():
            for start in range(0, len(numbers), at_once):
                some = numbers[start : start + at_once]
                made = Probe.of_keyframes([places[n] for n in some], self.rooms[room], height=self.height)
                probes |= zip(some, made, strict=True)
        return [probes[number].light(self.frame, self.load) for number in range(len(positions))]
