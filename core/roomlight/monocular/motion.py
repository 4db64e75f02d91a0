"""Where a video's camera was, from its pictures alone.

Features of each picture are matched with those of earlier ones or followed from the last one, and the picture is placed
by their estimated depth (PnP). In the end all cameras are adjusted together, also to pictures that show the same place
again, and turned upright by the room's straight lines. The world is that of the first camera, turned upright; metres
are the depth network's. A camera that only turns is the usual case, and needs no parallax.

A picture that cannot be tied to the others is lost; after a cut the longest piece counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int

from roomlight.camera import Intrinsics, rigid_inverse
from roomlight.conventions import OPENCV_TO_OPENGL, rotation_to_y_up
from roomlight.monocular.adjustment import Cameras, Sightings, adjusted, in_metres, reprojection_errors
from roomlight.monocular.estimate import DepthModel
from roomlight.monocular.features import SIDE, Features, FeatureTracker, matched
from roomlight.monocular.horizon import Lines, Upright, lines_of, upright
from roomlight.monocular.tracks import grey_picture

_LEAST_FEATURES: Final = 40
_LEAST_MATCHES: Final = 30
"""Of two pictures. With fewer, on blinds or plain walls, cameras came out 10 degrees off."""
_PLACING_PX, _MATCH_PX = 8.0, 2.0
"""Errors in pixels of a 640-pixel picture: of a placed feature, whose depth is estimated, and of a match."""
_BEFORE: Final = (1, 2, 3, 5, 8)
"""Pictures before one with which it is compared."""
_RETRIED: Final = 8
"""Earlier pictures, spread out, with which one is compared that shows nothing of the last ones."""
_MOST_MATCHES: Final = 70
"""Of two pictures, in the adjustment."""
_LOOPS: Final = 4
_LOOP_GAP, _LOOP_DEG = 12, 30.0
"""Pictures that far apart in time whose cameras look the same way are compared, so many for each."""
_LEAST_SIGHTINGS: Final = 40
"""Of a picture after the adjustment: one with 29 was turned wrong by 26 degrees, others had 79 and more."""
MISFIT_PX: Final = 0.8
"""Median error of a picture's features after the adjustment. In walks that were turned right to a degree the worst
picture had 0.3 to 0.7; in those turned wrong by 5 to 37 degrees 0.9 to 1.6. It tells little of compressed films of
320 x 240 pixels: 0.7 to 0.95 also at 0.5 to 3 degrees, 0.72 at 10."""
_AGAIN: Final = 3
"""Most times that cameras are placed and adjusted once more."""
_DEPTH_ERROR_FIRST: Final = 0.25
_DEPTH_ERROR: Final = 2.0
"""Relative error of the network's depth from place to place in a picture: as it is, where the adjustment begins; and
where it ends, because the errors of neighbours are alike, and so many of them would outweigh parallax."""
_DARK: Final = 24
"""Grey level of a picture's brightest percent below which it is called dark."""
_OUTLIER_PX: Final = 5.0
_KNOWN_FOCAL, _GUESSED_FOCAL = 0.01, 0.12
"""Relative errors of a focal length that is stated, and of one that is assumed."""


@dataclass(frozen=True)
class CameraPath:
    """The cameras of a video.

    Attributes:
        poses: By number of the picture: camera to world, OpenGL axes, metres, y up.
        intrinsics: For pictures of the size that was given.
        lost: By number of the picture: why it has no pose.
        upright: How the up direction was estimated, in the first camera's axes.
        misfits: Numbers of pictures that fit the others badly; their turns may be off.
    """

    poses: dict[int, Float[np.ndarray, "4 4"]]
    intrinsics: Intrinsics
    lost: dict[int, str]
    upright: Upright
    misfits: tuple[int, ...] = ()


@dataclass(eq=False)
class Still:
    """A picture's features; camera to world in OpenCV axes, once it is placed."""

    number: int
    features: Features
    pixels: Float32[np.ndarray, "n 2"]  # relative to the principal point
    depth_m: Float[np.ndarray, " n"]
    lines: Lines
    turn: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    centre: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    sightings: int = 0  # that agree with its adjusted camera
    error_px: float = 0.0  # their median, of a 640-pixel picture


class Lost(NamedTuple):
    """A picture that cannot be placed, and why."""

    number: int
    reason: str


class _Match(NamedTuple):
    first: int
    second: int
    features: Int[np.ndarray, "n 2"]


class CameraMotion:
    """Collects the pictures of a video in order; `path` places their cameras.

    Examples:
        motion = CameraMotion(shipped_depth(), intrinsics, focal_is_known=False)
        for number, picture in enumerate(pictures):
            motion.place(motion.described(number, picture))
        poses = motion.path().poses
    """

    def __init__(self, model: DepthModel, intrinsics: Intrinsics, *, focal_is_known: bool) -> None:
        """Take the metric depth model and the camera of the pictures.

        Args:
            model: Of kind "metric".
            intrinsics: For pictures of the size that is given to `described`.
            focal_is_known: Whether the focal length is stated; otherwise it is adjusted to the motion.
        """
        self._model, self._intrinsics, self._known = model, intrinsics, focal_is_known
        self._focal = intrinsics.fx
        self._unit = max(intrinsics.width, intrinsics.height) / SIDE
        self._tracker = FeatureTracker()
        self._pieces: list[list[Still]] = []
        self._matches: dict[int, list[_Match]] = {}
        self._lost: dict[int, str] = {}

    @property
    def _camera(self) -> Float[np.ndarray, "3 3"]:
        """K for pixels relative to the principal point."""
        return np.diag([self._focal, self._focal, 1.0])

    def described(self, number: int, picture: Float32[np.ndarray, "h w 3"]) -> Still | Lost:
        """Return what the next sRGB picture in [0, 1] shows, under its number.

        `place` takes it, in order, also while the next one is described.

        Raises:
            ModelError: The depth model fails.
        """
        grey = grey_picture(picture)
        if np.percentile(grey, 99) < _DARK:
            return Lost(number, "is too dark to see the room")
        features = self._tracker.features(grey)
        corners = features.pixels
        if len(corners) < _LEAST_FEATURES:
            return Lost(number, "shows too little detail to follow: it is blurred, or shows a bare wall")
        estimated = self._model.estimate(picture, self._intrinsics).resized(grey.shape[1], grey.shape[0])
        columns, rows = np.floor(corners).astype(int).T
        inverse = estimated.inverse[rows.clip(0, grey.shape[0] - 1), columns.clip(0, grey.shape[1] - 1)]
        return Still(
            number,
            features,
            corners - np.array([self._intrinsics.cx, self._intrinsics.cy], np.float32),
            1 / np.clip(inverse, 0.02, 20).astype(np.float64),
            lines_of(grey, self._intrinsics),
        )

    def place(self, still: Still | Lost) -> None:
        """Place the camera of a picture."""
        if isinstance(still, Lost):
            self._lost[still.number] = still.reason
            return
        for piece in sorted(self._pieces, key=lambda piece: -piece[-1].number):
            if self._continues(piece, still):
                piece.append(still)
                return
        self._pieces.append([still])

    def _continues(self, piece: list[Still], still: Still) -> bool:
        """Place a picture by the pictures of a piece, the last ones or else any; keep the matches."""
        last = [piece[-back] for back in _BEFORE if back <= len(piece)]
        spread = [piece[at] for at in np.linspace(0, len(piece) - 1, min(_RETRIED, len(piece))).astype(int)]
        for others in (last, spread):
            matches = [match for other in others if (match := self._match(other, still)) is not None]
            if matches and self._place_by(still, {other.number: other for other in others}, matches):
                self._matches.setdefault(still.number, []).extend(matches)
                return True
        return False

    def _match(self, first: Still, second: Still) -> _Match | None:
        """Match features, and keep those of a common epipolar geometry; None for too few."""
        pairs = matched(first.features, second.features)
        if len(pairs) < _LEAST_MATCHES:
            return None
        ends = first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]]
        _, fits = cv2.findEssentialMat(*ends, self._camera, cv2.USAC_MAGSAC, 0.999, _MATCH_PX * self._unit)
        if fits is None or int(fits.sum()) < _LEAST_MATCHES:  # pyright: ignore[reportUnnecessaryComparison]
            return None
        return _Match(first.number, second.number, pairs[fits[:, 0] > 0])

    def _place_by(self, still: Still, others: dict[int, Still], matches: Sequence[_Match]) -> bool:
        """Place a picture by the depth of features that placed pictures see too."""
        points, pixels = [], []
        for match in matches:
            other, own = others[match.first], match.features[:, 0]
            local = np.concatenate([other.pixels[own] / self._focal, np.ones((len(own), 1))], axis=1)
            points.append((local * other.depth_m[own, None]) @ other.turn.T + other.centre)
            pixels.append(still.pixels[match.features[:, 1]])
        world, seen = np.concatenate(points), np.concatenate(pixels).astype(np.float64)
        works, turn, shift, inliers = cv2.solvePnPRansac(
            world, seen, self._camera, None,
            iterationsCount=200, reprojectionError=_PLACING_PX * self._unit, flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
        if not works or len(inliers) < max(_LEAST_MATCHES, 0.3 * len(world)):
            return False
        near = inliers[:, 0].astype(int)
        turn, shift = cv2.solvePnPRefineLM(world[near], seen[near], self._camera, None, turn, shift)
        to_camera = cv2.Rodrigues(turn)[0]
        still.turn, still.centre = to_camera.T, -(to_camera.T @ shift)[:, 0]
        return True

    def path(self, *, level: bool = True) -> CameraPath:
        """Return the cameras of the longest piece, adjusted together.

        Args:
            level: Turn the world upright by straight lines; otherwise it has the first camera's axes.
        """
        piece = max(self._pieces, key=len, default=[])
        lost = dict(self._lost)
        for other in self._pieces:
            if other is not piece:
                reason = "shows nothing of the longest piece of the video: a cut, or a turn too fast to follow"
                lost |= {still.number: reason for still in other}
        if len(piece) > 1:
            matches = [match for still in piece for match in self._matches.get(still.number, ())]
            matches += self._loops(piece)
            self._focal = self._adjust(piece, matches)
            before = np.inf
            for number in range(_AGAIN):
                worst = max(still.error_px for still in piece)
                if (self._known or number) and not MISFIT_PX <= worst < 0.9 * before:
                    break
                before = worst
                self._place_again(piece)  # a wrong lens or a turn of a flat wall may have misled the first cameras
                self._focal = self._adjust(piece, matches)
            tied = [still for still in piece if still.sightings >= _LEAST_SIGHTINGS]
            if len(tied) > 1:
                lost |= {still.number: "shares too little with the others" for still in piece if still not in tied}
                piece = tied
        focal = self._focal
        if not piece:
            return CameraPath({}, self._intrinsics, lost, Upright((0.0, 1.0, 0.0), float("inf")))
        first = rigid_inverse(_opengl(piece[0]))
        poses = [first @ _opengl(still) for still in piece]
        lines = [still.lines.refocused(focal / self._intrinsics.fx) for still in piece]
        up = upright(lines, [pose[:3, :3] for pose in poses])
        turn = rotation_to_y_up(np.array(up.up)) if level else np.eye(4)
        placed = {still.number: turn @ pose for still, pose in zip(piece, poses, strict=True)}
        misfits = tuple(still.number for still in piece if still.error_px >= MISFIT_PX)
        return CameraPath(placed, replace(self._intrinsics, fx=focal, fy=focal), lost, up, misfits)

    def _place_again(self, piece: list[Still]) -> None:
        """Place a piece's pictures one after the other with the present focal length; one that fails stays."""
        placed = {still.number: still for still in piece}
        piece[0].turn, piece[0].centre = np.eye(3), np.zeros(3)
        for still in piece[1:]:
            self._place_by(still, placed, self._matches[still.number])

    def _loops(self, piece: list[Still]) -> list[_Match]:
        """Match pictures that look the same way at different times."""
        turns, matches = np.stack([still.turn for still in piece]), list[_Match]()
        for later in range(_LOOP_GAP, len(piece)):
            cosine = (np.einsum("nab,ab->n", turns[: later - _LOOP_GAP + 1], turns[later]) - 1) / 2
            alike = np.flatnonzero(cosine > np.cos(np.radians(_LOOP_DEG)))
            for at in np.unique(alike[np.linspace(0, len(alike) - 1, min(_LOOPS, len(alike))).astype(int)]):
                if (match := self._match(piece[at], piece[later])) is not None:
                    matches.append(match)
        return matches

    def _adjust(self, piece: list[Still], matches: Sequence[_Match]) -> float:
        """Adjust all cameras of a piece to its matches; returns the focal length."""
        index = {still.number: at for at, still in enumerate(piece)}
        rows = np.concatenate([
            [[index[match.first], first, index[match.second], second] for first, second in match.features[::step]]
            for match in matches
            if (step := 1 + len(match.features) // _MOST_MATCHES)
        ])  # fmt: skip
        rows = rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]
        landmarks, landmark = np.unique(rows[:, :2], axis=0, return_inverse=True)
        stated = np.array([-np.log(piece[host].depth_m[feature]) for host, feature in landmarks])
        sightings = Sightings(
            host=landmarks[:, 0],
            pixel=np.array([piece[host].pixels[feature] for host, feature in landmarks], np.float64),
            log_stated=stated,
            landmark=landmark.ravel(),
            picture=rows[:, 2],
            seen=np.array([piece[picture].pixels[feature] for picture, feature in rows[:, 2:]], np.float64),
            unit=self._unit,
            focal_prior=(self._intrinsics.fx, _KNOWN_FOCAL if self._known else _GUESSED_FOCAL),
            depth_error=_DEPTH_ERROR_FIRST,
        )
        cameras = Cameras(
            np.stack([still.turn for still in piece]),
            np.stack([still.centre for still in piece]),
            np.zeros(len(piece)),
            stated,
            self._focal,
        )
        cameras = adjusted(cameras, sightings)
        good = reprojection_errors(cameras, sightings) < _OUTLIER_PX
        sightings = replace(
            sightings,
            landmark=sightings.landmark[good], picture=sightings.picture[good], seen=sightings.seen[good],
            depth_error=_DEPTH_ERROR,
        )  # fmt: skip
        cameras = adjusted(cameras, sightings)
        if (scaled := in_metres(cameras, sightings)) is not cameras:
            cameras = adjusted(scaled, sightings)
        errors = reprojection_errors(cameras, sightings)
        good = errors < _OUTLIER_PX
        pictures = np.concatenate([sightings.host[sightings.landmark[good]], sightings.picture[good]])
        for at, still in enumerate(piece):
            still.turn, still.centre = cameras.turns[at], cameras.centres[at]
            still.sightings = int((pictures == at).sum())
            own = errors[sightings.picture == at]
            still.error_px = float(np.median(own)) if own.size else 0.0
        return cameras.focal


def _opengl(still: Still) -> Float[np.ndarray, "4 4"]:
    """Return a picture's pose, OpenGL axes, in the world of the first camera's OpenGL axes."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = still.turn, still.centre
    return OPENCV_TO_OPENGL @ pose @ OPENCV_TO_OPENGL
