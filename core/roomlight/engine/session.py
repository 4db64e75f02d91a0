"""The session: a stream of frames in, light at any point out.

    session = Session(SessionOptions(model="classical"))
    for frame in open_capture(path):
        session.push(frame)
    light = session.light_at((0.2, -0.1, -1.5))

Positions are world metres, y up. Light is relative linear RGB (`roomlight.conventions`). A session is not thread-safe:
its owner serialises the calls.
"""

import time
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.conventions import NO_FRAME, Position
from roomlight.depth import complete_depth, without_unseen
from roomlight.engine.backend import Backend, ProbeMemory
from roomlight.engine.classical_backend import ClassicalBackend
from roomlight.engine.network_backend import NetworkBackend
from roomlight.engine.networks.clipping import shipped_clipping
from roomlight.engine.networks.graphs import DESCRIPTION, SHIPPED, LightingGraphs, load_graphs
from roomlight.engine.options import WORKING_SIZE, SessionOptions
from roomlight.engine.options import ModelName as ModelName
from roomlight.engine.panorama.blend import PanoramaState, accumulate, farthest_depth_m
from roomlight.engine.panorama.light_tracking import LightTracker
from roomlight.engine.state.snapshot import KeptFrame, ProbeSnapshot, SessionSnapshot
from roomlight.engine.surface.bracket import restored, update_keyframes
from roomlight.engine.surface.keyframes import KeyframeStore
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VOLUME_SHAPE, VolumeGrid, clipping_buffer, initial_volume
from roomlight.engine.volume.sglv import Sglv, check_position, render_panorama
from roomlight.errors import ModelError, OptionError, ProbeError, StateError
from roomlight.frame import Frame
from roomlight.light.light import Light
from roomlight.light.main_light import find_lights


@dataclass(frozen=True)
class FrameReport:
    """Report of one frame.

    Attributes:
        index: of the frame.
        stage_ms: milliseconds by processing stage: prepare, volume, sglv, mesh, keyframes, render, partial, blend,
            lights (main light of each tracked probe).
        keyframe: whether it was kept as a keyframe.
        coverage: of each tracked probe, in the order of `Session.handles`.
    """

    index: int
    stage_ms: dict[str, float]
    keyframe: bool
    coverage: tuple[float, ...]


@dataclass(frozen=True)
class _Probe:
    position: Position
    state: PanoramaState
    memory: ProbeMemory
    tracker: LightTracker

    def update_lights(self) -> None:
        self.tracker.update(find_lights(self.state.radiance))


@dataclass
class _Clock:
    stage_ms: dict[str, float] = field(default_factory=dict[str, float])

    @contextmanager
    def stage(self, name: str):
        began = time.perf_counter()
        yield
        self.stage_ms[name] = self.stage_ms.get(name, 0.0) + (time.perf_counter() - began) * 1e3


def choose_graphs(options: SessionOptions) -> LightingGraphs | None:
    """Load the graphs that the options select; None for the classical model. Load once, share between sessions.

    Raises:
        OptionError: model="video" contradicts `weights`, which are single-view.
        ModelError: the weights are missing, damaged or untrained, or the provider is not available.
    """
    if options.model == "classical" or (options.model == "auto" and options.weights is None):
        return None
    if options.weights is not None:
        graphs = load_graphs(options.weights, provider=options.provider)
        if options.model == "video" and graphs.form == "single":
            raise OptionError(f'{options.weights}: holds single-view weights only; use model="single" or "auto"')
        return replace(graphs, form="single") if options.model == "single" else graphs
    # A video folder holds the single-view graphs too: its first frame needs them.
    for folder in ("single", "video") if options.model == "single" else ("video",):
        if _shipped(folder):
            graphs = load_graphs(SHIPPED / folder, provider=options.provider)
            return replace(graphs, form="single") if options.model == "single" else graphs
    raise ModelError(
        f'model="{options.model}": this version contains no trained weights for it; '
        'set `weights` to a model directory (from `roomlight export`) or use model="classical"'
    )


def _backend(options: SessionOptions, graphs: LightingGraphs | None) -> Backend:
    if graphs is not None:
        return NetworkBackend(graphs, hedge=options.hedge)
    return ClassicalBackend()


def _shipped(folder: str) -> bool:
    return (SHIPPED / folder / DESCRIPTION).is_file()


class Session:
    """The state of one stream: SGLV, hidden states, tracked probes, keyframes."""

    def __init__(self, options: SessionOptions | None = None, *, graphs: LightingGraphs | None = None) -> None:
        """Begin without frames.

        graphs:  loaded graphs, shared with other sessions; default: those that the options select.

        Raises:
            OptionError: the options contradict each other (see `choose_graphs`).
            ModelError: the weights cannot be used (see `choose_graphs`).
        """
        self.options = options or SessionOptions()
        chosen = graphs or choose_graphs(self.options)
        self._backend = _backend(self.options, chosen)
        folder, provider = self.options.parts or SHIPPED, self.options.provider
        self._clipping = shipped_clipping(provider, folder / "clipping")
        self._shape = chosen.volume_shape if chosen else VOLUME_SHAPE
        self._grid: VolumeGrid | None = None
        self._sglv: Sglv | None = None
        self._latest: FrameMesh | None = None
        self._keyframes: KeyframeStore | None = None
        self._latest_is_keyframe = False
        self._probes: dict[int, _Probe] = {}  # by handle
        self._pending: dict[int, Position] = {}  # tracked before the first frame, by handle
        self._next_handle = 0
        self.frames = 0
        self._last_index = NO_FRAME

    @property
    def model(self) -> str:
        """The model in use: classical, single or video."""
        return self._backend.name

    @property
    def grid(self) -> VolumeGrid | None:
        """Pose and size of the lighting volume; None before the first frame."""
        return self._grid

    @property
    def sglv(self) -> Sglv | None:
        """The lighting volume after the last frame; None before the first. The next frame overwrites it."""
        return self._sglv

    @property
    def keyframes(self) -> int:
        """Number of keyframes held."""
        return len(self._keyframes) if self._keyframes else 0

    @property
    def meshes(self) -> list[tuple[int, FrameMesh]]:
        """Frame index and mesh of every keyframe in order of time, then of the last frame if it is no keyframe."""
        kept = [(key.index, key.mesh) for key in self._keyframes or ()]
        if self._latest is not None and not self._latest_is_keyframe:
            kept.append((self._last_index, self._latest))
        return kept

    def track(self, position: Position) -> int:
        """Track a position: every later frame is blended into its panorama. Return its handle: 0, 1, 2, ...

        The panorama begins with what the keyframes and the last frame show, as in `light_at`.

        Raises:
            ProbeError: the position is not usable.
        """
        x, y, z = check_position(position).tolist()
        handle = self._next_handle
        if self._sglv is None:  # the first frame fixes the volume's size, and with it the probe's state
            self._pending[handle] = (x, y, z)
        else:
            self._probes[handle] = self._new_probe((x, y, z))
            self._probes[handle].update_lights()
        self._next_handle += 1
        return handle

    def untrack(self, handle: int) -> None:
        """Stop tracking a position; its handle is not used again.

        Raises:
            ProbeError: no tracked probe has this handle.
        """
        if self._probes.pop(handle, None) is None and self._pending.pop(handle, None) is None:
            raise ProbeError(f"no tracked probe has the handle {handle}")

    def push(self, frame: Frame) -> FrameReport:
        """Process the next frame.

        Raises:
            FrameError: the frame cannot be used; the session is unchanged.
        """
        clock = _Clock()
        with clock.stage("prepare"):
            frame = frame.resized(*WORKING_SIZE)
            sensor_depth_m = frame.depth_m
            rim = self.options.unknown_depth == "rim"
            depth_m = complete_depth(frame.depth_m) if rim else frame.depth_m
            depth_m = without_unseen(depth_m, frame.seen)
            sensor_clipped = frame.clipped
            frame = restored(frame, depth_m, [mesh for _, mesh in self.meshes], model=self._clipping)
            grid = self._grid or VolumeGrid.from_frame(frame, shape=self._shape)
        if self._grid is None:
            self._backend.start(grid)
            self._keyframes = KeyframeStore(grid, self.options.keyframes)
            self._grid = grid
        assert self._keyframes is not None
        with clock.stage("volume"):
            # after completion only pixels that show nothing are without depth
            far = self.options.unknown_depth == "far" or (rim and frame.seen is None)
            clipping = clipping_buffer(grid, frame)
            initial_volume(grid, frame, far_unknown=far, out=self._backend.volume_buffer(), clipping=clipping)
        with clock.stage("sglv"):
            self._sglv = self._backend.update(clipping)
        with clock.stage("mesh"):
            self._latest = FrameMesh(frame, sensor_depth_m=sensor_depth_m, sensor_clipped=sensor_clipped)
        with clock.stage("keyframes"):
            update_keyframes(self._latest, [key.mesh for key in self._keyframes])
            self._latest_is_keyframe = self._keyframes.offer(frame.index, self._latest)
        for handle, position in self._pending.items():
            self._probes[handle] = self._fresh_probe(position)
        self._pending.clear()
        for probe in self._probes.values():
            with clock.stage("render"):
                rendered = self._render(probe)
            self._observe(probe, self._latest, rendered, clock)
            with clock.stage("lights"):
                probe.update_lights()
        self.frames += 1
        self._last_index = frame.index
        coverage = tuple(probe.state.coverage() for probe in self._probes.values())
        return FrameReport(frame.index, clock.stage_ms, self._latest_is_keyframe, coverage)

    @property
    def handles(self) -> tuple[int, ...]:
        """Handles of the tracked positions, in the order of `lights` and of a report's coverage."""
        return (*self._probes, *self._pending)

    def light(self, handle: int) -> Light:
        """Return the light at a tracked position after the last frame.

        Raises:
            ProbeError: no tracked probe has this handle, or no frame was pushed yet.
        """
        return self._light_of(self._probe(handle, "light"))

    def panorama_state(self, handle: int) -> PanoramaState:
        """Return what a tracked position has accumulated up to the last frame; the next frame overwrites it.

        Raises:
            ProbeError: no tracked probe has this handle, or no frame was pushed yet.
        """
        return self._probe(handle, "panorama").state

    def light_at(self, position: Position) -> Light:
        """Return the light at any position, from the keyframes and the last frame.

        Raises:
            ProbeError: no frame was pushed yet, or the position is not usable.
        """
        if self._sglv is None:
            raise ProbeError(f"no light at {position} yet: push a frame first")
        x, y, z = check_position(position).tolist()
        return self._light_of(self._new_probe((x, y, z)))

    def lights(self) -> Sequence[Light]:
        """Return the light at every tracked position, in the order of `handles`."""
        return [self._light_of(probe) for probe in self._probes.values()]

    @property
    def networks(self) -> dict[str, str]:
        """The model in use, and the identity of the weights of its networks and of the one for clipped pixels."""
        return {"model": self.model, "weights": self._backend.digest, "clipping": self._clipping.digest}

    def snapshot(self) -> SessionSnapshot:
        """Return the state after the last frame. Later frames do not change it."""
        keyframes = tuple(KeptFrame(key.index, key.mesh, key.mesh.texture) for key in self._keyframes or ())
        latest = None
        if self._latest is not None and not self._latest_is_keyframe:
            latest = KeptFrame(self._last_index, self._latest, self._latest.texture)
        return SessionSnapshot(
            options=self.options,
            networks=self.networks,
            frames=self.frames,
            last_index=self._last_index,
            next_handle=self._next_handle,
            grid=self._grid,
            backend={} if self._grid is None else self._backend.save(),
            pending=dict(self._pending),
            probes=tuple(
                ProbeSnapshot(
                    handle,
                    probe.position,
                    probe.state.copy(),
                    self._backend.save_probe(probe.memory),
                    replace(probe.tracker),
                )
                for handle, probe in self._probes.items()
            ),
            keyframes=keyframes,
            latest=latest,
        )

    @classmethod
    def from_snapshot(
        cls, snapshot: SessionSnapshot, options: SessionOptions | None = None, *, graphs: LightingGraphs | None = None
    ) -> "Session":
        """Return a session that continues from a snapshot, and use the snapshot's arrays as its own.

        Args:
            snapshot: the state; make each session from a snapshot of its own.
            options: default: the saved ones. Others may differ in weights, parts and provider.
            graphs: as in `Session`.

        Raises:
            StateError: the options or the weights differ from those of the saved session.
            ModelError: the weights cannot be used (see `choose_graphs`).
        """
        session = cls(options or snapshot.options, graphs=graphs)
        for name in ("hedge", "height", "keyframes", "unknown_depth"):
            saved, given = getattr(snapshot.options, name), getattr(session.options, name)
            if saved != given:
                raise StateError(f"the session was saved with {name}={saved!r}, not {given!r}")
        for name, given in session.networks.items():
            saved = snapshot.networks.get(name)
            if saved != given:
                what = {"model": "the model", "weights": "weights", "clipping": "a network for clipped pixels"}[name]
                shown = [(digest or "none")[:16] for digest in (saved or "", given)]
                raise StateError(f"the session was saved with {what} {shown[0]}, and here is {shown[1]}")
        try:
            session._restore(snapshot)
        except (KeyError, ValueError) as error:
            raise StateError(f"its values do not fit each other ({error!r})") from error
        return session

    def _restore(self, snapshot: SessionSnapshot) -> None:
        self.frames, self._last_index, self._next_handle = snapshot.frames, snapshot.last_index, snapshot.next_handle
        self._pending = dict(snapshot.pending)
        if snapshot.grid is None:
            return
        self._grid = snapshot.grid
        self._sglv = self._backend.restore(snapshot.grid, snapshot.backend)
        self._keyframes = KeyframeStore(snapshot.grid, self.options.keyframes)
        for key in snapshot.keyframes:
            self._keyframes.restore(key.index, key.mesh)
        self._latest_is_keyframe = snapshot.latest is None
        self._latest = snapshot.kept[-1].mesh
        for one in snapshot.probes:
            memory = self._backend.restore_probe(one.memory)
            self._probes[one.handle] = _Probe(one.position, one.panorama, memory, replace(one.tracker))

    def save(self, path: Path | str) -> None:
        """Save the session, with the pixels of its keyframes, to one file that only this user can read.

        `Session.load` continues from it with the same bits. 24 keyframes and a tracked probe take 10 MB.

        Raises:
            OutputError: the file cannot be written; a file that was there is unchanged.
        """
        from roomlight.engine.state.session_file import write_session  # pydantic takes 0.1 s to import

        write_session(Path(path), self.snapshot())

    @classmethod
    def load(
        cls, path: Path | str, options: SessionOptions | None = None, *, graphs: LightingGraphs | None = None
    ) -> "Session":
        """Return a session that continues where `save` was called.

        Args:
            path: the saved file.
            options: default: the saved ones. Others may differ in weights, parts and provider.
            graphs: as in `Session`.

        Raises:
            StateError: the file is missing, damaged, of another version, or was saved with other options or weights.
            ModelError: the weights cannot be used (see `choose_graphs`).
        """
        from roomlight.engine.state.session_file import read_session

        try:
            return cls.from_snapshot(read_session(Path(path)), options, graphs=graphs)
        except StateError as error:
            raise error if str(path) in str(error) else StateError(f"{path}: {error}") from error

    def _probe(self, handle: int, wanted: str) -> _Probe:
        if handle not in self._probes:
            tracked = f"this session tracks {len(self._probes)}"
            reason = "no frame has been pushed yet" if handle in self._pending else tracked
            raise ProbeError(f"no {wanted} for tracked probe {handle}: {reason}")
        return self._probes[handle]

    def _fresh_probe(self, position: Position) -> _Probe:
        assert self._grid is not None
        state = PanoramaState.fresh(self.options.height, self._grid.depth_max_m)
        return _Probe(position, state, self._backend.new_probe(), LightTracker())

    def _new_probe(self, position: Position) -> _Probe:
        """Make a probe into which the keyframes and the last frame are blended, in order of time.

        The SGLVs of those moments are gone: every frame is blended over the present SGLV, which has observed more. 2D
        hidden states run through the same frames from the first on.
        """
        assert self._keyframes is not None
        assert self._latest is not None
        probe = self._fresh_probe(position)
        rendered = self._render(probe)
        clock = _Clock()
        for keyframe in self._keyframes:
            self._observe(probe, keyframe.mesh, rendered, clock)
        if not self._latest_is_keyframe:
            self._observe(probe, self._latest, rendered, clock)
        return probe

    def _render(self, probe: _Probe) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
        assert self._sglv is not None
        return render_panorama(self._sglv, probe.position, height=self.options.height, far=self._backend.far)

    def _observe(
        self,
        probe: _Probe,
        mesh: FrameMesh,
        rendered: tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]],
        clock: _Clock,
    ) -> None:
        assert self._grid is not None
        with clock.stage("partial"):
            partial = mesh.render_panorama(np.asarray(probe.position), height=self.options.height)
            partial = partial.within(farthest_depth_m(self._grid.depth_max_m))
        with clock.stage("blend"):
            radiance, transmittance = rendered
            estimate = self._backend.estimate(
                probe.memory,
                probe.state,
                rendered=radiance,
                transmittance=transmittance,
                partial=partial,
                depth_max_m=self._grid.depth_max_m,
            )
            accumulate(
                probe.state,
                hdr=estimate.hdr,
                detail=partial.radiance,
                detail_depth_m=partial.depth_m,
                weight=estimate.weight,
                detail_clipped=partial.clipped,
                detail_guessed=partial.guessed,
                camera=mesh.camera_to_world[:3, 3] - np.asarray(probe.position),
            )

    def _light_of(self, probe: _Probe) -> Light:
        state = probe.state
        radiance, observed = state.radiance.copy(), state.seen.copy()
        light = Light(probe.position, radiance, observed, state.coverage(), frame=self._last_index)
        return light.with_lights(probe.tracker.lights) if probe.tracker.frames else light


def warm_up(graphs: LightingGraphs | None = None) -> None:
    """Compile (or load from numba's cache) every kernel of a session on frames of 32 x 24 pixels, and run the graphs.

    The first run of a graph plans its memory.
    """
    intrinsics = Intrinsics(30.0, 30.0, 16.0, 12.0, 32, 24)
    grey, near = np.full((24, 32, 3), 0.5, np.float32), np.ones((24, 32), np.float32)
    session = Session(SessionOptions(model="classical", height=16), graphs=graphs)
    session.track((0.0, 0.0, -0.5))
    clipped = np.zeros((24, 32), bool)
    clipped[:12] = True
    session.push(Frame(0, grey, clipped, near, intrinsics, np.eye(4)))
    session.push(Frame(1, 4 * grey, clipped, near, intrinsics, np.eye(4)))  # a shorter exposure: searched
