"""Frames without depth in, frames with depth out: estimated from each picture, consistent over the stream.

A network sees each picture alone, so that its depth breathes from frame to frame by several percent. The poses do not:
depth of features by triangulation, and the depth of earlier keyframes, fix each frame's scale (and for inverse depth
its shift). Without parallax the earlier fit stays.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from roomlight.errors import FrameError
from roomlight.frame import Frame
from roomlight.monocular.estimate import DepthEstimate, DepthModel, srgb_picture
from roomlight.monocular.fitting import Fit, fit_inverse
from roomlight.monocular.model_file import DepthModelFile
from roomlight.monocular.network import shipped_depth
from roomlight.monocular.tracks import Samples, View, carried, far_apart, grey_picture, grid_of, triangulated
from roomlight.notes import Note

SIZE: Final = (320, 240)
"""Estimated depth is at most of this size (width, height; swapped for upright frames), the engine's."""
LEAST_CONFIDENCE: Final = 0.15
"""Depth of a lower confidence is left open, and filled from around it."""
NEAREST_M, FARTHEST_M = 0.1, 30.0
_KEPT: Final = 12
DEPTH_STREAM_BYTES: Final = _KEPT * 90_000
"""Memory of a stream: a grey picture and a grid of depth for each view that is kept."""
_COMPARED: Final = 4
"""Keyframes whose features and depth a frame is compared with: the last ones, and the nearest by position."""
_REMEMBERED: Final = 10
_FADING: Final = np.array([1.0, 1.0, 0.8])
"""Frames whose triangulated features count for the scale, and the share of their weight from frame to frame."""
_CARRIED: Final = 0.5
"""Most weight of the earlier keyframes' depth, relative to the features'."""
_FEW, _ALONE = 5.0, 60.0
"""Features that weigh less than this leave the scale to the keyframes, which then weigh so much."""


class DepthStream:
    """Depth for the frames of one stream, in order.

    Examples:
        stream = DepthStream(shipped_depth())
        session.push(stream.complete(frame))
    """

    def __init__(self, model: DepthModel, reference: DepthModel | None = None) -> None:
        """Take the model, and for one without scale a metric one that gives the first frame's; streams share both."""
        self.model, self._reference = model, reference
        self._views: list[View] = []
        self._motion: list[Float[np.ndarray, "n 3"]] = []
        self._fit: Fit | None = None if model.kind != "metric" else Fit(1.0)

    def note(self, source: str) -> Note:
        """Return what a capture says whose depth is estimated."""
        return Note(
            f"{source}: its depth is estimated from each picture by {self.model.name}",
            "distances may be wrong by a tenth and more, also where poses correct them",
            "record with a depth sensor for exact places, or give another model as depth_model (--depth-model)",
        )

    def complete(self, frame: Frame) -> Frame:
        """Return the frame with estimated depth; one that has depth is returned as it is.

        Raises:
            FrameError: The model knows depth only up to scale, and nothing in the stream has fixed the scale yet.
            ModelError: The model's answer is no depth.
        """
        return frame if frame.depth_m.any() else replace(frame, depth_m=self.estimate(frame))

    def estimate(self, frame: Frame) -> Float32[np.ndarray, "h w"]:
        """Return the depth of the stream's next frame in metres, 0 where the model is not sure; `complete` uses it."""
        small = replace(frame, depth_m=np.zeros(frame.image.shape[:2], np.float32)).resized(*SIZE)
        picture = srgb_picture(small)
        height, width = picture.shape[:2]
        estimated = self.model.estimate(picture, small.intrinsics).resized(width, height)
        view = View(grey_picture(picture), small.intrinsics, small.camera_to_world, np.zeros((0, 0)))
        fit = self._fitted(view, estimated, picture)
        inverse = np.clip(fit.scale * estimated.inverse + fit.shift, 1 / FARTHEST_M, 1 / NEAREST_M)
        sure = estimated.confidence >= min(LEAST_CONFIDENCE, float(np.median(estimated.confidence)))
        self._keep(replace(view, inverse=grid_of(np.where(sure, inverse, 0)).copy()))
        self._fit = fit
        return np.where(sure, 1 / inverse, 0).astype(np.float32)

    def _fitted(self, view: View, estimated: DepthEstimate, picture: Float32[np.ndarray, "h w 3"]) -> Fit:
        """Return scale and shift of a frame by the keyframes near it, or the earlier frames' fit."""
        samples: list[Samples] = []
        if self._fit is not None:
            guess = np.clip(self._fit.scale * estimated.inverse + self._fit.shift, 1 / FARTHEST_M, 1 / NEAREST_M)
            samples = [triangulated(view, other, guess) for other in self._views[-_COMPARED:]]
        elif self._reference is not None:
            samples = [self._referred(view, picture)]
        moved = Samples.joined(samples)
        here = view.camera_to_world[:3, 3]
        near = sorted(self._views, key=lambda other: float(np.linalg.norm(other.camera_to_world[:3, 3] - here)))
        kept = Samples.joined([carried(view, other) for other in near[:_COMPARED]])
        pairs = [_pairs(moved, estimated), _pairs(kept, estimated)]
        if estimated.kind != "inverse":  # a model's error of scale is much the same in all frames of a room
            self._motion = [*(_FADING * pairs for pairs in self._motion[1 - _REMEMBERED :]), pairs[0]]
            pairs[0] = np.concatenate(self._motion)
        seen = float(pairs[0][:, 2].sum())
        pairs[1][:, 2] *= min(
            1.0, (_CARRIED * seen if seen > _FEW else _ALONE) / max(float(pairs[1][:, 2].sum()), 1e-9)
        )
        q, t, weight = np.concatenate(pairs).T
        fit = fit_inverse(q, t, weight, kind=estimated.kind, prior=self._fit)
        if fit is None:
            raise FrameError(
                f"the depth of {self.model.name} is known up to scale only, and no parallax between frames has fixed "
                "the scale yet: move the camera sideways, or give a metric model"
            )
        return fit

    def _referred(self, view: View, picture: Float32[np.ndarray, "h w 3"]) -> Samples:
        """Return the metric model's depth on a grid."""
        assert self._reference is not None
        height, width = view.grey.shape
        metric = self._reference.estimate(picture, view.intrinsics).resized(width, height)
        rows, columns = (grid.ravel() for grid in np.mgrid[4:height:8, 4:width:8])
        return Samples(
            np.stack([columns, rows], axis=1).astype(np.float64),
            metric.inverse[rows, columns].astype(np.float64),
            0.1 * metric.confidence[rows, columns].astype(np.float64),
        )

    def _keep(self, view: View) -> None:
        """Keep a view that differs from the last one kept; the oldest goes."""
        if not self._views or far_apart(view, self._views[-1]):
            self._views = [*self._views, view][-_KEPT:]


def _pairs(samples: Samples, estimated: DepthEstimate) -> Float[np.ndarray, "n 3"]:
    """Return estimated inverse depth, known inverse depth and weight of samples."""
    height, width = estimated.inverse.shape
    columns, rows = np.floor(samples.pixels).astype(int).T
    rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
    weight = samples.weight * np.maximum(estimated.confidence[rows, columns], 0.05)
    return np.stack([estimated.inverse[rows, columns].astype(np.float64), samples.inverse, weight], axis=1)


def open_depth_stream(model: Path | None = None) -> DepthStream:
    """Return depth for one stream, by the network inside the package or an ONNX file; models are loaded once.

    A model without scale takes the first frame's scale from the network inside the package.

    Raises:
        ModelError: The model cannot be used.
    """
    if model is None:
        return DepthStream(shipped_depth())
    loaded = _load(model)
    return DepthStream(loaded, None if loaded.kind == "metric" else shipped_depth())


@cache
def _load(path: Path) -> DepthModelFile:
    return DepthModelFile(path)
