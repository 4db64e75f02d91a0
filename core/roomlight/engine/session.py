"""The session: a stream of frames in, light at any point out.

    session = Session(SessionOptions(model="classical"))
    for frame in open_capture(path):
        session.push(frame)
    light = session.light_at((0.2, -0.1, -1.5))

Positions are world metres, y up. Light is relative linear RGB (`roomlight.conventions`). A session is not thread-safe:
its owner serialises the calls.
"""

import operator
import time
from base64 import b64encode
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, NoReturn

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.conventions import NO_FRAME, Position
from roomlight.engine.lighting import shipped_lighting
from roomlight.engine.models.choosing import lighting_model
from roomlight.engine.networks.clipping import shipped_clipping
from roomlight.engine.networks.graphs import LightingGraphs, part_files, part_folder
from roomlight.engine.options import SessionOptions
from roomlight.engine.panorama.blend import AT_PROBE, PanoramaState, accumulate, unseen_depth_m
from roomlight.engine.preparation import at_working_size, restored
from roomlight.engine.probe import Probe
from roomlight.engine.room import BACK_MARGIN, MOST_LEFT, AnyRoom, Room, RoomView, room_at
from roomlight.engine.session_view import SessionView
from roomlight.engine.state.snapshot import KeptFrame, SessionSnapshot
from roomlight.engine.surface.drift import NO_GAIN, Drift, Gain
from roomlight.engine.surface.mesh import FrameMesh, forget_seen_through
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import Sglv, check_position
from roomlight.errors import FrameError, ProbeError, StateError
from roomlight.files import write_durable
from roomlight.frame import Frame
from roomlight.light.light import Light
from roomlight.rules import check_type
from roomlight.threads import parallel_for

MOST_GAINS: Final = 10_000
"""Frames whose gains are remembered, unless `Session.most_gains` says otherwise: five minutes, 3 MB."""
_WARM_HEIGHT: Final = 16
_WARM_POSITION: Final = (0.0, 0.0, -0.5)


@dataclass(frozen=True)
class FrameReport:
    """Report of one frame.

    Attributes:
        index: of the frame.
        stage_ms: milliseconds by processing stage: prepare, volume, sglv, mesh, keyframes, render, partial, blend,
            lights (main light of each tracked probe). Those of probes are sums over probes, also of such that were
            computed at the same time.
        keyframe: whether it was kept as a keyframe.
        coverage: of each tracked probe, in the order of `Session.handles`.
        gain: factors of red, green and blue by which its radiance becomes that of the session's light; 1 unless
            exposure or white balance drift.
    """

    index: int
    stage_ms: dict[str, float]
    keyframe: bool
    coverage: tuple[float, ...]
    gain: Gain = NO_GAIN


@dataclass
class _Clock:
    stage_ms: dict[str, float] = field(default_factory=dict[str, float])

    @contextmanager
    def stage(self, name: str):
        began = time.perf_counter()
        yield
        self.add(_Clock({name: (time.perf_counter() - began) * 1e3}))

    def add(self, other: "_Clock") -> None:
        for name, ms in other.stage_ms.items():
            self.stage_ms[name] = self.stage_ms.get(name, 0.0) + ms


class Session:
    """The state of one stream: the room since its first frame, rooms that were left, and the tracked probes.

    Examples:
        >>> import roomlight as rl
        >>> session = rl.Session(rl.SessionOptions(height=32))
        >>> report = session.push(next(iter(rl.open_capture(rl.sample_capture()))))
        >>> session.light_at((0.0, 0.0, -0.5)).panorama.shape
        (32, 64, 3)
    """

    def __init__(self, options: SessionOptions | None = None, *, graphs: LightingGraphs | None = None) -> None:
        """Begin without frames.

        Args:
            options: Default: `SessionOptions()`.
            graphs: Loaded graphs, shared with other sessions; default: those that the options select
                (`roomlight.engine.models.choosing.choose_graphs`).

        Raises:
            OptionError: The options contradict each other.
            ModelError: The weights cannot be used.
        """
        self.options = options or SessionOptions()
        check_type(self.options, SessionOptions, "options")
        self._model = lighting_model(self.options, graphs)
        clipping, objects = (part_folder(self.options.parts, name) for name in ("clipping", "objects"))
        self._clipping = shipped_clipping(self.options.provider, clipping, part_files(clipping))
        self._lighting = partial(shipped_lighting, self.options.provider, objects, part_files(objects))
        self._room: Room | None = None  # from the first frame on
        self._left: tuple[RoomView, ...] = ()  # rooms that the camera was in before
        self._drift = Drift()
        self._gains: dict[int, Gain] = {}  # of the last frames, by index
        self.most_gains = MOST_GAINS
        self._probes: dict[int, Probe] = {}  # by handle
        self._pending: dict[int, Position] = {}  # tracked before the first frame, by handle
        self._next_handle = 0
        self.frames = 0
        self._last_index = NO_FRAME
        self._last_number = NO_FRAME  # of the last frame, among those that are kept

    @property
    def model(self) -> str:
        """The model in use: classical, single or video."""
        return self._model.name

    @property
    def networks(self) -> dict[str, str]:
        """The model in use, and the identity of the weights of its networks and of the one for clipped pixels."""
        return {"model": self.model, "weights": self._model.digest, "clipping": self._clipping.digest}

    @property
    def grid(self) -> VolumeGrid | None:
        """Pose and size of the lighting volume; None before the first frame. It follows the camera to other rooms."""
        return None if self._room is None else self._room.grid

    @property
    def sglv(self) -> Sglv | None:
        """The lighting volume after the last frame; None before the first. The next frame overwrites it."""
        return None if self._room is None else self._room.sglv

    @property
    def keyframes(self) -> int:
        """Number of keyframes of the room that the camera is in."""
        return 0 if self._room is None else len(self._room.keyframes)

    @property
    def rooms_left(self) -> int:
        """Number of rooms that are remembered after the camera left them."""
        return len(self._left)

    @property
    def meshes(self) -> list[tuple[int, FrameMesh]]:
        """Number and mesh of every keyframe in order of time, then of the last frame if it is no keyframe.

        They are of the room that the camera is in. A number is the frame's index; where indices begin again, as in a
        second recording, the number of the frame before and 1.
        """
        return [] if self._room is None else [(index, mesh.passing()) for index, mesh in self._room.meshes]

    @property
    def handles(self) -> tuple[int, ...]:
        """Handles of the tracked positions, in the order of `lights` and of a report's coverage."""
        return (*self._probes, *self._pending)

    def __reduce__(self) -> NoReturn:
        """Refuse: networks cannot be copied."""
        raise TypeError("a session cannot be pickled or copied; use session.save(path) and Session.load(path)")

    def _repr_html_(self) -> str:
        """Return counts, and the light at the tracked positions, for a notebook."""
        rows = ""
        for light in map(self.light, self._probes):
            place, data = ", ".join(f"{value:.2f}" for value in light.position), b64encode(light.file("png"))
            rows += f"<tr><td>({place}) m</td><td>{light.coverage:.0%} seen</td>"
            rows += f'<td><img src="data:image/png;base64,{data.decode()}"></td></tr>'
        return f"<table><caption>{self.model}: {self.frames} frames, {self.keyframes} kept</caption>{rows}</table>"

    def track(self, position: Position) -> int:
        """Track a position: every later frame is blended into its panorama.

        The panorama begins with what the keyframes and the last frame show, as in `light_at`.

        Args:
            position: World metres, y up.

        Returns:
            Its handle: 0, 1, 2, ...

        Raises:
            ProbeError: The position is not usable.
        """
        x, y, z = check_position(position).tolist()
        handle = self._next_handle
        if self._room is None:  # the first frame fixes the volume's size, and with it the probe's state
            self._pending[handle] = (x, y, z)
        else:
            room = room_at((x, y, z), self._rooms)
            (self._probes[handle],) = Probe.of_keyframes([(x, y, z)], room, height=self.options.height)
            self._probes[handle].update_lights()
        self._next_handle += 1
        return handle

    def untrack(self, handle: int) -> None:
        """Stop tracking a position; its handle is not used again.

        Raises:
            ProbeError: No tracked probe has this handle.
        """
        handle = _whole(handle)
        if self._probes.pop(handle, None) is None and self._pending.pop(handle, None) is None:
            raise ProbeError(f"no tracked probe has the handle {handle}")

    def push(self, frame: Frame) -> FrameReport:
        """Process the next frame.

        Raises:
            FrameError: The frame cannot be used; the session is unchanged.
        """
        check_type(frame, Frame, "frame", FrameError)
        options, clock = self.options, _Clock()
        with clock.stage("prepare"):
            measured, depth_m = at_working_size(frame, options.unknown_depth)
            earlier = [] if self._room is None else [mesh for _, mesh in self._room.meshes]
            drift = self._drift.after(measured, depth_m, earlier)
            prepared = restored(drift.corrected(measured), depth_m, earlier, clipping=self._clipping)
            room = self._room_of(prepared)
        with clock.stage("volume"):
            # after completion ("rim") only pixels that the frame's mask leaves out are without depth
            far = options.unknown_depth == "far" or (options.unknown_depth == "rim" and prepared.seen is None)
            is_blind = prepared.seen is not None and not prepared.seen.any()  # black, or all of it is masked
            clipping = None if is_blind else room.write_volume(prepared, far_unknown=far)
        with clock.stage("sglv"):
            if not is_blind:
                room.volume.update(clipping)
        with clock.stage("mesh"):
            mesh = FrameMesh(prepared, sensor_depth_m=measured.depth_m, sensor_clipped=measured.clipped)
            mesh.gain = drift.gain
        number = max(frame.index, self._last_number + 1)  # a second recording may begin at 0 again
        with clock.stage("keyframes"):
            is_keyframe = room.keep(number, mesh, turn=self.frames)
        fresh = {at: Probe.fresh(position, room, height=options.height) for at, position in self._pending.items()}
        self._probes |= fresh
        self._pending.clear()
        self._push_to_probes(list((fresh if is_blind else self._probes).values()), mesh, clock)
        mesh.forget()
        self._last_index, self._last_number, self._drift = frame.index, number, drift
        self.frames += 1
        self._remember_gain()
        coverage = tuple(probe.panorama.coverage() for probe in self._probes.values())
        return FrameReport(frame.index, clock.stage_ms, is_keyframe, coverage, drift.gain or NO_GAIN)

    def _remember_gain(self) -> None:
        self._gains.pop(self._last_index, None)
        self._gains[self._last_index] = self._drift.gain or NO_GAIN
        if len(self._gains) > self.most_gains:
            del self._gains[next(iter(self._gains))]

    def gain_of(self, index: int) -> Gain:
        """Return `FrameReport.gain` of the frame of this index; of one that is not known, that of the nearest.

        Known are the last frames and the keyframes.
        """
        if index in self._gains:
            return self._gains[index]
        kept = {number: mesh.gain or NO_GAIN for room in self._rooms for number, mesh in room.meshes}
        known = kept | self._gains
        return known[min(known, key=lambda number: abs(number - index))] if known else NO_GAIN

    def _room_of(self, frame: Frame) -> Room:
        """Return the room that a frame is in: the present one while the camera is in its volume, else another or a new.

        A new one with a larger volume takes the place of one that is too narrow.

        Raises:
            FrameError: The first frame has no depth, or is black.
        """
        camera = frame.camera_to_world[:3, 3]
        present = self._room
        stays = present is not None and present.grid.margin(camera) >= 0
        if present is not None and (not frame.depth_m.any() or (stays and not present.grid.is_narrow(frame))):
            return present
        back = None if present is None or stays else room_at(camera, self._rooms)
        if isinstance(back, RoomView) and back.grid.margin(camera) >= BACK_MARGIN:
            room = self._new_room(back.grid)
            room.take_over(back.meshes)
            others = tuple(other for other in self._left if other is not back)
        else:
            room = self._new_room(VolumeGrid.from_frame(frame, shape=self._model.volume_shape))
            others = self._left
        if present is not None:
            covered = [view for view in others if room.grid.margin(view.place) >= BACK_MARGIN]
            for view in covered:  # they are one room, whose light may have changed since
                room.take_over(view.meshes)
            left = [view for view in others if view not in covered]
            room.take_over(present.meshes)
            if not stays:
                left.append(present.left())
            if len(left) > MOST_LEFT:
                del left[int(np.argmin([view.shown_m2() for view in left[:-1]]))]
            self._left = tuple(left)
        self._room = room
        for handle, probe in self._probes.items():
            self._probes[handle] = probe.in_room(room_at(probe.position, self._rooms))
        return room

    @property
    def _rooms(self) -> tuple[AnyRoom, ...]:
        return self._left if self._room is None else (*self._left, self._room)

    def _push_to_probes(self, probes: Sequence[Probe], mesh: FrameMesh, clock: _Clock) -> None:
        """Blend the frame into the probes; many are computed side by side, on all cores."""
        clocks = [_Clock() for _ in probes]

        def push(start: int, stop: int) -> None:
            for probe, own in zip(probes[start:stop], clocks[start:stop], strict=True):
                with own.stage("render"):
                    rendered = probe.render()
                with own.stage("partial"):
                    partial = probe.view(mesh)
                with own.stage("blend"):
                    probe.blend(rendered, partial, mesh)
                with own.stage("lights"):
                    probe.update_lights()

        parallel_for(push, len(probes), most=1)
        for own in clocks:
            clock.add(own)

    def light(self, handle: int) -> Light:
        """Return the light at a tracked position after the last frame.

        Raises:
            ProbeError: No tracked probe has this handle, or no frame was pushed yet.
        """
        return self._probe(handle, "light").light(self._last_index, self._lighting)

    def lights(self) -> Sequence[Light]:
        """Return the light at every tracked position, in the order of `handles`; none before the first frame."""
        return [probe.light(self._last_index, self._lighting) for probe in self._probes.values()]

    def light_at(self, position: Position) -> Light:
        """Return the light at any position, from the keyframes and the last frame.

        Args:
            position: World metres, y up.

        Raises:
            ProbeError: No frame was pushed yet, or the position is not usable.
        """
        return self._view(self._rooms, position).light_at(position)

    def lights_at(self, positions: Sequence[Position]) -> list[Light]:
        """Return the light at several positions, as `light_at` does, faster on several cores.

        Raises:
            ProbeError: No frame was pushed yet, or a position is not usable.
        """
        return self._view(self._rooms, positions).lights_at(positions)

    def view(self) -> SessionView:
        """Return the session after the last frame, which later frames do not change.

        Another thread may ask it for light while frames are pushed.

        Raises:
            ProbeError: No frame was pushed yet.
        """
        return self._view(tuple(room.view() for room in self._rooms), "any point")

    def _view(self, rooms: Sequence[AnyRoom], wanted: object) -> SessionView:
        if not rooms:
            raise ProbeError(f"no light at {wanted} yet: push a frame first")
        return SessionView(rooms, self.options.height, self._last_index, self._lighting)

    def panorama_state(self, handle: int) -> PanoramaState:
        """Return what a tracked position has accumulated up to the last frame; the next frame overwrites it.

        Raises:
            ProbeError: No tracked probe has this handle, or no frame was pushed yet.
        """
        return self._probe(handle, "panorama").panorama

    def snapshot(self) -> SessionSnapshot:
        """Return the state after the last frame. Later frames do not change it."""
        room = self._room
        last = None if room is None else room.keyframes.last
        keyframes = {index: mesh for view in self._left for index, mesh in view.meshes}
        keyframes |= {} if room is None else {key.index: key.mesh for key in room.keyframes}
        return SessionSnapshot(
            options=self.options,
            networks=self.networks,
            frames=self.frames,
            last_index=self._last_index,
            next_handle=self._next_handle,
            grid=self.grid,
            volume={} if room is None else room.volume.save(),
            pending=dict(self._pending),
            probes=tuple(probe.snapshot(handle, self._rooms) for handle, probe in self._probes.items()),
            keyframes=tuple(KeptFrame.of(index, mesh) for index, mesh in sorted(keyframes.items())),
            latest=None if last is None else KeptFrame.of(last.index, last.mesh),
            left=tuple(view.snapshot() for view in self._left),
            present=() if room is None else tuple(key.index for key in room.keyframes),
            drift=self._drift,
        )

    @classmethod
    def from_snapshot(
        cls, snapshot: SessionSnapshot, options: SessionOptions | None = None, *, graphs: LightingGraphs | None = None
    ) -> "Session":
        """Return a session that continues from a snapshot, and use the snapshot's arrays as its own.

        Args:
            snapshot: The state; make each session from a snapshot of its own.
            options: Default: the saved ones. Others may differ in weights, parts and provider.
            graphs: As in `Session`.

        Raises:
            StateError: The options or the weights differ from those of the saved session.
            ModelError: The weights cannot be used.
        """
        session = cls(options or snapshot.options, graphs=graphs)
        snapshot.check(session.options, session.networks)
        try:
            session._restore(snapshot)
        except (KeyError, ValueError) as error:
            raise StateError(f"its values do not fit each other ({error!r})") from error
        return session

    def save(self, path: Path | str) -> None:
        """Save the session, with the pixels of its keyframes, to one file that only this user can read.

        `Session.load` continues from it with the same bits. 24 keyframes and a tracked probe take 10 MB.

        Raises:
            OutputError: The file cannot be written; a file that was there is unchanged.
        """
        from roomlight.engine.state.encoding import records_of_snapshot  # pydantic takes 0.1 s to import
        from roomlight.engine.state.records import pack_records

        write_durable(Path(path), pack_records(records_of_snapshot(self.snapshot())))

    @classmethod
    def load(
        cls, path: Path | str, options: SessionOptions | None = None, *, graphs: LightingGraphs | None = None
    ) -> "Session":
        """Return a session that continues where `save` was called.

        Args:
            path: The saved file.
            options: Default: the saved ones. Others may differ in weights, parts and provider.
            graphs: As in `Session`.

        Raises:
            StateError: The file is missing, damaged, of another version, or was saved with other options or weights.
            ModelError: The weights cannot be used.
        """
        from roomlight.engine.state.encoding import saved_session

        try:
            file = Path(path).read_bytes()
        except OSError as error:
            raise StateError(f"{path}: cannot be read ({error.strerror or error})") from error
        try:
            return cls.from_snapshot(saved_session(file, str(path)).snapshot(), options, graphs=graphs)
        except StateError as error:
            raise error if str(path) in str(error) else StateError(f"{path}: {error}") from error

    def _new_room(self, grid: VolumeGrid) -> Room:
        return Room(grid, self._model, keyframes=self.options.keyframes)

    def _probe(self, handle: int, wanted: str) -> Probe:
        handle = _whole(handle)
        if handle not in self._probes:
            tracked = f"this session tracks {len(self._probes)}"
            reason = "no frame has been pushed yet" if handle in self._pending else tracked
            raise ProbeError(f"no {wanted} for tracked probe {handle}: {reason}")
        return self._probes[handle]

    def _restore(self, snapshot: SessionSnapshot) -> None:
        self.frames, self._last_index, self._next_handle = snapshot.frames, snapshot.last_index, snapshot.next_handle
        self._pending = dict(snapshot.pending)
        self._last_number = max([snapshot.last_index, *(frame.index for frame in snapshot.kept)])
        if snapshot.grid is None:
            return
        room = self._room = self._new_room(snapshot.grid)
        kept = {frame.index: frame.mesh for frame in snapshot.keyframes}
        self._drift = snapshot.drift
        self._remember_gain()
        self._left = tuple(RoomView.of_snapshot(saved, kept, room.far, room.new_probe) for saved in snapshot.left)
        keyframes = {index: kept[index] for index in snapshot.present}
        latest = None if snapshot.latest is None else (snapshot.latest.index, snapshot.latest.mesh)
        room.restore(snapshot.volume, keyframes, latest)
        self._probes = {saved.handle: Probe.of_snapshot(saved, self._rooms[saved.room]) for saved in snapshot.probes}


def _whole(handle: int) -> int:
    try:
        return operator.index(handle)
    except TypeError:
        raise ProbeError(f"a handle is a whole number, which `track` returns; got {handle!r}") from None


def warm_up(graphs: LightingGraphs | None = None) -> None:
    """Compile (or load from numba's cache) every kernel of a session on frames of 32 x 24 pixels, and run the graphs.

    The first run of a graph plans its memory.
    """
    session = Session(SessionOptions(model="classical", height=_WARM_HEIGHT), graphs=graphs)
    session.track(_WARM_POSITION)
    session.push(_warm_frame(0, 0.5))
    session.push(_warm_frame(1, 2.0))  # a shorter exposure: searched


def warm_up_surfaces() -> None:
    """Compile (or load) what `warm_up` needs last: meshes and blending. Another process does it meanwhile."""
    mesh = FrameMesh(_warm_frame(0, 0.5))
    partial = mesh.render_panorama(np.array(_WARM_POSITION), height=_WARM_HEIGHT)
    state, weight = PanoramaState.fresh(_WARM_HEIGHT, 1.0), partial.mask.astype(np.float32)
    forget_seen_through(state, partial, mesh, _WARM_POSITION, 1.0)
    accumulate(state, partial, hdr=partial.radiance, weight=weight, unseen_m=unseen_depth_m(1.0), camera=AT_PROBE)


def _warm_frame(index: int, level: float) -> Frame:
    image, clipped = np.full((24, 32, 3), level, np.float32), np.zeros((24, 32), bool)
    clipped[:12] = True
    intrinsics = Intrinsics(30.0, 30.0, 16.0, 12.0, 32, 24)
    return Frame(index, image, clipped, np.ones((24, 32), np.float32), intrinsics, np.eye(4))
