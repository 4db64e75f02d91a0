"""Snapshots as records of a file, and back.

The pixels of a kept frame can be stored elsewhere: `records_of_snapshot` leaves out the bases of the frames in
`elsewhere`, and `SavedSession.snapshot` takes them from `bases` (`roomlight.engine.state.kept_frames`).
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from roomlight import __version__
from roomlight.conventions import Position
from roomlight.engine.models.interface import Arrays
from roomlight.engine.options import SessionOptions
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.panorama.light_tracking import LightTracker
from roomlight.engine.state.kept_frames import (
    base_arrays,
    base_of,
    base_values,
    brightened,
    change_arrays,
    changed,
)
from roomlight.engine.state.records import Record, array_records, arrays_of, unpack_records
from roomlight.engine.state.snapshot import KeptFrame, LeftRoom, ProbeSnapshot, SessionSnapshot
from roomlight.engine.surface.drift import Drift
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.errors import RoomLightError, StateError

_ROLES = ("keyframe", "latest")
_SAME = ("options", "networks", "frames", "last_index", "next_handle", "pending", "present", "drift")
"""Values of a snapshot that are saved as they are."""
_PLANES = tuple(plane.name for plane in fields(PanoramaState))


class _Values(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class _Grid(_Values):
    volume_to_world: list[list[float]]
    depth_max_m: float
    shape: tuple[int, int, int]


class _Left(_Values):
    grid: _Grid
    frames: tuple[int, ...]


class _Probe(_Values):
    handle: int
    position: Position
    tracker: dict[str, Any]
    room: int
    forgotten: bool


class _Kept(_Values):
    index: int
    role: Literal["keyframe", "latest"]
    checksum: int
    base: dict[str, Any] | None
    """None: the base is elsewhere."""
    gain: tuple[float, float, float] | None
    """Of red, green and blue against the image as it was pushed."""
    contradicted: bool = False
    """By later frames; earlier states lack it."""


class _Session(_Values):
    version: str
    options: SessionOptions
    networks: dict[str, str]
    frames: int
    last_index: int
    next_handle: int
    grid: _Grid | None
    pending: dict[int, Position]
    probes: list[_Probe]
    kept: list[_Kept]
    left: list[_Left]
    present: tuple[int, ...]
    drift: Drift


@dataclass(frozen=True)
class SavedSession:
    """A saved session, read and checked; its kept frames are not made yet."""

    source: str
    values: _Session
    arrays: Arrays

    @property
    def options(self) -> SessionOptions:
        """Options of the saved session."""
        return self.values.options

    @property
    def elsewhere(self) -> tuple[int, ...]:
        """Indices of the kept frames whose bases are stored elsewhere."""
        return tuple(kept.index for kept in self.values.kept if kept.base is None)

    def snapshot(self, bases: Mapping[int, FrameMesh] | None = None) -> SessionSnapshot:
        """Return the snapshot.

        Args:
            bases: Bases of the frames in `elsewhere`, by index; they become part of the snapshot.

        Raises:
            StateError: A kept frame is missing or differs from the saved one, or the values do not fit each other.
        """
        try:
            return self._snapshot(bases or {})
        except StateError:
            raise
        except (KeyError, ValueError, TypeError, RoomLightError) as error:
            raise StateError(f"{self.source}: its values do not fit each other ({error!r})") from error

    def _snapshot(self, bases: Mapping[int, FrameMesh]) -> SessionSnapshot:
        values = self.values
        kept = {role: [self._kept(frame, bases) for frame in values.kept if frame.role == role] for role in _ROLES}
        left = [
            LeftRoom(_grid_of(room.grid), _under(f"left/{number}", self.arrays), room.frames)
            for number, room in enumerate(values.left)
        ]
        return SessionSnapshot(
            **{name: getattr(values, name) for name in _SAME},
            grid=None if values.grid is None else _grid_of(values.grid),
            volume=_under("volume", self.arrays),
            probes=tuple(self._probe(probe) for probe in values.probes),
            keyframes=tuple(kept["keyframe"]),
            latest=kept["latest"][0] if kept["latest"] else None,
            left=tuple(left),
        )

    def _kept(self, frame: _Kept, bases: Mapping[int, FrameMesh]) -> KeptFrame:
        arrays = _under(f"kept/{frame.index}", self.arrays)
        source = f"{self.source}: frame {frame.index}"
        if frame.base is None and frame.index not in bases:
            raise StateError(f"{source}: is missing")
        if frame.base is None:
            base = brightened(bases[frame.index], frame.gain)
        else:
            base = base_of(frame.base, arrays)
            base.gain = frame.gain
        mesh = changed(base, arrays, frame.checksum, source)
        mesh.contradicted = frame.contradicted
        return KeptFrame(frame.index, mesh, mesh.texture)

    def _probe(self, probe: _Probe) -> ProbeSnapshot:
        planes = _under(f"probe/{probe.handle}/panorama", self.arrays)
        memory = _under(f"probe/{probe.handle}/memory", self.arrays)
        planes.setdefault("measured", np.zeros_like(planes["observed"]))  # earlier states lack it
        panorama = PanoramaState(**{name: planes[name] for name in _PLANES})
        tracker = LightTracker.from_json(probe.tracker)
        return ProbeSnapshot(probe.handle, probe.position, panorama, memory, tracker, probe.room, probe.forgotten)


def records_of_snapshot(snapshot: SessionSnapshot, *, elsewhere: Collection[int] = ()) -> list[Record]:
    """Return the records of a snapshot; `elsewhere`: indices of kept frames whose bases are stored elsewhere."""
    arrays: Arrays = {f"volume/{name}": array for name, array in snapshot.volume.items()}
    for number, room in enumerate(snapshot.left):
        arrays |= {f"left/{number}/{name}": array for name, array in room.sglv.items()}
    for probe in snapshot.probes:
        arrays |= {f"probe/{probe.handle}/panorama/{name}": getattr(probe.panorama, name) for name in _PLANES}
        arrays |= {f"probe/{probe.handle}/memory/{name}": array for name, array in probe.memory.items()}
    for kept in snapshot.kept:
        parts = change_arrays(kept) | ({} if kept.index in elsewhere else base_arrays(kept))
        arrays |= {f"kept/{kept.index}/{name}": array for name, array in parts.items()}
    return [Record("SESS", _values_of(snapshot, elsewhere).model_dump(mode="json")), *array_records(arrays)]


def _values_of(snapshot: SessionSnapshot, elsewhere: Collection[int]) -> _Session:
    grid = snapshot.grid
    return _Session(
        version=__version__,
        **{name: getattr(snapshot, name) for name in _SAME},
        grid=None if grid is None else _values_of_grid(grid),
        probes=[
            _Probe(
                tracker=probe.tracker.to_json(),
                **{name: getattr(probe, name) for name in ("handle", "position", "room", "forgotten")},
            )
            for probe in snapshot.probes
        ],
        kept=[
            _Kept(
                index=frame.index,
                role="latest" if frame is snapshot.latest else "keyframe",
                checksum=frame.texture.checksum,
                base=None if frame.index in elsewhere else base_values(frame.mesh),
                gain=frame.mesh.gain,
                contradicted=frame.mesh.contradicted,
            )
            for frame in snapshot.kept
        ],
        left=[_Left(grid=_values_of_grid(room.grid), frames=room.frames) for room in snapshot.left],
    )


def _values_of_grid(grid: VolumeGrid) -> _Grid:
    return _Grid(volume_to_world=grid.volume_to_world.tolist(), depth_max_m=grid.depth_max_m, shape=grid.shape)


def _grid_of(values: _Grid) -> VolumeGrid:
    return VolumeGrid(np.array(values.volume_to_world, np.float64), values.depth_max_m, values.shape)


def session_of_records(records: Iterable[Record], source: str) -> SavedSession:
    """Return the saved session among the records of a file.

    Raises:
        StateError: There is none, or its values are invalid.
    """
    records = list(records)
    sessions = [record for record in records if record.tag == "SESS"]
    if len(sessions) != 1:
        raise StateError(f"{source}: holds {len(sessions)} saved sessions instead of one")
    try:
        values = _Session.model_validate(sessions[0].values)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise StateError(f"{source}: its values are invalid ({where}: {first['msg']})") from error
    return SavedSession(source, values, arrays_of(records, source))


def saved_session(file: bytes, source: str) -> SavedSession:
    """Return the saved session of a file's bytes; `source` names it in messages.

    Raises:
        StateError: The bytes are no saved session, or a damaged one, or one of another version.
    """
    return session_of_records(unpack_records(file, source), source)


def _under(prefix: str, arrays: Arrays) -> Arrays:
    return {name[len(prefix) + 1 :]: array for name, array in arrays.items() if name.startswith(f"{prefix}/")}
