"""One stream of frames and the light it reveals: the engine's only door.

    session = Session(SessionOptions(model="classical"))
    for frame in open_capture(path):
        session.push(frame)
    light = session.light_at((0.2, -0.1, 0.5))

Positions are world metres, y up. Light is relative linear RGB (see `roomlight.conventions`). A session is not
thread-safe: its owner serialises the calls.
"""

import time
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from roomlight.camera import Intrinsics
from roomlight.conventions import NO_FRAME, Position
from roomlight.depth import UnknownDepth, complete_depth
from roomlight.engine.backend import Backend, ProbeMemory
from roomlight.engine.blend import PanoramaState, accumulate, farthest_depth_m
from roomlight.engine.classical_backend import ClassicalBackend
from roomlight.engine.clipping import restore_clipped
from roomlight.engine.graphs import DESCRIPTION, SHIPPED, LightingGraphs, load_graphs
from roomlight.engine.keyframes import DEFAULT_KEYFRAMES, KeyframeStore
from roomlight.engine.mesh import FrameMesh
from roomlight.engine.network_backend import NetworkBackend
from roomlight.engine.providers import Provider
from roomlight.engine.sglv import Sglv, check_position, render_panorama
from roomlight.engine.volume import VOLUME_SHAPE, VolumeGrid, initial_volume
from roomlight.errors import ModelError, ProbeError
from roomlight.frame import Frame
from roomlight.light.light import Light

ModelName = Literal["auto", "classical", "single", "video"]

WORKING_SIZE = (320, 240)
"""Frames are brought to this size (width, height; turned for upright images), the paper's: eight pixels to one of a
panorama of 120 rows."""


@dataclass(frozen=True)
class SessionOptions:
    """How a session works; see each field.

    model:          auto = the form of `weights`; without them the trained networks that come with the package, video
                    before single-view; else classical.
    weights:        a model directory of `roomlight export` instead of the shipped weights.
    height:         of the panoramas (width is twice that).
    keyframes:      how many frames are kept to catch up probes that are first asked about late.
    unknown_depth:  how pixels without depth enter (see `roomlight.depth`).
    """

    model: ModelName = "auto"
    weights: Path | None = None
    provider: Provider = "auto"
    allow_untrained: bool = False
    height: int = 120
    keyframes: int = DEFAULT_KEYFRAMES
    unknown_depth: UnknownDepth = "rim"

    def __post_init__(self) -> None:
        """Refuse, by ValueError, sizes that make no panorama and a store that holds nothing."""
        if not 16 <= self.height <= 2048:
            raise ValueError(f"panorama height must be 16 to 2048 pixels, got {self.height}")
        if self.keyframes < 1:
            raise ValueError(f"at least 1 keyframe is kept for probes asked late, got {self.keyframes}")


@dataclass(frozen=True)
class FrameReport:
    """What one frame did: milliseconds by stage, whether it is a keyframe, each tracked probe's coverage."""

    index: int
    stage_ms: dict[str, float]
    keyframe: bool
    coverage: tuple[float, ...]


@dataclass(frozen=True)
class _Probe:
    position: Position
    state: PanoramaState
    memory: ProbeMemory


@dataclass
class _Clock:
    stage_ms: dict[str, float] = field(default_factory=dict[str, float])

    @contextmanager
    def stage(self, name: str):
        began = time.perf_counter()
        yield
        self.stage_ms[name] = self.stage_ms.get(name, 0.0) + (time.perf_counter() - began) * 1e3


def choose_graphs(options: SessionOptions) -> LightingGraphs | None:
    """The graphs that these options mean; None is the classical model. Load once, share between sessions.

    Raises ModelError if a form is asked for whose weights are not there, or do not have it.
    """
    if options.model == "classical":
        return None
    if options.weights is not None:
        graphs = load_graphs(options.weights, provider=options.provider, allow_untrained=options.allow_untrained)
        if options.model == "video" and graphs.form == "single":
            raise ModelError(f"{options.weights}: holds single-view weights only; use --model single or auto")
        return replace(graphs, form="single") if options.model == "single" else graphs
    # A video folder holds the single-view graphs too: its first frame needs them.
    folders = {"single": ("single", "video"), "video": ("video",), "auto": ("video", "single")}
    for folder in folders[options.model]:
        if _shipped(folder):
            graphs = load_graphs(SHIPPED / folder, provider=options.provider)
            return replace(graphs, form="single") if options.model == "single" else graphs
    if options.model == "auto":
        return None
    raise ModelError(
        f"model '{options.model}': no trained weights come with this version; "
        "give --weights DIR (from `roomlight export`) or use --model classical"
    )


def _shipped(folder: str) -> bool:
    return (SHIPPED / folder / DESCRIPTION).is_file()


class Session:
    """A stream's whole state: SGLV, hidden states, tracked probes, keyframes."""

    def __init__(self, options: SessionOptions | None = None, *, graphs: LightingGraphs | None = None) -> None:
        """Begin empty, on loaded (shared) `graphs` or on what the options name. Raises ModelError."""
        self.options = options or SessionOptions()
        chosen = graphs or choose_graphs(self.options)
        self._backend: Backend = NetworkBackend(chosen) if chosen else ClassicalBackend()
        self._shape = chosen.volume_shape if chosen else VOLUME_SHAPE
        self._grid: VolumeGrid | None = None
        self._sglv: Sglv | None = None
        self._latest: FrameMesh | None = None
        self._keyframes: KeyframeStore | None = None
        self._latest_is_keyframe = False
        self._probes: dict[int, _Probe] = {}  # by handle
        self._waiting: dict[int, Position] = {}
        self._next_handle = 0
        self.frames = 0
        self._last_index = NO_FRAME

    @property
    def model(self) -> str:
        """The model in use: classical, single or video."""
        return self._backend.name

    @property
    def grid(self) -> VolumeGrid | None:
        """The volume's frame; None before the first frame."""
        return self._grid

    @property
    def sglv(self) -> Sglv | None:
        """The lighting volume after the last frame; None before the first. Overwritten by the next frame."""
        return self._sglv

    @property
    def keyframes(self) -> int:
        """Keyframes held."""
        return len(self._keyframes) if self._keyframes else 0

    def track(self, position: Position) -> int:
        """Follow a position from now on, caught up; returns its handle: 0, 1, 2, ... Raises ProbeError."""
        x, y, z = check_position(position).tolist()
        handle = self._next_handle
        if self._sglv is None:  # the volume's size, and so the probe's memory, comes with the first frame
            self._waiting[handle] = (x, y, z)
        else:
            self._probes[handle] = self._new_probe((x, y, z))
        self._next_handle += 1
        return handle

    def untrack(self, handle: int) -> None:
        """No longer follow a position; its handle is not used again. Raises ProbeError if it is none."""
        if self._probes.pop(handle, None) is None and self._waiting.pop(handle, None) is None:
            raise ProbeError(f"there is no tracked probe {handle} to give up")

    def push(self, frame: Frame) -> FrameReport:
        """Take the next frame. Raises FrameError if it cannot be used; the session is then as before."""
        clock = _Clock()
        with clock.stage("prepare"):
            frame = frame.resized(*WORKING_SIZE)
            rim = self.options.unknown_depth == "rim"
            frame = restore_clipped(frame, complete_depth(frame.depth_m) if rim else frame.depth_m)
            grid = self._grid or VolumeGrid.from_frame(frame, shape=self._shape)
        if self._grid is None:
            self._backend.start(grid)
            self._keyframes = KeyframeStore(grid, self.options.keyframes)
            self._grid = grid
        assert self._keyframes is not None
        with clock.stage("volume"):
            far = self.options.unknown_depth != "drop"
            initial_volume(grid, frame, far_unknown=far, out=self._backend.volume_buffer())
        with clock.stage("sglv"):
            self._sglv = self._backend.update()
        with clock.stage("mesh"):
            self._latest = FrameMesh(frame)
            self._latest.build()
        with clock.stage("keyframes"):
            self._latest_is_keyframe = self._keyframes.offer(frame.index, self._latest)
        for handle, position in self._waiting.items():
            self._probes[handle] = self._fresh_probe(position)
        self._waiting.clear()
        for probe in self._probes.values():
            with clock.stage("render"):
                rendered = self._render(probe)
            self._observe(probe, self._latest, rendered, clock)
        self.frames += 1
        self._last_index = frame.index
        coverage = tuple(probe.state.coverage() for probe in self._probes.values())
        return FrameReport(frame.index, clock.stage_ms, self._latest_is_keyframe, coverage)

    @property
    def handles(self) -> tuple[int, ...]:
        """Of the tracked positions, in the order of `lights` and of a report's coverage."""
        return (*self._probes, *self._waiting)

    def light(self, handle: int) -> Light:
        """The light at a tracked position, as of the last frame."""
        if handle not in self._probes:
            tracked = f"this session tracks {len(self._probes)}"
            reason = "no frame has been pushed yet" if handle in self._waiting else tracked
            raise ProbeError(f"no light for tracked probe {handle}: {reason}")
        return self._light_of(self._probes[handle])

    def light_at(self, position: Position) -> Light:
        """The light at any position, seen through the keyframes and the last frame.

        Raises ProbeError before the first frame, and for a position that is none.
        """
        if self._sglv is None:
            raise ProbeError(f"no light at {position} yet: push a frame first")
        x, y, z = check_position(position).tolist()
        return self._light_of(self._new_probe((x, y, z)))

    def lights(self) -> Sequence[Light]:
        """The light at every tracked position, in order of their handles."""
        return [self._light_of(probe) for probe in self._probes.values()]

    def _fresh_probe(self, position: Position) -> _Probe:
        assert self._grid is not None
        state = PanoramaState.fresh(self.options.height, self._grid.depth_max_m)
        return _Probe(position, state, self._backend.new_probe())

    def _new_probe(self, position: Position) -> _Probe:
        """A probe that has seen what the keyframes and the last frame show, in order of time.

        The SGLVs of those moments are gone: every look is blended over the present one, which has seen more. 2D hidden
        states run through the same looks, from the first on.
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
            )

    def _light_of(self, probe: _Probe) -> Light:
        state = probe.state
        radiance, observed = state.radiance.copy(), state.seen.copy()
        return Light(probe.position, radiance, observed, state.coverage(), frame=self._last_index)


def warm_up(graphs: LightingGraphs | None = None) -> None:
    """Compile (or load from numba's cache) every kernel a session uses, on a frame of 32 x 24 pixels; and run graphs
    once, for their first run plans their memory."""
    intrinsics = Intrinsics(30.0, 30.0, 16.0, 12.0, 32, 24)
    grey, near = np.full((24, 32, 3), 0.5, np.float32), np.ones((24, 32), np.float32)
    session = Session(SessionOptions(model="classical", height=16), graphs=graphs)
    session.track((0.0, 0.0, -0.5))
    session.push(Frame(0, grey, near < 0, near, intrinsics, np.eye(4)))
