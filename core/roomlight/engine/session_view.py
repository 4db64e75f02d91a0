"""A session after one frame: light at any point, from the keyframes and that frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from roomlight.conventions import Position
from roomlight.engine.lighting import LightingModel
from roomlight.engine.probe import Probe
from roomlight.engine.room import AnyRoom, room_at
from roomlight.engine.volume.sglv import check_position
from roomlight.light.light import Light


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
        lights: dict[int, Light] = {}
        for room, numbers in inside.items():
            probes = Probe.of_keyframes([places[n] for n in numbers], self.rooms[room], height=self.height)
            lights |= {n: probe.light(self.frame, self.load) for n, probe in zip(numbers, probes, strict=True)}
        return [lights[number] for number in range(len(positions))]
