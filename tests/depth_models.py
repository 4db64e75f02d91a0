"""Models that answer with a given depth, whatever they are shown: in Python, and as tiny ONNX graphs."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from roomlight.camera import Intrinsics
from roomlight.monocular.estimate import DepthEstimate, DepthKind

SIZE = (28, 42)
"""Rows and columns of the graphs' pictures and answers."""


class StatedDepth:
    """A model that answers its n-th call with `inverse_of(n)`."""

    name = "stated.onnx"

    def __init__(self, kind: DepthKind, inverse_of: Callable[[int], np.ndarray]) -> None:
        self.kind: DepthKind = kind
        self.told: list[np.ndarray | None] = []  # the up direction in each call
        self._inverse_of = inverse_of

    def estimate(self, picture: np.ndarray, intrinsics: Intrinsics, up: np.ndarray | None = None) -> DepthEstimate:
        assert picture.shape[:2] == (intrinsics.height, intrinsics.width)
        inverse = self._inverse_of(len(self.told)).astype(np.float32)
        self.told.append(up)
        return DepthEstimate(inverse, np.ones_like(inverse), self.kind)


def write_depth_model(
    path: Path,
    outputs: dict[str, np.ndarray],
    *,
    picture: str = "pixel_values",
    shape: tuple[int | str, ...] = (1, 3, *SIZE),
    kind: int = TensorProto.FLOAT,
    others: Mapping[str, tuple[int, tuple[int, ...]]] | None = None,
) -> Path:
    """Write a graph that answers with constants, whatever it is given."""
    inputs = [helper.make_tensor_value_info(picture, kind, list(shape))]
    inputs += [helper.make_tensor_value_info(name, *given) for name, given in (others or {}).items()]
    nodes, values, infos = [], [], []
    for name, value in outputs.items():
        values.append(numpy_helper.from_array(value.astype(np.float32), f"{name}_value"))
        nodes.append(helper.make_node("Identity", [f"{name}_value"], [name]))
        infos.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, list(value.shape)))
    graph = helper.make_graph(nodes, "depth", inputs, infos, values)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path
