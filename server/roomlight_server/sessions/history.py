"""The history of a session: what each processed frame did to the light, within a fixed memory.

When the history is full, every second entry is removed, and from then on only every second frame is recorded. So it
always covers the whole stream at equal steps.
"""

import asyncio
import logging
import secrets
import time
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import FrameReport, Session
from roomlight.frame import Frame
from roomlight.light.encode import to_hdr
from roomlight.light.light import Light
from roomlight.spheres import resize_panorama
from roomlight.wire.frame_message import column_major
from roomlight.wire.messages import FrameCounts
from roomlight.wire.room import CameraPose, HistoryEntry, HistoryLight, HistoryList, HistoryProbe
from roomlight_server.base.problems import ProblemError
from roomlight_server.work.workers import Workers

_log = logging.getLogger("roomlight.server")
NamedLights = dict[str, Light] | None
"""Lights of named probes; None of a frame that is not recorded."""
THUMBNAIL_PX: Final = 160
"""Long side of a recorded picture: 4 kB of JPEG."""
PANORAMA_ROWS: Final = 32
"""Rows of a recorded panorama: 8 kB of Radiance HDR, enough for a mirror sphere 60 pixels wide."""
MAX_DRAWING: Final = 8
"""Frames of a session whose pictures are being made; beyond it, a frame is recorded without pictures."""
_JPEG_QUALITY: Final = 80
_ENTRY_BYTES: Final = 4096
"""Memory of an entry's numbers, with up to 12 stages."""
_PROBE_BYTES: Final = 2048
"""Memory of a probe's numbers in an entry."""


@dataclass(eq=False)
class _Moment:
    entry: HistoryEntry
    pose: CameraPose
    kept: bool = True
    pictures: asyncio.Task[None] | None = None
    colour: bytes = b""
    panoramas: dict[str, bytes] = field(default_factory=dict[str, bytes])

    @property
    def size(self) -> int:
        numbers = _ENTRY_BYTES + _PROBE_BYTES * len(self.entry.probes)
        return numbers + len(self.colour) + sum(map(len, self.panoramas.values()))


class History:
    """The recorded frames of a session. Used on the event loop; pictures are made on decoding threads."""

    def __init__(self, limit_bytes: int, workers: Workers) -> None:
        """Create an empty history of at most `limit_bytes`; 0 records nothing."""
        self._limit_bytes, self._workers = limit_bytes, workers
        self._moments: list[_Moment] = []
        self.size = 0
        """Memory of all entries in bytes."""
        self._stride, self._frames, self._start_s = 1, 0, 0.0
        self._drawing = 0
        self.key = secrets.token_hex(4)
        """Differs between sessions of the same id, for ETags."""

    def next_handles(self, handles: dict[str, int]) -> dict[str, int] | None:
        """Return the handles of probes whose lights `add` wants of the next frame; None: it will not record it."""
        return None if self._limit_bytes == 0 or self._frames % self._stride else handles

    def add(self, frame: Frame, report: FrameReport, counts: FrameCounts, lights: NamedLights) -> None:
        """Record a processed frame; a failure is logged and harms nothing else.

        Args:
            counts: Counts of the session's frames before this one.
            lights: Of the named probes, by `lights_for_history`; None: the frame is not recorded.
        """
        between = self._frames % self._stride  # pictures may have filled the history since `next_handles`
        self._frames += 1
        if lights is None or between:
            return
        now_s = time.monotonic()
        if not self._moments:
            self._start_s = now_s
        try:
            moment = _moment_of(frame, report, counts, lights, round(now_s - self._start_s, 3))
        except Exception:
            _log.exception("frame not recorded", extra={"frame": frame.index})
            return
        if self._drawing < MAX_DRAWING:
            self._drawing += 1
            moment.pictures = asyncio.create_task(self._draw(moment, frame, lights))
        self._moments.append(moment)
        self.size += moment.size
        self._thin()

    async def _draw(self, moment: _Moment, frame: Frame, lights: dict[str, Light]) -> None:
        bare = moment.size
        try:
            moment.colour, moment.panoramas = await self._workers.run_in_encode_pool(_pictures, frame.image, lights)
        except Exception:
            _log.exception("history has no pictures of a frame", extra={"frame": frame.index})
        finally:
            self._drawing -= 1
        if moment.kept:
            self.size += moment.size - bare
            self._thin()

    def _thin(self) -> None:
        while self._moments and self.size > self._limit_bytes:
            self._stride *= 2
            self._keep(self._moments[::2] if len(self._moments) > 1 else [])

    def _keep(self, moments: list[_Moment]) -> None:
        for moment in self._moments:
            moment.kept = False
        for moment in moments:
            moment.kept = True
        self._moments, self.size = moments, sum(moment.size for moment in moments)

    def listed(self, after: int) -> HistoryList:
        """Return the entries of frames with an index above `after`, in order."""
        return HistoryList(
            stride=self._stride,
            bytes=self.size,
            limit_bytes=self._limit_bytes,
            entries=[moment.entry for moment in self._moments if moment.entry.index > after],
        )

    def path(self) -> list[CameraPose]:
        """Return the camera of each recorded frame, in order."""
        return [moment.pose for moment in self._moments]

    async def picture(self, index: int, probe: str | None = None) -> bytes:
        """Return the JPEG of a recorded frame, or the Radiance HDR panorama of a named probe after it.

        Raises:
            ProblemError: The frame, or the probe at this frame, is not in the history (404).
        """
        moment = next((moment for moment in self._moments if moment.entry.index == index), None)
        if moment is not None and moment.pictures is not None:
            await asyncio.shield(moment.pictures)
        data = b"" if moment is None else moment.colour if probe is None else moment.panoramas.get(probe, b"")
        if not data:
            named = "" if probe is None else f" with the probe {probe!r}"
            detail = f"the history has no frame {index}{named}; read the entries again, it may have been thinned out"
            raise ProblemError("history-not-found", detail, field="index", value=index)
        return data

    def clear(self) -> None:
        """Forget all entries."""
        self._keep([])


def lights_for_history(engine: Session, handles: dict[str, int] | None) -> NamedLights:
    """Return the lights of named probes after a frame; None if it is not recorded, or if they fail (logged)."""
    if handles is None:
        return None
    try:
        return _lights(engine, handles)
    except Exception:
        _log.exception("lights not recorded")
        return None


def _lights(engine: Session, handles: dict[str, int]) -> dict[str, Light]:
    return {name: engine.light(handle).used_for("reflection") for name, handle in handles.items()}


def _moment_of(
    frame: Frame, report: FrameReport, counts: FrameCounts, lights: dict[str, Light], seconds: float
) -> _Moment:
    probes = [
        HistoryProbe(
            name=name,
            position=list(light.position),
            coverage=round(light.coverage, 4),
            lights=[HistoryLight.model_validate(source.to_json()) for source in light.lights],
        )
        for name, light in lights.items()
    ]
    entry = HistoryEntry(
        index=frame.index,
        seconds=seconds,
        timestamp_s=frame.timestamp_s,
        keyframe=report.keyframe,
        stage_ms={stage: round(ms, 2) for stage, ms in report.stage_ms.items()},
        superseded=counts.superseded,
        gaps=counts.gaps,
        skipped=counts.skipped,
        refused=counts.refused,
        probes=probes,
    )
    pose = column_major(frame.camera_to_world)
    return _Moment(entry, CameraPose(index=frame.index, seconds=seconds, camera_to_world=pose))


def _pictures(image: Float[np.ndarray, "h w 3"], lights: dict[str, Light]) -> tuple[bytes, dict[str, bytes]]:
    """Return the thumbnail (JPEG) of an image of linear RGB, and the panorama (Radiance HDR) of each light."""
    height, width = image.shape[:2]
    scale = min(1.0, THUMBNAIL_PX / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    small = linear_to_srgb8(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(small[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    panoramas = {
        name: to_hdr(resize_panorama(light.panorama, min(PANORAMA_ROWS, len(light.panorama))))
        for name, light in lights.items()
    }
    return jpeg.tobytes(), panoramas
