"""Replay of a recorded capture through a session: one HDR panorama a frame at each probe, pictures and a report.

The session is the engine here, or one behind a server (`remote_replay`): the loop is the same.

What is written: `probe-00/000000.exr` ... (named by the capture's frame index), `summary.png`, `replay.mp4` and, last
of all, `report.json`: a folder without it is not whole. `replay.json` is written first, once a frame has proved usable,
and says what the folder is for, so that the same command continues an interrupted replay and another one refuses to
mix with it.
"""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from roomlight import __version__
from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.conventions import Position
from roomlight.engine.session import FrameReport, Session, SessionOptions
from roomlight.engine.sglv import check_position
from roomlight.engine.volume import VolumeGrid
from roomlight.errors import CaptureError, FrameError, OutputError
from roomlight.files import write_json
from roomlight.frame import Frame
from roomlight.images import write_exr
from roomlight.placement import point_in_view
from roomlight_cli.pictures import FILM, SUMMARY, ReplayPictures

REPORT: Final = "report.json"
INTENT: Final = "replay.json"


@dataclass(frozen=True)
class ReplayOptions:
    """What to replay and how much of it.

    probes:        world positions in metres; empty = the capture's own probes if `probes_from_capture`, else one point
                   on the first frame's optical axis, at 60 % of its median depth.
    every:         a session frame is every n-th of the capture.
    interpolate:   also write the frames in between, linearly interpolated in radiance (paper, section 5.2).
    overwrite:     replace what the output folder holds of another replay.
    server:        the address that the session is behind; None: the engine here.
    """

    capture: CaptureOptions = field(default_factory=CaptureOptions)
    session: SessionOptions = field(default_factory=SessionOptions)
    probes: tuple[Position, ...] = ()
    probes_from_capture: bool = False
    every: int = 1
    interpolate: bool = False
    overwrite: bool = False
    server: str | None = None

    def __post_init__(self) -> None:
        """Refuse steps that select nothing."""
        if self.every < 1:
            raise CaptureError(f"--every must be 1 or more, got {self.every}")
        for position in self.probes:
            check_position(position)


@dataclass(frozen=True)
class ReplayResult:
    """Where the outputs are, and the report as written."""

    out: Path
    report: dict[str, Any]


Progress = Callable[[int, int], None]
"""Called with (frames done, frames in all)."""


@runtime_checkable  # so that a checker of annotations can look at it in the test run
class ReplayLight(Protocol):
    """What is kept of the light at a probe; `roomlight.engine.session.Light` is one."""

    @property
    def position(self) -> Position:
        """World metres."""
        ...

    @property
    def panorama(self) -> Float[np.ndarray, "h w 3"]:
        """Linear RGB, float32."""
        ...

    @property
    def coverage(self) -> float:
        """Share of the sphere that was observed."""
        ...


@runtime_checkable
class ReplaySession(Protocol):
    """What a replay asks of a session; `roomlight.engine.session.Session` is one."""

    @property
    def model(self) -> str:
        """The model in use."""
        ...

    @property
    def grid(self) -> VolumeGrid | None:
        """The volume's frame, once there is one."""
        ...

    @property
    def keyframes(self) -> int:
        """Keyframes held."""
        ...

    def track(self, position: Position) -> int:
        """Follow a position from now on."""
        ...

    def push(self, frame: Frame) -> FrameReport:
        """Take the next frame; FrameError if it cannot be used."""
        ...

    def lights(self) -> Sequence[ReplayLight]:
        """The light at every tracked position."""
        ...


def replay(
    path: Path,
    out: Path,
    options: ReplayOptions,
    *,
    session: ReplaySession | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """Replay a capture into a folder, by the engine here or by a fresh `session`. Raises RoomLightError.

    An interruption leaves what is written, without a report; the next call with the same arguments continues.
    """
    read = options.capture
    stride = 1 if options.interpolate else options.every
    capture = open_capture(path, replace(read, every=read.every * stride))
    session = session or Session(options.session)
    positions = options.probes or (_capture_probes(capture) if options.probes_from_capture else ())
    intent = _intent(path, session.model, options)
    _refuse_foreign(out, capture.path, intent, overwrite=options.overwrite)

    began = time.perf_counter()
    reports: list[FrameReport] = []
    unusable: list[dict[str, Any]] = []
    pictures: ReplayPictures | None = None
    writer: _Writer | None = None
    tracked = False
    waiting: list[Frame] = []  # frames between the last session frame and the next, for interpolation
    try:
        for frame in capture:
            computed = frame.index // read.every % options.every == 0 or not reports
            if not computed:
                waiting.append(frame)
                continue
            try:
                if writer is None or pictures is None:
                    if not tracked:  # a frame that cannot start the session must not track its probes twice
                        positions = positions or (point_in_view(frame),)
                        for position in positions:
                            session.track(position)
                        tracked = True
                    report = session.push(frame)
                    _claim(out, intent, overwrite=options.overwrite)  # not before: a mistaken command leaves nothing
                    writer = _Writer(out, len(positions))
                    pictures = ReplayPictures(
                        out,
                        positions,
                        frame,
                        frame_count=capture.frame_count,
                        frames_per_second=capture.frames_per_second,
                        truths=_truths(capture, positions),
                        heading=f"{path.name}: light by the {session.model} model",
                    )
                else:
                    report = session.push(frame)
            except FrameError as error:
                unusable.append({"index": frame.index, "file": frame.source, "reason": str(error)})
                continue
            lights = session.lights()
            for between, mixed in writer.interpolated(waiting, frame, lights):
                pictures.add(between, mixed)
            waiting.clear()
            writer.write(frame, lights)
            pictures.add(frame, [light.panorama for light in lights])
            reports.append(report)
            done = frame.index // (read.every * stride) + 1
            if progress:
                progress(min(done, capture.frame_count), capture.frame_count)
        if writer is None or pictures is None:
            raise CaptureError(f"{path}: no frame can start a session; the first: {unusable[0]['reason']}")
        for frame in waiting:  # after the last session frame: nothing to interpolate towards, the light stays
            writer.hold(frame)
            pictures.add(frame, writer.held)
        pictures.close()
    except BaseException as error:
        if pictures is not None:
            pictures.abandon(error)
        raise
    if progress:
        progress(capture.frame_count, capture.frame_count)

    wall_s = time.perf_counter() - began
    interpolated = writer.count_interpolated
    report = _report(path, capture, session, reports, wall_s=wall_s, interpolated=interpolated, unusable=unusable)
    write_json(out / REPORT, report)
    return ReplayResult(out, report)


def _report(
    path: Path,
    capture: Capture,
    session: ReplaySession,
    reports: Sequence[FrameReport],
    *,
    wall_s: float,
    interpolated: int,
    unusable: list[dict[str, Any]],
) -> dict[str, Any]:
    """What `report.json` says of a finished replay."""
    return {
        "complete": True,
        "roomlight": __version__,
        "capture": {"path": str(path), "format": capture.format, "frames": capture.frame_count},
        "model": session.model,
        "probes": [
            {"position": list(light.position), "folder": f"probe-{n:02d}", "coverage": round(light.coverage, 4)}
            | ({} if session.grid and session.grid.contains(light.position) else {"outside_volume": True})
            for n, light in enumerate(session.lights())
        ],
        "keyframes": session.keyframes,
        "stage_ms_median": _medians(reports),
        "wall_s": round(wall_s, 3),
        "frames": [
            {
                "index": r.index,
                "keyframe": r.keyframe,
                "coverage": [round(c, 4) for c in r.coverage],
                "stage_ms": {k: round(v, 2) for k, v in r.stage_ms.items()},
            }
            for r in reports
        ],
        "interpolated": interpolated,
        "skipped": [asdict(s) for s in capture.skipped] + unusable,
    }


class _Writer:
    """Panoramas to EXR, one folder a probe; a file that is there already (an interrupted run's) is kept."""

    def __init__(self, out: Path, probes: int) -> None:
        self._folders = [out / f"probe-{n:02d}" for n in range(probes)]
        self._before: tuple[int, list[Float[np.ndarray, "h w 3"]]] | None = None
        self.count_interpolated = 0

    def write(self, frame: Frame, lights: Sequence[ReplayLight]) -> None:
        """One session frame."""
        self._before = (frame.index, [light.panorama for light in lights])
        for folder, light in zip(self._folders, lights, strict=True):
            coverage = f"{light.coverage:.4f}"
            self._save(folder, frame.index, light.panorama, {"roomlight:coverage": coverage})

    def interpolated(
        self, between: Sequence[Frame], frame: Frame, lights: Sequence[ReplayLight]
    ) -> Iterator[tuple[Frame, list[Float[np.ndarray, "h w 3"]]]]:
        """Write and yield the frames between the last session frame and this one."""
        if self._before is None:
            return
        start, panoramas = self._before
        for middle in between:
            share = np.float32((middle.index - start) / (frame.index - start))
            mixed = [(1 - share) * a + share * light.panorama for a, light in zip(panoramas, lights, strict=True)]
            self._save_interpolated(middle.index, mixed)
            yield middle, mixed

    @property
    def held(self) -> list[Float[np.ndarray, "h w 3"]]:
        """The last session frame's panoramas; none before the first."""
        return self._before[1] if self._before is not None else []

    def hold(self, frame: Frame) -> None:
        """A frame after the last session frame: the light stays as it was."""
        self._save_interpolated(frame.index, self.held)

    def _save_interpolated(self, index: int, panoramas: Sequence[Float[np.ndarray, "h w 3"]]) -> None:
        self.count_interpolated += 1
        for folder, panorama in zip(self._folders, panoramas, strict=True):
            self._save(folder, index, panorama, {"roomlight:interpolated": "true"})

    @staticmethod
    def _save(folder: Path, index: int, panorama: Float[np.ndarray, "h w 3"], metadata: dict[str, str]) -> None:
        path = folder / f"{index:06d}.exr"
        if not path.exists():
            write_exr(path, panorama, metadata=metadata)


def _capture_probes(capture: Capture) -> tuple[Position, ...]:
    if not capture.probes:
        raise CaptureError(f"{capture.path}: --probes-from-capture, but it names no probes; give --probe X,Y,Z")
    return tuple(probe.position for probe in capture.probes)


def _truths(capture: Capture, positions: Sequence[Position]) -> list[Float[np.ndarray, "h w 3"] | None]:
    """The capture's measured panoramas at these positions, None where it has none."""
    measured = {probe.position: probe for probe in capture.probes if probe.panorama_path is not None}
    return [measured[position].panorama() if position in measured else None for position in positions]


def _intent(path: Path, model: str, options: ReplayOptions) -> dict[str, Any]:
    """What makes two replays the same: everything but where the output goes."""
    described = {"roomlight": __version__, "capture": str(path.resolve()), "model": model}
    settings = asdict(options)
    settings.pop("overwrite")
    return json.loads(json.dumps({**described, "options": settings}, default=str))


def _refuse_foreign(out: Path, capture: Path, intent: dict[str, Any], *, overwrite: bool) -> None:
    """Raise OutputError if the folder holds something else, or cannot be looked into; changes nothing."""
    try:
        if out.exists() and not out.is_dir():
            raise OutputError(f"{out}: is a file; --out wants a folder")
        if out.resolve() == capture.resolve():
            raise OutputError(f"{out}: is the capture itself; choose another --out")
        if overwrite:
            return
        if (out / INTENT).is_file():
            if _held(out) != intent:
                raise OutputError(
                    f"{out}: holds another replay (see {INTENT}); choose another --out, or --overwrite it"
                )
        elif out.is_dir() and any(out.iterdir()):
            raise OutputError(f"{out}: is not empty and not a replay's; choose another --out, or --overwrite")
    except OSError as error:
        raise OutputError(f"{out}: cannot be used for output ({error.strerror or error})") from error


def _claim(out: Path, intent: dict[str, Any], *, overwrite: bool) -> None:
    """Take the folder for this replay: what an interrupted one of the same intent left stays, any other's files go.

    A finished one goes too: what it was made of (frames, weights) may have changed under the same names.
    """
    try:
        if overwrite or (out / REPORT).exists() or _held(out) != intent:
            for panorama in out.glob("probe-[0-9][0-9]*/[0-9][0-9][0-9][0-9][0-9][0-9]*.exr"):
                panorama.unlink()
            for folder in out.glob("probe-[0-9][0-9]*"):
                if folder.is_dir() and not any(folder.iterdir()):
                    folder.rmdir()
            for name in (REPORT, SUMMARY, FILM):
                (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be used for output ({error.strerror or error})") from error
    write_json(out / INTENT, intent)


def _held(out: Path) -> Any:
    """The intent of the replay in the folder; None without one, or without one that can be read."""
    try:
        return json.loads((out / INTENT).read_text())
    except (OSError, ValueError):
        return None


def _medians(reports: Sequence[FrameReport]) -> dict[str, float]:
    stages = {stage for report in reports for stage in report.stage_ms}
    return {
        stage: round(float(np.median([report.stage_ms.get(stage, 0.0) for report in reports])), 2)
        for stage in sorted(stages)
    }
