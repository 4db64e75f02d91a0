"""Convert a graph to an ONNX model: static shapes, weights in half precision, metadata; the result is checked.

Weights are float16 initializers followed by a Cast to float32: half the download size, computed in float32. ONNX
Runtime and OpenVINO fold the Cast when they create a session.
"""

import copy
import logging
import warnings
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
import onnx
import torch
from onnx import ModelProto, TensorProto, helper, numpy_helper
from torch import nn

from roomlight.errors import ModelError
from roomlight_export.graphs import Graph

_Network = TypeVar("_Network", bound=nn.Module)

OPSET = 20
"""The oldest opset with all operators used here; OpenVINO and the CPU providers of phones support it."""


def half_rounded(module: _Network, name: str) -> _Network:
    """Copy a network with every weight rounded to float16 but kept in float32: the precision of the files.

    Raises:
        ModelError: A weight is beyond float16's range.
    """
    rounded = copy.deepcopy(module).eval()
    with torch.no_grad():
        for key, weight in rounded.named_parameters():
            half = weight.half().float()
            if not torch.isfinite(half).all():
                largest = float(weight.abs().max())
                raise ModelError(f"{name}: weight {key} reaches {largest:g}, beyond half precision (65504)")
            weight.copy_(half)
    return rounded


def to_onnx(graph: Graph, *, metadata: Mapping[str, str]) -> ModelProto:
    """Trace a graph whose weights are `half_rounded`, store them as float16, and check the result.

    Raises:
        ModelError: The graph does not export, or its inputs and outputs are not the stated ones.
    """
    with _quiet():
        program = torch.onnx.export(
            graph.module.eval(),
            tuple(torch.zeros(shape) for shape in graph.inputs.values()),
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise ModelError(f"{graph.name}: the exporter gave no program")
    model = program.model_proto
    _strip_traces(model)
    _store_half(model)
    for key, value in metadata.items():
        model.metadata_props.add(key=key, value=value)
    _check(model, graph)
    return model


@contextmanager
def _quiet() -> Generator[None]:
    """Silence the exporter's messages about torchvision and its own deprecations."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _strip_traces(model: ModelProto) -> None:
    """Remove the stack traces that the exporter adds to each node: half the bytes, and local paths."""
    parts = [model, model.graph, *model.graph.node, *model.graph.value_info]
    parts += [*model.graph.input, *model.graph.output, *model.graph.initializer]
    for part in parts:
        part.ClearField("doc_string")
        part.ClearField("metadata_props")


def _store_half(model: ModelProto) -> None:
    """Store as float16 every float32 initializer that float16 holds exactly; scalars stay as they are.

    Weights were rounded before tracing, so the graph computes the same as before to the last bit.
    """
    casts: list[onnx.NodeProto] = []
    for tensor in model.graph.initializer:
        if tensor.data_type != TensorProto.FLOAT:
            continue
        value = numpy_helper.to_array(tensor)
        with np.errstate(over="ignore"):
            half = value.astype(np.float16)
        if value.size < 2 or not np.array_equal(half.astype(np.float32), value):
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(half, f"{name}.half"))
        casts.append(helper.make_node("Cast", [f"{name}.half"], [name], name=f"{name}.cast", to=TensorProto.FLOAT))
    nodes = list(model.graph.node)
    del model.graph.node[:]
    model.graph.node.extend(casts + nodes)


def _check(model: ModelProto, graph: Graph) -> None:
    try:
        onnx.checker.check_model(model, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise ModelError(f"{graph.name}: the exported graph is not valid ONNX ({error})") from error
    opset = {entry.domain: entry.version for entry in model.opset_import}.get("", 0)
    if opset < OPSET:
        raise ModelError(f"{graph.name}: exported at opset {opset}; {OPSET} or newer is needed")
    for kind, entries, wanted in (
        ("input", model.graph.input, graph.inputs),
        ("output", model.graph.output, graph.outputs),
    ):
        shapes = {
            entry.name: tuple(int(axis.dim_value) for axis in entry.type.tensor_type.shape.dim) for entry in entries
        }
        if shapes != {name: tuple(shape) for name, shape in wanted.items()}:
            raise ModelError(f"{graph.name}: its {kind}s are {shapes}; expected {wanted}")
