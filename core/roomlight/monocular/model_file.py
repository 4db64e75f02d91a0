"""Any ONNX file that estimates depth: what its inputs and outputs mean is told by their names, or by a sidecar.

The picture is the graph's input of 3 to 5 axes, channels first or last; integers are 0 to 255. Conventions are
recognised by the outputs' names:

| Outputs | Model | Meaning |
| --- | --- | --- |
| `points` | MoGe | points, z up to a shift that the lens tells; with `metric_scale` metres, else up to scale |
| `predicted_depth` and `predicted_normal` | Metric3D | metres for a focal length of 1,000 pixels; picture 0 to 255 |
| `pred_depth`, "metric3d" in the file's name | Metric3D | the same |
| `pts_3d`; `depth` and `K`, `out_K` or `intrinsics`, given or answered | UniDepth | points in metres; metres |
| `predicted_depth` and `focallength_px` | Depth Pro | metres; picture -1 to 1 |
| `depth` and `sky` or `depth_conf` | Depth Anything 3 | depth up to scale |
| the same, "metric" in the file's name | Depth Anything 3 metric | metres for a focal length of 300 pixels |
| `metric_depth`; `predicted_depth` or `depth` of a file with `_METRIC_NAMES` in its name | V2 metric | metres |
| `predicted_depth`, `depth`, `disparity` | Depth Anything V2, MiDaS | 1 / depth up to scale and shift |

A sidecar `NAME.json` beside `NAME.onnx` (`Sidecar`) states what is otherwise. Depth is along the optical axis.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal, get_args

import cv2
import numpy as np
from annotated_types import Gt, Interval
from jaxtyping import Float, Float32
from pydantic import ConfigDict, TypeAdapter, ValidationError

from roomlight.camera import Intrinsics
from roomlight.depth import DEPTH_MEDIAN_M
from roomlight.engine.networks.runtime import OnnxRuntimeGraph
from roomlight.errors import ModelError
from roomlight.monocular.estimate import DepthEstimate, DepthKind

Meaning = Literal["metric", "scale", "inverse", "points"]
Positive = Annotated[float, Gt(0)]
Triple = tuple[float, float, float]
_IMAGENET: Final = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
_PLAIN: Final = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
_PLUS_MINUS: Final = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
_LENS: Final = ("K", "intrinsics", "camera", "cam")
_ANSWERED_LENS: Final = (*_LENS, "out_K")
_METRIC_NAMES: Final = ("metric", "indoor", "outdoor")
_METRIC_POINTS: Final = "pts_3d"
_MEANINGS: Final[dict[Meaning, str]] = {
    "metric": "metres", "scale": "depth up to scale", "inverse": "1 / depth", "points": "points",
}  # fmt: skip
_MULTIPLE: Final = 14
"""Sides of a picture of free size are multiples of a vision transformer's patch."""
_MOST_SIDE: Final = 2048
_ASPECT: Final = 0.2
"""Most that the aspect of an answer may differ from the picture's, as a log."""


@dataclass(frozen=True)
class Sidecar:
    """What a model's file does not state.

    Attributes:
        kind: metric, scale, inverse (1 / depth up to scale and shift) or points [h, w, 3] (z up to a shift).
        output: Name of the output with depth or points.
        confidence: Name of the output with a mask or a confidence of 0 to 1.
        size: Longest side of the picture in pixels, where the graph leaves it open.
        mean, deviation: The picture (0 to 1, times `white`) less mean, by deviation.
        white: The picture's largest value: 1 or 255.
        focal_px: Depth is for this focal length in pixels; None: for the camera's own.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    kind: Meaning | None = None
    output: str | None = None
    confidence: str | None = None
    size: Annotated[int, Interval(ge=32, le=_MOST_SIDE)] = 518
    mean: Triple | None = None
    deviation: tuple[Positive, Positive, Positive] | None = None
    white: Literal[1, 255] = 1
    focal_px: Positive | None = None

    @classmethod
    def read(cls, path: Path) -> "Sidecar":
        """Read the sidecar of a model's file; without one everything is told from the graph.

        Raises:
            ModelError: It is not JSON, or a value is unknown, of the wrong type or out of range.
        """
        file = path.with_suffix(".json")
        if not file.is_file():
            return cls()
        try:
            return TypeAdapter(cls).validate_json(file.read_bytes())
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = ".".join(map(str, first["loc"])) or "the sidecar"
            known = ", ".join(entry.name for entry in fields(cls))
            raise ModelError(f"{file}: {name}: {first['msg']}; got {first['input']!r:.80} (known: {known})") from error


class DepthModelFile:
    """A user's model, loaded once; threads may share it."""

    def __init__(self, path: Path) -> None:
        """Load the graph and decide what its inputs and outputs mean.

        Raises:
            ModelError: The file does not load, or an input or the depth's meaning is not known; it names which.
        """
        if not path.is_file():
            raise ModelError(f"{path}: there is no such depth model; give an ONNX file")
        self.path = path
        self._graph = OnnxRuntimeGraph.open(path)
        self._sidecar = Sidecar.read(path)
        self._inputs, self._outputs = dict(self._graph.inputs), dict(self._graph.outputs)
        self._picture, self._last = self._picture_input()
        self._output, self.meaning = self._chosen_output()
        self.name = f"{path.name} (its {self._output} as {_MEANINGS[self.meaning]})"
        self.kind: DepthKind = "scale" if self.meaning == "points" else self.meaning
        if self.meaning == "points" and ("metric_scale" in self._outputs or self._output == _METRIC_POINTS):
            self.kind = "metric"
        for name, shape in self._inputs.items():
            if name not in (self._picture, "num_tokens", *_LENS):
                raise ModelError(f"{path}: its input {name} is not known; a depth model takes a picture, K, num_tokens")
            if name in _LENS and any(isinstance(size, int) and size != 3 for size in shape[-2:]):
                raise ModelError(f"{path}: its input {name} is {list(shape)}; the lens is given as a 3 x 3 matrix")

    def estimate(
        self,
        picture: Float32[np.ndarray, "h w 3"],
        intrinsics: Intrinsics,
        up: Float[np.ndarray, "3"] | None = None,  # noqa: ARG002  no model that is known takes it
    ) -> DepthEstimate:
        """Run the model on an sRGB picture in [0, 1].

        Raises:
            ModelError: The graph fails, or its output is not a map of finite depth.
        """
        width, height = self._size(picture.shape[1], picture.shape[0])
        lens = intrinsics.resized(width, height)
        enlarging = width * height > picture.shape[0] * picture.shape[1]
        method = cv2.INTER_CUBIC if enlarging else cv2.INTER_AREA
        resized = np.clip(cv2.resize(picture, (width, height), interpolation=method), 0, 1)
        outputs = self._graph.run(self._feed(resized, lens))
        planes, confidence = self._plane(outputs, self._output), self._confidence(outputs, (height, width))
        if abs(np.log(planes.shape[1] / planes.shape[0] * height / width)) > _ASPECT:
            raise ModelError(
                f"{self.path}: its output {self._output} is {planes.shape[1]} x {planes.shape[0]} for a picture of "
                f"{width} x {height}: another aspect"
            )
        if self.meaning == "points":
            depth = planes[..., 2] if self._output == _METRIC_POINTS else shifted_depth(planes, lens)
            if "metric_scale" in outputs:
                depth = depth * np.float32(np.asarray(outputs["metric_scale"]).ravel()[0])
        else:
            depth = planes
        focal = self._focal_px
        if focal is not None:
            depth = depth * np.float32(np.sqrt(lens.fx * lens.fy) / focal)
        if self.meaning != "inverse":
            self._check_depth(depth)
            with np.errstate(divide="ignore"):
                depth = np.where(depth > 1e-6, 1 / np.maximum(depth, 1e-6), 0)
        return DepthEstimate(depth.astype(np.float32), confidence, self.kind)

    # --- what the graph says

    def _picture_input(self) -> tuple[str, bool]:
        """Return the picture's name, and whether its channels come last."""
        for name, shape in self._inputs.items():
            last = len(shape) in (4, 5) and shape[-1] == 3 and shape[-3] != 3
            if last or (len(shape) in (4, 5) and (shape[-3] == 3 or not isinstance(shape[-3], int))):
                if any(isinstance(size, int) and size != 1 for size in shape[:-3]):
                    raise ModelError(f"{self.path}: its picture is {list(shape)}; export it for one picture at a time")
                return name, last
        listed = ", ".join(f"{name} {list(shape)}" for name, shape in self._inputs.items())
        raise ModelError(
            f"{self.path}: no input is a picture [1, 3, h, w] or [1, h, w, 3]; it has {listed or 'no input'}"
        )

    def _chosen_output(self) -> tuple[str, Meaning]:
        """Return the output with depth and its meaning."""
        names, stated = list(self._outputs), self._sidecar
        if stated.output is not None and stated.output not in names:
            raise ModelError(f"{self.path}: has no output {stated.output}, only {', '.join(names)}; mend its sidecar")
        known = ("points", _METRIC_POINTS, "metric_depth", "predicted_depth", "depth", "disparity")
        only = names[0] if len(names) == 1 else None
        output = stated.output or next((name for name in known if name in names), only)
        if output is None:
            raise ModelError(
                f"{self.path}: which of its outputs {', '.join(names)} is depth is not known; state `output` and "
                f"`kind` in {self.path.with_suffix('.json').name}"
            )
        if stated.kind is not None:
            return output, stated.kind
        if output in ("points", _METRIC_POINTS):
            return output, "points"
        stem = self.path.stem.lower()
        says_metric = any(name in stem for name in _METRIC_NAMES) or output == "metric_depth"
        if says_metric or self._is_metric3d or "focallength_px" in names:
            return output, "metric"
        if self._is_depth_anything_3:
            return output, "scale"
        if output == "depth" and any(name in (*self._inputs, *names) for name in _ANSWERED_LENS):
            return output, "metric"
        if output in known:
            return output, "inverse"
        raise ModelError(
            f"{self.path}: whether its output {output} is depth or 1 / depth is not known; state `kind` as one of "
            f"{', '.join(get_args(Meaning))} in {self.path.with_suffix('.json').name}"
        )

    @cached_property
    def _is_metric3d(self) -> bool:
        return "predicted_normal" in self._outputs or (
            "pred_depth" in self._outputs and "metric3d" in self.path.stem.lower()
        )

    @cached_property
    def _is_depth_anything_3(self) -> bool:
        return "depth" in self._outputs and any(name in self._outputs for name in ("sky", "depth_conf"))

    @property
    def _focal_px(self) -> float | None:
        if self._sidecar.focal_px is not None or self._sidecar.kind is not None:
            return self._sidecar.focal_px
        if self._is_depth_anything_3 and self.kind == "metric" and "nested" not in self.path.stem.lower():
            return 300.0
        return 1000.0 if self._is_metric3d else None

    def _size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size at which the picture is given: the graph's own, or of the sidecar's longest side."""
        shape = self._inputs[self._picture]
        rows, columns = shape[-3:-1] if self._last else shape[-2:]
        scale = self._sidecar.size / max(width, height)
        free = [max(_MULTIPLE, round(side * scale / _MULTIPLE) * _MULTIPLE) for side in (width, height)]
        size = [own if isinstance(own, int) else side for own, side in zip((columns, rows), free, strict=True)]
        if max(size) > _MOST_SIDE or min(size) < 1:
            raise ModelError(f"{self.path}: its picture is {size[0]} x {size[1]}; at most {_MOST_SIDE} are run")
        return size[0], size[1]

    def _feed(self, picture: Float32[np.ndarray, "h w 3"], lens: Intrinsics) -> dict[str, np.ndarray]:
        stated = self._sidecar
        kind = self._graph.types[self._picture]
        whole = kind is not None and issubclass(kind, np.integer)
        points = self.meaning == "points" and self._output != _METRIC_POINTS
        raw = self._is_metric3d or whole or points  # these normalise inside the graph
        white = 255.0 if (self._is_metric3d or whole) and stated.mean is None else stated.white
        mean, deviation = _PLAIN if raw else _PLUS_MINUS if "focallength_px" in self._outputs else _IMAGENET
        mean, deviation = stated.mean or mean, stated.deviation or deviation
        values = (picture * np.float32(white) - np.array(mean, np.float32)) / np.array(deviation, np.float32)
        values = np.rint(values) if whole else values
        values = values if self._last else np.moveaxis(values, -1, 0)
        extra = (1 for _ in self._inputs[self._picture][:-3])
        feed: dict[str, np.ndarray] = {self._picture: values.reshape(*extra, *values.shape)}
        for name in self._inputs:
            if name in _LENS:
                matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
                feed[name] = matrix.reshape(*(1 for _ in self._inputs[name][:-2]), 3, 3)
            elif name == "num_tokens":
                feed[name] = np.array(picture.shape[0] * picture.shape[1] // _MULTIPLE**2)
                feed[name] = feed[name].reshape([1] * len(self._inputs[name]))
        return feed

    # --- what it answers

    def _plane(self, outputs: dict[str, np.ndarray], name: str) -> Float[np.ndarray, "h w *c"]:
        """Return an output without its axes of length 1, checked."""
        values = np.asarray(outputs[name], np.float32)
        shape = [size for size in values.shape if size != 1]
        if self.meaning == "points" and name == self._output:
            if len(shape) == 3 and shape[0] == 3 != shape[-1]:
                values = np.moveaxis(values.reshape(shape), 0, -1)
                shape = [*shape[1:], 3]
            fits = len(shape) == 3 and shape[-1] == 3
        else:
            fits = len(shape) == 2
        if not fits:
            wanted = "[h, w, 3]" if self.meaning == "points" else "[h, w]"
            raise ModelError(f"{self.path}: its output {name} has the shape {values.shape}, not {wanted}")
        plane = values.reshape(shape)
        finite = np.isfinite(plane)
        if not finite.any() or float(finite.mean()) < 0.5 or not np.ptp(plane[finite]) > 0:
            raise ModelError(
                f"{self.path}: its output {name} is constant or not finite; check mean, deviation and white"
            )
        return np.where(finite, plane, 0)

    def _check_depth(self, depth: Float[np.ndarray, "h w"]) -> None:
        """Raise ModelError for values that are no depth, or not in metres."""
        median, (low, high) = float(np.median(depth)), DEPTH_MEDIAN_M
        if median <= 0 or (self.kind == "metric" and not low <= median <= high):
            what = "metres" if self.kind == "metric" else "depth"
            raise ModelError(
                f"{self.path}: the median of its output {self._output} is {median:.3g}, which is no {what}; state its "
                f"`kind` in {self.path.with_suffix('.json').name}: scale for another unit, inverse for 1 / depth"
            )

    def _confidence(self, outputs: dict[str, np.ndarray], shape: tuple[int, int]) -> Float32[np.ndarray, "h w"]:
        name = self._sidecar.confidence or ("mask" if "mask" in outputs else None)
        if name is None:
            return np.ones(shape, np.float32)
        if name not in outputs:
            raise ModelError(f"{self.path}: has no output {name} for confidence, only {', '.join(outputs)}")
        values = np.asarray(outputs[name], np.float32)
        plane = np.clip(np.nan_to_num(values.reshape([size for size in values.shape if size != 1])), 0, 1)
        if plane.ndim != 2:
            raise ModelError(f"{self.path}: its output {name} has the shape {values.shape}, not [h, w]")
        return cv2.resize(plane, shape[::-1], interpolation=cv2.INTER_LINEAR)


def shifted_depth(points: Float[np.ndarray, "h w 3"], intrinsics: Intrinsics) -> Float32[np.ndarray, "h w"]:
    """Return z of points after the shift along z that makes them project to their own pixels (Wang et al. 2025, MoGe).

    A pixel's ray r = x / (z + s) is known by the lens, so that r s = x - r z for each coordinate: least squares, and
    again without the worst fifth.
    """
    height, width = points.shape[:2]
    rays = intrinsics.resized(width, height).rays()[..., :2] * np.array([1, -1], np.float32)
    z, along = points[..., 2:], points[..., :2]
    residual, keep = along - rays * z, np.ones((height, width, 1), bool)
    shift = 0.0
    for _ in range(3):
        shift = float((rays * residual * keep).sum() / max(float((rays**2 * keep).sum()), 1e-9))
        off = np.abs(residual - rays * shift).sum(axis=-1, keepdims=True)
        keep = off <= np.quantile(off, 0.8)
    return (z[..., 0] + np.float32(shift)).astype(np.float32)
