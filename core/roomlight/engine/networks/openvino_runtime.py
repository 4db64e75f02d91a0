"""OpenVINO as a runtime of graphs, for processors on which it is faster than ONNX Runtime.

In fp32 every output agrees with ONNX Runtime's within `TOLERANCE` of its largest value; in bf16, for processors that
compute in it, the light does within `BF16_TOLERANCE`.
"""

import importlib
import importlib.metadata
import importlib.util
import sys
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

from roomlight.engine.networks.runtime import Buffers, RuntimeName, Shapes
from roomlight.errors import ModelError
from roomlight.threads import in_forks, thread_count

TOLERANCE: Final = 1e-4
"""Largest difference from ONNX Runtime's output, relative to the output's largest value."""
BF16_TOLERANCE: Final = 0.01
"""Largest root mean square difference of log(1 + light) of a session's panoramas in bf16 from fp32."""
OpenVinoRuntime = Literal["openvino", "openvino-bf16"]


@cache
def openvino_version() -> str | None:
    """Return the version of the package `openvino`; None if it is not installed."""
    if importlib.util.find_spec("openvino") is None:
        return None
    return importlib.metadata.version("openvino")


@cache
def _openvino() -> Any:  # imported only when a graph needs it: that takes 0.14 s
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
            "INFERENCE_NUM_THREADS": str(thread_count()),
            "NUM_STREAMS": "1",
            "ENABLE_CPU_PINNING": "NO",  # it would pin the caller's thread
            "CPU_DENORMALS_OPTIMIZATION": "NO",  # it would change the caller's thread, and gains nothing
        },
    )
    return core


_of_parent = threading.Event()


def lost_by_fork() -> bool:
    """Return whether this process was forked from one that had used OpenVINO: compiling a graph would never end."""
    return _of_parent.is_set()


in_forks(lambda: _core.cache_info().currsize > 0 and _of_parent.set())


@cache
def computes_in_bf16() -> bool:
    """Return whether OpenVINO is installed and the processor computes in bf16 (AVX-512 BF16 or AMX)."""
    return openvino_version() is not None and "BF16" in _core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")


class OpenVinoGraph:
    """A graph in OpenVINO. Threads that run it at the same time take turns: a run uses all cores."""

    def __init__(self, compiled: Any, runtime: OpenVinoRuntime) -> None:
        self._compiled = compiled
        self.runtime: RuntimeName = runtime
        self.inputs: Shapes = _shapes(compiled.inputs)
        self.outputs: Shapes = _shapes(compiled.outputs)

    @classmethod
    def open(cls, path: Path, runtime: OpenVinoRuntime) -> "OpenVinoGraph":
        """Load and compile a graph.

        Raises:
            ModelError: OpenVINO refuses it.
        """
        precision = {"INFERENCE_PRECISION_HINT": "bf16" if runtime == "openvino-bf16" else "f32"}
        try:
            return cls(_core().compile_model(_core().read_model(str(path)), "CPU", precision), runtime)
        except RuntimeError as error:
            raise ModelError(f"{path}: OpenVINO cannot load it ({str(error).splitlines()[0]})") from error

    def bind(self, inputs: Buffers, outputs: Buffers) -> Callable[[], object]:
        """Return what `OnnxRuntimeGraph.bind` does: a request whose tensors are the buffers."""
        request, tensor = self._compiled.create_infer_request(), _openvino().Tensor
        for name, array in {**inputs, **outputs}.items():
            request.set_tensor(name, tensor(array, shared_memory=True))
        return request.infer


def _shapes(ports: Any) -> Shapes:
    return {port.any_name: tuple(size if isinstance(size, int) else str(size) for size in port.shape) for port in ports}
