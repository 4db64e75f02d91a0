"""`.ort` files for phones: ONNX Runtime's own format at level `extended`, for its CPU provider.

CoreML and XNNPACK have no 3D convolution, which leaves the CPU provider. `extended` is the highest level that does not
depend on the machine; above it, the memory layout is the exporting CPU's. Folding the weights' Cast makes them float32:
twice the ONNX file's size, but no conversion on the phone.
"""

from pathlib import Path

import numpy as np

from roomlight.engine.networks.graph import Graph as LoadedGraph
from roomlight.engine.networks.runtime import OnnxRuntimeGraph, ort
from roomlight.errors import ModelError
from roomlight_export.graphs import Graph
from roomlight_export.parity import difference, session_runner


def write_ort(source: Path, target: Path, graph: Graph, *, tolerance: float) -> None:
    """Convert an ONNX file, load the result, and compare both on the same input.

    Raises:
        ModelError: The outputs differ by more than `tolerance`.
    """
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_EXTENDED
    options.optimized_model_filepath = str(target)
    options.log_severity_level = 3
    options.add_session_config_entry("session.save_model_format", "ORT")
    converted = ort.InferenceSession(str(source), options, providers=["CPUExecutionProvider"])

    options = ort.SessionOptions()
    options.log_severity_level = 3
    options.add_session_config_entry("session.load_model_format", "ORT")
    loaded = ort.InferenceSession(str(target), options, providers=["CPUExecutionProvider"])

    random = np.random.default_rng(0)
    inputs = {name: random.random(shape, dtype=np.float32) for name, shape in graph.inputs.items()}
    wanted, outputs = (
        session_runner({graph.name: LoadedGraph(OnnxRuntimeGraph(session), graph.name)})(graph.name, inputs)
        for session in (converted, loaded)
    )
    for name, value in wanted.items():
        worst = difference(name, outputs[name], value)
        if not worst <= tolerance:
            raise ModelError(f"{target.name}: differs from its ONNX graph by {worst:.2g} in {name}")
