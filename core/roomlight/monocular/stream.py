"""Frames without depth in, frames with depth out: estimated from each picture, consistent over the stream.

A network sees each picture alone: its scale is wrong by tens of percent in a whole room, and breathes from frame to
frame. The poses are metric. Five steps mend a frame:

1. Keyframes' depth, carried into the frame, gives the scale of the frame (for inverse depth the shift too) in the
   stream's own unit. Without keyframes the network's word counts.
2. Features that moved between frames are triangulated; those of the last frames together give the metres of the unit.
   When these change, the depth of all keyframes changes with them, so that a wrong start is forgotten at once.
3. What features and keyframes say beyond that corrects the depth smoothly over the picture.
4. Where earlier frames show the same from elsewhere, a plane sweep corrects it pixel by pixel.
5. Without parallax, the unit stays what it was; before any, the metres are midway between the network's and those that
   put the floor in view a phone's height below the camera.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.engine.networks.graphs import load_part
from roomlight.errors import FrameError
from roomlight.frame import Frame
from roomlight.monocular.estimate import DepthEstimate, DepthModel, srgb_picture
from roomlight.monocular.fitting import LEAST_SAMPLES, Fit, error_field, fit_inverse, median_of
from roomlight.monocular.floor import CAMERA_HEIGHT_M, camera_height, floor_scale
from roomlight.monocular.model_file import DepthModelFile
from roomlight.monocular.network import DepthNetworkModel, shipped_depth
from roomlight.monocular.stream_state import StreamState
from roomlight.monocular.sweep import refined
from roomlight.monocular.tracks import (
    Samples,
    View,
    carried,
    far_apart,
    grey_picture,
    grid_of,
    partners,
    places_of,
    triangulated,
)
from roomlight.notes import Note

SIZE: Final = (320, 240)
"""Estimated depth is at most of this size (width, height; swapped for upright frames), the engine's."""
LEAST_CONFIDENCE: Final = 0.15
"""Depth of a lower confidence is left open, and filled from around it."""
NEAREST_M, FARTHEST_M = 0.1, 30.0
_KEPT: Final = 12
DEPTH_STREAM_BYTES: Final = (_KEPT + 1) * 90_000
"""Memory of a stream: a grey picture and a grid of depth for each view that is kept."""
_CARRIED: Final = 4
"""Keyframes, the nearest by position, whose depth is carried into a frame."""
_FOLLOWED: Final = 4
"""Keyframes, or the last frame, to which a frame's features are followed."""
_REMEMBERED: Final = 20
_FADING: Final = np.array([1.0, 0.85])
"""Frames whose triangulated features count for the metres, and the share of their weight from frame to frame."""
_LEAST_FEATURES: Final = 6.0
"""Weight of the features below which the metres stay what they were."""
_BEFORE: Final = 3.0
"""Weight of what they were, beside the features'."""
_AGREEING: Final = 0.35
"""Least share of the features within 25 % of their median: others are no depth of the picture."""

_FLOOR_SHARE: Final = 0.5
"""Share of the floor's word in the log of the metres, beside the network's."""
_MOST_FLOORS: Final = 500
"""Last frames whose floors count: all are sorted in each frame, and more of a camera in its place tell little."""
_MOST_BY_FLOOR: Final = 2.0
"""Most that the floor enlarges or reduces depth: what is farther off is a table, or a camera on the ground."""


class DepthStream:
    """Depth for the frames of one stream, in order.

    Attributes:
        state: What it knows; another stream of the same models goes on from it.

    Examples:
        stream = DepthStream(shipped_depth())
        session.push(stream.complete(frame))
    """

    def __init__(
        self,
        model: DepthModel,
        reference: DepthModel | None = None,
        *,
        gravity: bool = True,
        height_m: float | None = None,
    ) -> None:
        """Take the models; streams share them.

        Args:
            model: Estimates depth.
            reference: For a model without scale: a metric model, which gives the first frame's.
            gravity: Whether up is y in the frames' world, as it must be but for the pose of a single photo.
            height_m: How high the camera is over the floor, about; None: as people hold a phone.
        """
        self.model, self._reference, self._gravity = model, reference, gravity
        self._height_m = CAMERA_HEIGHT_M if height_m is None else height_m
        self.state = StreamState(fit=None if model.kind != "metric" else Fit(1.0))

    def note(self, source: str) -> Note:
        """Return what a capture says whose depth is estimated."""
        return Note(
            f"{source}: its depth is estimated from each picture by {self.model.name}",
            "distances may be wrong by a tenth and more, and by a factor of two where the camera only turns",
            "record with a depth sensor for exact places, or give another model as depth_model (--depth-model)",
        )

    def complete(self, frame: Frame) -> Frame:
        """Return the frame with estimated depth; one that has depth is returned as it is.

        Raises:
            FrameError: The frame is black, or the model knows depth only up to scale, and nothing in the stream has
                fixed the scale yet.
            ModelError: The model's answer is no depth.
        """
        if frame.depth_m.any():
            return frame
        if frame.is_black:
            raise FrameError(f"{frame.source or f'frame {frame.index}'}: its image is black, and has no depth")
        return replace(frame, depth_m=self.estimate(frame), depth_estimated=True)

    def estimate(self, frame: Frame) -> Float32[np.ndarray, "h w"]:
        """Return the depth of the stream's next frame in metres, 0 where the model is not sure; `complete` uses it."""
        small = replace(frame, depth_m=np.zeros(frame.image.shape[:2], np.float32)).resized(*SIZE)
        picture = srgb_picture(small)
        estimated = self._estimated(self.model, picture, small)
        view = View(grey_picture(picture), small.intrinsics, small.camera_to_world, np.zeros((0, 0)))
        kept = self._carried(view)
        inverse = _applied(self._fitted(estimated, kept, small, picture), estimated)
        moved = self._moved(view, inverse)
        if len(moved.inverse):
            self._weigh(inverse, moved)
        samples = Samples.joined([moved.scaled(1 / self.state.per_metre), kept])
        if len(moved.inverse):
            inverse = _applied(self._fitted(estimated, samples, small, picture), estimated)
        if len(samples.inverse):
            inverse = corrected(inverse, samples)
        if len(moved.inverse) >= LEAST_SAMPLES:
            inverse = self._refined(view, inverse, picture)
        sure = estimated.confidence >= min(LEAST_CONFIDENCE, float(np.median(estimated.confidence)))
        self.state.last = replace(view, inverse=grid_of(np.where(sure, inverse, 0)).copy())
        if not self.state.views or far_apart(self.state.last, self.state.views[-1]):
            self.state.views = [*self.state.views, self.state.last][-_KEPT:]
        self._level(np.where(sure, 1 / inverse, 0), small)
        return np.where(sure, 1 / self._metric(inverse), 0).astype(np.float32)

    def _estimated(self, model: DepthModel, picture: Float32[np.ndarray, "h w 3"], frame: Frame) -> DepthEstimate:
        """Return a model's estimate at the picture's size."""
        up = frame.camera_to_world[1, :3] if self._gravity else None
        return model.estimate(picture, frame.intrinsics, up).resized(picture.shape[1], picture.shape[0])

    def _carried(self, view: View) -> Samples:
        """Return the depth of the nearest keyframes, in the stream's unit."""
        here = view.camera_to_world[:3, 3]
        near = sorted(self.state.views, key=lambda other: float(np.linalg.norm(other.camera_to_world[:3, 3] - here)))
        return Samples.joined([carried(view, other, self.state.per_metre) for other in near[:_CARRIED]])

    def _fitted(
        self, estimated: DepthEstimate, known: Samples, frame: Frame, picture: Float32[np.ndarray, "h w 3"]
    ) -> Fit:
        """Return scale and shift of a frame in the stream's unit."""
        if self.state.fit is None and self._reference is not None:
            known = _on_grid(self._estimated(self._reference, picture, frame))
        q, t, weight = _pairs(known, estimated).T
        fit = fit_inverse(q, t, weight, kind=estimated.kind, prior=self.state.fit)
        if fit is None:
            raise FrameError(
                f"{self.model.name} contradicts the depth network inside the package, which would give its scale: "
                "check `kind`, mean, deviation and white in its sidecar, or the picture shows too little"
                if self._reference is not None
                else f"{self.model.name} knows depth up to scale only, and no metric model is given: give one"
            )
        if estimated.kind != "metric":  # each of a metric model's words counts as much as its first
            self.state.fit = fit
        return fit

    def _moved(self, view: View, inverse: Float32[np.ndarray, "h w"]) -> Samples:
        """Return the features of a view that moved since earlier ones, per metre."""
        guess = self._metric(inverse)
        all_samples: list[Samples] = []
        for other in self._partners(view, guess):
            samples = triangulated(view, other, guess)
            all_samples.append(samples)
            if len(samples.inverse) >= LEAST_SAMPLES:  # views farther away need a better guess
                guess = np.clip(corrected(guess, samples), 1 / FARTHEST_M, 1 / NEAREST_M)
        return Samples.joined(all_samples)

    def _refined(
        self, view: View, inverse: Float32[np.ndarray, "h w"], picture: Float32[np.ndarray, "h w 3"]
    ) -> Float32[np.ndarray, "h w"]:
        """Return 1 / depth in the stream's unit, mended by what views from elsewhere show."""
        guess = self._metric(inverse)
        return refined(view, self._partners(view, guess), guess, picture) / np.float32(self.state.per_metre)

    def _metric(self, inverse: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
        return np.clip(self.state.per_metre * inverse, 1 / FARTHEST_M, 1 / NEAREST_M).astype(np.float32)

    def _partners(self, view: View, guess: Float32[np.ndarray, "h w"]) -> list[View]:
        """Return the earlier views that tell most of a view's depth."""
        earlier = self.state.views if self.state.last is None else [*self.state.views, self.state.last]
        return partners(view, earlier, 1 / float(np.median(guess)), _FOLLOWED)

    def _level(self, depth: Float[np.ndarray, "h w"], frame: Frame) -> None:
        """Move the metres of the unit toward those that the floor gives, as long as no features tell them."""
        if not self._gravity or not self.state.unmoved:
            return
        up = frame.camera_to_world[1, :3].astype(np.float64)
        self.state.floors = [*self.state.floors[1 - _MOST_FLOORS :], camera_height(depth, frame.intrinsics, up)]
        metres = floor_scale(self.state.floors, self._height_m)
        if metres is not None:
            self.state.per_metre = float(np.clip(metres, 1 / _MOST_BY_FLOOR, _MOST_BY_FLOOR)) ** -_FLOOR_SHARE

    def _weigh(self, inverse: Float32[np.ndarray, "h w"], moved: Samples) -> None:
        """Fit the metres of the stream's unit to the features of this frame and the last ones."""
        rows, columns = places_of(moved, inverse)
        ratio = np.log(moved.inverse / inverse[rows, columns])
        self.state.motion = [
            *(_FADING * old for old in self.state.motion[1 - _REMEMBERED :]),
            np.stack([ratio, moved.weight], 1),
        ]
        ratios, weight = np.concatenate(self.state.motion).T
        seen, before = float(weight.sum()), np.log(self.state.per_metre)
        if seen < _LEAST_FEATURES:
            return
        self.state.unmoved = False
        middle = median_of(np.append(ratios, before), np.append(weight, _BEFORE))
        if float(weight[np.abs(ratios - middle) < np.log(1.25)].sum()) > _AGREEING * seen:
            self.state.per_metre = float(np.exp(middle))


def _applied(fit: Fit, estimated: DepthEstimate) -> Float32[np.ndarray, "h w"]:
    """Return 1 / depth in the stream's unit, within a wide range of metres."""
    return np.clip(fit.scale * estimated.inverse + fit.shift, 0.2 / FARTHEST_M, 5 / NEAREST_M).astype(np.float32)


def corrected(inverse: Float32[np.ndarray, "h w"], samples: Samples) -> Float32[np.ndarray, "h w"]:
    """Return an estimated 1 / depth (above 0) times the samples' mean factor and the field of its errors.

    The result has the samples' unit.
    """
    rows, columns = places_of(samples, inverse)
    ratio = np.log(np.maximum(samples.inverse, 1e-6) / inverse[rows, columns])
    middle = median_of(ratio, samples.weight)
    field = middle + error_field(inverse, samples.pixels, ratio - middle, samples.weight)
    return (inverse * np.exp(field)).astype(np.float32)


def _on_grid(metric: DepthEstimate) -> Samples:
    """Return the depth of a metric model on a grid."""
    rows, columns = (
        grid.ravel() for grid in np.mgrid[4 : metric.inverse.shape[0] : 8, 4 : metric.inverse.shape[1] : 8]
    )
    return Samples(
        np.stack([columns, rows], axis=1).astype(np.float64),
        metric.inverse[rows, columns].astype(np.float64),
        0.1 * metric.confidence[rows, columns].astype(np.float64),
    )


def _pairs(samples: Samples, estimated: DepthEstimate) -> Float[np.ndarray, "n 3"]:
    """Return estimated inverse depth, known inverse depth and weight of samples."""
    rows, columns = places_of(samples, estimated.inverse)
    weight = samples.weight * np.maximum(estimated.confidence[rows, columns], 0.05)
    return np.stack([estimated.inverse[rows, columns].astype(np.float64), samples.inverse, weight], axis=1)


def open_depth_stream(model: Path | None = None, *, gravity: bool = True, height_m: float | None = None) -> DepthStream:
    """Return depth for one stream, by the network inside the package or another model; models are loaded once.

    `model` is an ONNX file, or a folder of a depth network that `roomlight train` made. A model without scale takes the
    first frame's scale from the network inside the package. `gravity` and `height_m` are the stream's.

    Raises:
        ModelError: The model cannot be used.
    """
    if model is None:
        return DepthStream(shipped_depth(), gravity=gravity, height_m=height_m)
    loaded = _load(model)
    reference = None if loaded.kind == "metric" else shipped_depth()
    return DepthStream(loaded, reference, gravity=gravity, height_m=height_m)


def metric_model(model: Path | None = None) -> DepthModel:
    """Return another model, as in `open_depth_stream`, if it knows metres, else the network inside the package.

    Raises:
        ModelError: The model cannot be used.
    """
    loaded = shipped_depth() if model is None else _load(model)
    return loaded if loaded.kind == "metric" else shipped_depth()


@cache
def _load(path: Path) -> DepthModel:
    return DepthNetworkModel(load_part(path, "depth")) if path.is_dir() else DepthModelFile(path)
