"""Replay of a recorded capture through a session: one HDR panorama per frame at each probe, pictures and a report.

The session is the engine here, or one on a server (`remote_session`): the loop is the same.

It writes `probe-00/light.000000.exr` ... (numbered by the capture's frame index, with timecode where the capture has
times), the same as a USD stage (`probe-00/light.usda`), `summary.png`, `replay.mp4` and, last of all, `report.json`: a
folder without it is unfinished. `replay.json` is written as soon as a frame has proved usable and says
what the folder is for (`replay_folder`): another command refuses to write there, and the same one goes on from the
state that was saved last (`saved_replay`), with the same bits as without the interruption.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from roomlight import __version__
from roomlight.captures import Capture, SkippedFrame, open_capture
from roomlight.conventions import Position
from roomlight.engine.session import FrameReport, Session
from roomlight.errors import CaptureError, FrameError
from roomlight.files import check_writable, write_atomic, write_json
from roomlight.frame import Frame
from roomlight.images import write_exr
from roomlight.imaging.exr import sequence_metadata
from roomlight.light.light import ENDINGS, Light
from roomlight.light.sources import LightUse
from roomlight.light.usd import sequence_stage
from roomlight.notes import Note
from roomlight.placement import point_at_pixel, point_in_view
from roomlight.threads import read_ahead
from roomlight_cli.console import counted
from roomlight_cli.replays.inserted_spheres import printed
from roomlight_cli.replays.pictures import PicturesState, ReplayPictures, video_rate
from roomlight_cli.replays.remote_session import RemoteSession
from roomlight_cli.replays.replay_folder import INTENT, REPORT, claim, describe_intent, fingerprint, refuse_foreign
from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_cli.replays.saved_replay import FOLDER, ReplayState, forget_replay, is_due, load_replay, save_replay
from roomlight_client import Client, RecoveryEvent

AnySession = Session | RemoteSession
ProgressCallback = Callable[[str, int, int], None]
"""Called with (what is being done, frames done, frames in all)."""


def replay(
    path: Path,
    out: Path,
    options: ReplayOptions,
    *,
    token: str | None = None,
    progress: ProgressCallback | None = None,
    on_recovery: Callable[[RecoveryEvent], object] | None = None,
) -> dict[str, Any]:
    """Replay a capture into a folder; return the report as written.

    The next call with the same arguments after an interruption goes on, if the engine is here. A finished replay is
    made again (`replay_folder.finished_report` tells beforehand that it would be the same). With a server the replay
    waits while that is away.

    Args:
        path: The capture.
        out: The folder.
        options: What to replay.
        token: Of the server of the options.
        progress: Is told how far the replay is.
        on_recovery: Is told that the server is away, or back.

    Raises:
        CaptureError: The capture cannot be read, or no frame of it can start a session.
        OptionError: An option is out of range, or a pixel lies outside the first image.
        ProbeError: There is no depth to place a point by.
        ModelError: The weights cannot be used.
        OutputError: `out` holds something else, or cannot be written.
        RemoteError: The server fails or refuses.
    """
    if options.server is None:
        return _replay(path, out, options, None, progress)
    with (
        Client(options.server, token=token, on_recovery=on_recovery) as client,
        RemoteSession(client, options.session) as session,
    ):
        return _replay(path, out, options, session, progress)


def _replay(
    path: Path,
    out: Path,
    options: ReplayOptions,
    remote: RemoteSession | None,
    progress: ProgressCallback | None,
) -> dict[str, Any]:
    read = options.capture
    stride = 1 if options.interpolate else options.every
    capture = open_capture(path, replace(read, every=read.every * stride))
    if progress:
        capture.prepare(progress)
    session = remote or Session(options.session)
    intent = describe_intent(path, session.model, options)
    refuse_foreign(out, capture.path, intent, overwrite=options.overwrite)
    check_writable(out / INTENT)
    inputs = fingerprint(capture.path, out, options)["inputs"]
    stopped = remote is None and not options.overwrite and not (out / REPORT).exists()
    saved = load_replay(out, inputs, options.session) if stopped else None
    state, session = saved or (ReplayState(inputs), session)

    began = time.perf_counter() - state.wall_s
    run: _Run | None = None
    waiting: list[Frame] = []  # frames between the last session frame and the next, for interpolation, as printed
    try:
        if saved is not None:
            run = _Run(out, capture, session, options, state, step=read.every * stride)
            if progress:
                progress("replaying", min(run.done, capture.frame_count), capture.frame_count)
        for frame, passed in read_ahead((frame, capture.passed()) for frame in capture.frames(state.passed)):
            if run is not None and frame.index // read.every % options.every:
                waiting.append(printed(frame))
                continue
            try:
                if not state.positions:  # a frame that cannot start the session must not track its probes twice
                    state.positions = _positions(capture, frame, options)
                    for position in state.positions:
                        session.track(position)
                report = session.push(frame)
            except FrameError as error:
                state.unusable.append(SkippedFrame(frame.index, frame.source, str(error)))
                continue
            if run is None:
                grid = session.grid
                state.inside = tuple(grid is not None and grid.contains(position) for position in state.positions)
                state.pictures = PicturesState.of(frame, state.positions)
                claim(out, intent)  # only now: a mistaken command leaves nothing
                run = _Run(out, capture, session, options, state, step=read.every * stride)
            run.add(waiting, frame, report)
            waiting.clear()
            if passed is not None and (state.passed is None or is_due(len(state.reports))):
                state.passed, state.wall_s = passed, time.perf_counter() - began
                state.pictures = run.pictures.end_part()
                if isinstance(session, Session):
                    save_replay(out, state, session)
            if progress:
                progress("replaying", min(run.done, capture.frame_count), capture.frame_count)
        if run is None:
            raise CaptureError(f"{path}: no frame can start a session; the first: {state.unusable[0].reason}")
        if progress:
            progress("drawing the summary after frame", capture.frame_count, capture.frame_count)
        run.close(waiting)
    except BaseException as error:
        if run is not None:
            run.pictures.abandon(error)
        raise
    state.wall_s = time.perf_counter() - began
    report = _report(path, capture, session, state, capture.pixel_notes() if options.pixels else [])
    report["fingerprint"] = fingerprint(capture.path, out, options)
    write_json(out / REPORT, report)
    forget_replay(out)
    return report


class _Run:
    """A replay from its first usable frame on: its panoramas, in a folder a probe, and pictures."""

    def __init__(
        self,
        out: Path,
        capture: Capture,
        session: AnySession,
        options: ReplayOptions,
        state: ReplayState,
        *,
        step: int,
    ) -> None:
        """Begin with the first frame, or go on; a computed or interpolated frame is `step` indices after the last."""
        assert state.pictures is not None
        self._session, self._options, self._state, self._step = session, options, state, step
        self._folders = [out / f"probe-{n:02d}" for n in range(len(state.positions))]
        self._rate = capture.film_rate * step  # at which indices count
        self._index, self._lights = 0, list[Light]()  # of the last session frame
        if state.reports:
            self._index, self._lights = state.reports[-1].index, session.lights()
        frames = counted(capture.frame_count, "frame")
        self.pictures = ReplayPictures(
            out,
            state.positions,
            state.pictures,
            parts=out / FOLDER,
            capture=capture,
            subtitle=f"Light estimated by RoomLight from {frames}, model {session.model}",
        )

    @property
    def done(self) -> int:
        """Number of the capture's frames that are done."""
        return self._state.reports[-1].index // self._step + 1

    def add(self, waiting: Sequence[Frame], frame: Frame, report: FrameReport) -> None:
        """Write and draw the light after a frame, and the interpolated light of those before it."""
        lights = self._session.lights()
        for between in waiting:
            share = np.float32((between.index - self._index) / (frame.index - self._index))

            def mixed(use: LightUse, share: np.float32 = share) -> list[Float[np.ndarray, "h w 3"]]:
                pairs = zip(panoramas_of(self._lights, use), panoramas_of(lights, use), strict=True)
                return [(1 - share) * old + share * new for old, new in pairs]

            self._add_between(between, mixed)
        self._index, self._lights = frame.index, lights
        coverage = [light.coverage for light in lights]
        red, green, blue = (float(f"{value / frame.exposure:.6g}") for value in report.gain)
        report = replace(report, gain=(red, green, blue))  # from the recorded frame, not from the reference exposure
        gain = {"roomlight:gain": f"{red:g} {green:g} {blue:g}"}
        notes = [{"roomlight:coverage": f"{share:.4f}"} | gain for share in coverage]
        self._write(frame.index, panoramas_of(lights, self._options.use), notes)
        reflections = panoramas_of(lights, "reflection")
        self.pictures.add(frame, reflections, coverage, [light.observed for light in lights])
        self._state.reports.append(report)

    def _add_between(self, frame: Frame, panoramas: Callable[[LightUse], list[Float[np.ndarray, "h w 3"]]]) -> None:
        """Write and draw the light of a frame that is no session frame."""
        self._state.interpolated += 1
        notes = [{"roomlight:interpolated": "true"} for _ in self._folders]
        self._write(frame.index, panoramas(self._options.use), notes)
        self.pictures.add(frame, panoramas("reflection"), observed=[light.observed for light in self._lights])

    def _write(
        self, index: int, panoramas: Sequence[Float[np.ndarray, "h w 3"]], notes: Sequence[dict[str, str]]
    ) -> None:
        self._state.written.append(index)
        for folder, panorama, note in zip(self._folders, panoramas, notes, strict=True):
            metadata = sequence_metadata(index, self._rate) | note | {"roomlight:use": self._options.use}
            write_exr(folder / _name(index), panorama, metadata=metadata)

    def close(self, waiting: Sequence[Frame]) -> None:
        """Write the frames after the last session frame, and what is made of all: stages, other forms, pictures."""
        for frame in waiting:  # there is nothing to interpolate towards: the light stays
            self._add_between(frame, partial(panoramas_of, self._lights))
        names = {index: _name(index) for index in self._state.written}
        for folder, position, light in zip(self._folders, self._state.positions, self._lights, strict=True):
            stage = sequence_stage(position, names, self._rate)
            write_atomic(folder / "light.usda", stage.encode())
            for form in self._options.forms:
                light.used_for(self._options.use).save(folder / f"light{ENDINGS[form]}")
        self.pictures.close(self._session if isinstance(self._session, Session) else None)


def _report(
    path: Path, capture: Capture, session: AnySession, state: ReplayState, pixel_notes: list[Note]
) -> dict[str, Any]:
    """Return the values of `report.json`, without the fingerprint."""
    reports, last = state.reports, session.grid
    written, rate = state.written, video_rate(capture.film_rate)
    pace = capture.pace_note(len(written), written[0], written[-1], rate=rate)
    return {
        "complete": True,
        "roomlight": __version__,
        "capture": {"path": str(path), "format": capture.format, "frames": capture.frame_count},
        "model": session.model,
        "probes": [
            {"position": list(light.position), "folder": f"probe-{n:02d}", "coverage": round(light.coverage, 4)}
            | ({} if inside or (last is not None and last.contains(light.position)) else {"outside_volume": True})
            for n, (light, inside) in enumerate(zip(session.lights(), state.inside, strict=True))
        ],
        "keyframes": session.keyframes,
        "stage_ms_median": _medians(reports),
        "wall_s": round(state.wall_s, 3),
        "frames": [
            {
                "index": r.index,
                "keyframe": r.keyframe,
                "coverage": [round(c, 4) for c in r.coverage],
                "gain": list(r.gain),
                "stage_ms": {k: round(v, 2) for k, v in r.stage_ms.items()},
            }
            for r in reports
        ],
        "interpolated": state.interpolated,
        "skipped": [asdict(skipped) for skipped in (*capture.skipped, *state.unusable)],
        "notes": [asdict(note) for note in (*capture.notes, *pixel_notes, *([pace] if pace else ()))],
    }


def _name(index: int) -> str:
    return f"light.{index:06d}.exr"


def panoramas_of(lights: Sequence[Light], use: LightUse) -> list[Float[np.ndarray, "h w 3"]]:
    """Return the panorama of each light for a use."""
    return [light.panorama if use == "lighting" else light.reflection for light in lights]


def _positions(capture: Capture, first: Frame, options: ReplayOptions) -> tuple[Position, ...]:
    """Return the probes of the capture or of the options, which place some by the first frame; at least one."""
    if options.probes_from_capture:
        if not capture.probes:
            raise CaptureError(f"{capture.path}: has no probes of its own; place them with --probe or --pixel")
        return tuple(probe.position for probe in capture.probes)
    picked = (point_at_pixel(first, u, v, above_m=options.above_m) for u, v in options.pixels)
    return (*options.probes, *picked) or (point_in_view(first),)


def _medians(reports: Sequence[FrameReport]) -> dict[str, float]:
    stages = {stage for report in reports for stage in report.stage_ms}
    return {
        stage: round(float(np.median([report.stage_ms.get(stage, 0.0) for report in reports])), 2)
        for stage in sorted(stages)
    }
