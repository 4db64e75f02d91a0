"""Estimated camera poses scored on captures that have poses, and the light that follows from them.

The pictures of a capture become a video without anything else, which is read as any video (`captures.bare_video`). Its
cameras are compared with the capture's in the first camera's axes, so that which way the world is turned does not
count; its up direction is compared apart. Light at the capture's probes, seen at the same pixels of a picture,
is compared with that by the capture's own depth and poses.
"""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float
from rich.table import Table

from roomlight.camera import rigid_inverse
from roomlight.captures import Capture, CaptureOptions, open_capture
from roomlight.captures.photo import read_photo
from roomlight.conventions import Position, linear_to_srgb8, panorama_directions
from roomlight.engine.preparation import WORKING_SIZE
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import CaptureError
from roomlight.frame import Frame
from roomlight.images import write_png
from roomlight.imaging.tables import figure_table
from roomlight.imaging.video_writer import VideoWriter
from roomlight.metrics import log_l2
from roomlight.spheres import radiance_along, resize_panorama
from roomlight_evaluation.captures.evaluation import ProgressCallback, capture_names

_RATE: Final = 5.0
"""Frames a second of captures without timestamps."""
_PHOTOS: Final = 3
"""Pictures of a capture that are read as photographs."""
_UNITS: Final = (
    "placed: share of frames; focal: relative error; turn, horizon, photo: degrees; shift: share of the path's reach; "
    "scale: true / estimated; light: log-L2 / that by exact poses and depth"
)


@dataclass(frozen=True)
class PoseScore:
    """Scores of one capture.

    Attributes:
        frames: In the video, as many as are used.
        placed: Share of them that have poses.
        fov_error: Relative error of the focal length.
        turn_deg: Error of the rotation to the first camera: median over frames.
        worst_turn_deg: Likewise, the largest.
        shift: Error of the place after the best scale, relative to the farthest camera's distance: root mean square;
            None if the camera moves by less than 10 cm.
        scale: True size of the path relative to the estimated one.
        horizon_deg: Error of the up direction.
        photo_deg: Likewise of single pictures as photographs, which may say that they do not know.
        light: log-L2 of light by estimated poses and depth, and by the capture's own; None without true panoramas of
            places in view.
    """

    capture: str
    frames: int
    placed: float
    fov_error: float
    turn_deg: float
    worst_turn_deg: float
    shift: float | None
    scale: float | None
    horizon_deg: float
    photo_deg: tuple[float, ...]
    light: tuple[float, float] | None


@dataclass(frozen=True)
class PoseScores:
    """Scores of several captures."""

    scores: tuple[PoseScore, ...]

    def table(self) -> Table:
        """Return a row for each capture, the median and the worst."""
        columns = ["placed", "focal", "turn", "worst turn", "shift", "scale", "horizon", "photo", "light"]
        names, values = [score.capture for score in self.scores], np.array([_figures(score) for score in self.scores])
        if len(names) > 1:
            worst = np.nanmax(values, axis=0)
            worst[0] = values[:, 0].min()
            names, values = [*names, "median", "worst"], np.vstack([values, np.nanmedian(values, axis=0), worst])
        rows = ([name, *(f"{value:.3g}" for value in row)] for name, row in zip(names, values, strict=True))
        return figure_table("estimated poses", columns, rows, caption=_UNITS)

    def to_json(self) -> dict[str, Any]:
        """Return all scores as plain JSON values."""
        return asdict(self)


def evaluate_poses(
    captures: Sequence[Path],
    light: SessionOptions,
    reading: CaptureOptions,
    *,
    progress: ProgressCallback | None = None,
) -> PoseScores:
    """Score the estimated poses of captures, and their light.

    Args:
        captures: Captures with poses and depth.
        reading: How captures are read; `fov_deg`, `depth_model`: how the videos are.

    Raises:
        CaptureError: A capture cannot be read, or has no depth; no camera of its video can be placed; two captures have
            one name.
        OptionError: A capture is a video without poses.
        ModelError: A model cannot be used.
    """
    scores: list[PoseScore] = []
    for done, (name, path) in enumerate(zip(capture_names(captures), captures, strict=True), 1):
        capture = open_capture(path, replace(reading, fov_deg=None, depth="file", depth_model=None))
        with tempfile.TemporaryDirectory() as folder:
            scores.append(_score(name, capture, Path(folder), light, reading))
        if progress is not None:
            progress(name, done, len(captures))
    if not scores:
        raise CaptureError("no capture is given to score")
    return PoseScores(tuple(scores))


def _score(name: str, capture: Capture, folder: Path, light: SessionOptions, reading: CaptureOptions) -> PoseScore:
    rate, apart = capture.frames_per_second or _RATE, max(1, capture.frame_count // _PHOTOS)
    frames: list[Frame] = []
    photos_deg: list[float] = []
    with VideoWriter(folder / "video.mp4", frames_per_second=rate) as writer:
        for number, frame in enumerate(capture):
            writer.write(linear_to_srgb8(np.clip(frame.image, 0, 1)))
            if number % apart == 0 and len(photos_deg) < _PHOTOS:
                photos_deg.append(_photo_deg(frame, folder))
            frames.append(frame.resized(*WORKING_SIZE))  # as sessions take them: pictures as they are fill the memory
    video = open_capture(folder / "video.mp4", CaptureOptions(fov_deg=reading.fov_deg, depth_model=reading.depth_model))
    placed = [frame.resized(*WORKING_SIZE) for frame in video]
    pairs = [(frames[round((frame.timestamp_s or 0) * rate)], frame) for frame in placed]
    true, estimated = _relative([frame for frame, _ in pairs]), _relative(placed)
    turns = [rotation_deg(a[:3, :3], b[:3, :3]) for a, b in zip(true, estimated, strict=True)][1:] or [0.0]
    far = float(np.linalg.norm(true[:, :3, 3], axis=1).max())
    shift = scale = None
    if far > 0.1:
        a, b = true[:, :3, 3], estimated[:, :3, 3]
        scale = float((a * b).sum() / max((b * b).sum(), 1e-9))
        shift = float(np.sqrt(((a - scale * b) ** 2).sum(axis=1).mean())) / far
    horizon = np.median([_horizon_deg(a, b) for a, b in pairs])
    return PoseScore(
        capture=name,
        frames=video.frame_count,
        placed=len(placed) / video.frame_count,
        fov_error=placed[0].intrinsics.fx / frames[0].intrinsics.fx - 1,
        turn_deg=float(np.median(turns)),
        worst_turn_deg=float(np.max(turns)),
        shift=shift,
        scale=scale,
        horizon_deg=float(horizon),
        photo_deg=tuple(photos_deg),
        light=_light(capture, [a for a, _ in pairs], placed, light),
    )


def _relative(frames: Sequence[Frame]) -> Float[np.ndarray, "n 4 4"]:
    """Return the poses in the first camera's axes."""
    to_first = rigid_inverse(frames[0].camera_to_world)
    return np.stack([to_first @ frame.camera_to_world for frame in frames])


def rotation_deg(first: Float[np.ndarray, "3 3"], second: Float[np.ndarray, "3 3"]) -> float:
    """Return the angle of the rotation from one to the other."""
    return math.degrees(float(np.linalg.norm(cv2.Rodrigues(first.T @ second)[0])))


def _horizon_deg(true: Frame, estimated: Frame) -> float:
    cosine = true.camera_to_world[1, :3] @ estimated.camera_to_world[1, :3]
    return math.degrees(math.acos(min(1.0, max(-1.0, float(cosine)))))


def _photo_deg(frame: Frame, folder: Path) -> float:
    write_png(folder / "photo.png", linear_to_srgb8(np.clip(frame.image, 0, 1)))
    return _horizon_deg(frame, read_photo(folder / "photo.png").frame)


def _light(
    capture: Capture, exact: list[Frame], estimated: list[Frame], options: SessionOptions
) -> tuple[float, float] | None:
    """Return the mean errors of light at the capture's probes: by estimated and by exact poses and depth."""
    if not capture.truths:
        return None
    sessions = Session(options), Session(options)
    for frames, session in zip((estimated, exact), sessions, strict=True):
        for frame in frames:
            session.push(frame)
    turn = exact[0].camera_to_world[:3, :3] @ estimated[0].camera_to_world[:3, :3].T
    errors: list[tuple[float, float]] = []
    for probe in capture.truths:
        position = np.array(probe.position)
        seen = next((pair for pair in zip(exact, estimated, strict=True) if _in_view(position, pair[0])), None)
        place = None if seen is None else _same_place(position, *seen)
        if place is None:
            continue
        truth = probe.panorama()
        guessed = turned(sessions[0].light_at(place).reflection, turn)
        known = sessions[1].light_at(probe.position).reflection
        first, second = (log_l2(resize_panorama(light, len(truth)), truth) for light in (guessed, known))
        errors.append((first, second))
    if not errors:
        return None
    first, second = np.mean(errors, axis=0).tolist()
    return first, second


def _in_view(position: Float[np.ndarray, "3"], frame: Frame) -> bool:
    local = frame.camera_to_world[:3, :3].T @ (position - frame.camera_to_world[:3, 3])
    pixel = frame.intrinsics.project(local[None])[0][0]
    size = np.array([frame.intrinsics.width, frame.intrinsics.height])
    return bool(((pixel >= 0) & (pixel < size)).all())  # NaN behind the camera


def _same_place(position: Float[np.ndarray, "3"], exact: Frame, estimated: Frame) -> Position | None:
    """Return the point at the same pixel, as far before the surface, in the estimated world; None without depth."""
    local = exact.camera_to_world[:3, :3].T @ (position - exact.camera_to_world[:3, 3])
    pixel = exact.intrinsics.project(local[None])[0][0]
    depths: list[float] = []
    for frame in (exact, estimated):
        height, width = frame.depth_m.shape
        column = int(np.clip(pixel[0] * width / exact.intrinsics.width, 2, width - 3))
        row = int(np.clip(pixel[1] * height / exact.intrinsics.height, 2, height - 3))
        depths.append(float(np.median(frame.depth_m[row - 2 : row + 3, column - 2 : column + 3])))
    if min(depths) <= 0:
        return None
    lens, far = estimated.intrinsics, -local[2] * depths[1] / depths[0]
    ray = np.array([(pixel[0] - lens.cx) / lens.fx, (lens.cy - pixel[1]) / lens.fy, -1.0])
    x, y, z = (estimated.camera_to_world[:3, :3] @ (far * ray) + estimated.camera_to_world[:3, 3]).tolist()
    return x, y, z


def turned(panorama: Float[np.ndarray, "h w 3"], turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "h w 3"]:
    """Return a panorama of another world's axes; `turn` maps its directions to the new ones."""
    return radiance_along(panorama, panorama_directions(len(panorama)) @ turn)


def _figures(score: PoseScore) -> list[float]:
    return [
        score.placed,
        abs(score.fov_error),
        score.turn_deg,
        score.worst_turn_deg,
        math.nan if score.shift is None else score.shift,
        math.nan if score.scale is None else score.scale,
        score.horizon_deg,
        float(np.median(score.photo_deg)),
        math.nan if score.light is None else score.light[0] / score.light[1],
    ]
