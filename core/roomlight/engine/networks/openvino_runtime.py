"""OpenVINO as a runtime of graphs: an optional package, for processors on which it is faster than ONNX Runtime.

fp32 as in ONNX Runtime: every output agrees within `TOLERANCE` of its largest value. With bf16, which OpenVINO would
choose where the processor has it, the 3D encoder is off by a tenth.
"""

import importlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final

from roomlight.engine.networks.runtime import Buffers, RuntimeName, Shapes
from roomlight.errors import ModelError
from roomlight.threads import thread_count

TOLERANCE: Final = 1e-4
"""Largest difference from ONNX Runtime's output, relative to the output's largest value."""


@cache
def openvino_version() -> str | None:
    """Return the version of the package `openvino`; None if it is not installed."""
    if importlib.util.find_spec("openvino") is None:
        return None
    return importlib.metadata.version("openvino")


@cache
def _openvino() -> Any:  # the package is optional, and its types are not here without it
    # Its converter reports the import to Google Analytics; without it the import is faster, too.
    converter = "openvino.tools.ovc"
    blocked = converter not in sys.modules
    if blocked:
        sys.modules[converter] = None  # type: ignore[assignment]  # the documented way to make an import fail
    try:
        return importlib.import_module("openvino")
    finally:
        if blocked:
            del sys.modules[converter]


@cache
def _core() -> Any:
    core = _openvino().Core()
    core.set_property(
        "CPU",
        {
            "INFERENCE_PRECISION_HINT": "f32",
            "INFERENCE_NUM_THREADS": str(thread_count()),
            "NUM_STREAMS": "1",
            "ENABLE_CPU_PINNING": "NO",  # it would pin the caller's thread
            "CPU_DENORMALS_OPTIMIZATION": "NO",  # it would change the caller's thread, and gains nothing
        },
    )
    return core


class OpenVinoGraph:
    """A graph in OpenVINO. Threads that run it at the same time take turns: a run uses all cores."""

    runtime: RuntimeName = "openvino"

    def __init__(self, compiled: Any) -> None:
        self._compiled = compiled
        self.inputs: Shapes = _shapes(compiled.inputs)
        self.outputs: Shapes = _shapes(compiled.outputs)

    @classmethod
    def open(cls, path: Path) -> "OpenVinoGraph":
        """Load and compile a graph.

        Raises:
            ModelError: OpenVINO refuses it.
        """
        try:
            return cls(_core().compile_model(_core().read_model(str(path)), "CPU"))
        except RuntimeError as error:
            raise ModelError(f"{path}: OpenVINO cannot load it ({str(error).splitlines()[0]})") from error

    def bind(self, inputs: Buffers, outputs: Buffers) -> Callable[[], object]:
        """Make a request whose tensors are the buffers."""
        request, tensor = self._compiled.create_infer_request(), _openvino().Tensor
        for name, array in {**inputs, **outputs}.items():
            request.set_tensor(name, tensor(array, shared_memory=True))
        return request.infer


def _shapes(ports: Any) -> Shapes:
    return {port.any_name: tuple(size if isinstance(size, int) else str(size) for size in port.shape) for port in ports}
