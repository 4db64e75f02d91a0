"""ONNX Runtime, imported with its telemetry switched off: all other modules import `ort` from here.

From version 1.29 on, ONNX Runtime on Linux writes a device id and a database of events under `~/.cache/Microsoft` and
looks up a host of Microsoft when it is loaded. It reads the variable once, at its import.
"""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, Literal

import numpy as np
from jaxtyping import Float32

from roomlight.errors import ModelError
from roomlight.threads import thread_count

os.environ["ORT_DISABLE_TELEMETRY"] = "1"

import onnxruntime as ort

Buffers = dict[str, Float32[np.ndarray, "..."]]
"""Arrays by the names of a graph's inputs or outputs; their ranks differ, `Graph.bind` checks the shapes."""
RuntimeName = Literal["cpu", "openvino", "openvino-bf16", "cuda"]
"""ONNX Runtime's CPU provider, OpenVINO in fp32 or bf16, or ONNX Runtime's CUDA provider."""
CUDA: Final = "CUDAExecutionProvider"
Shapes = dict[str, tuple[int | str, ...]]
"""Shapes by the names of a graph's inputs or outputs; a dynamic size has a name."""


class OnnxRuntimeGraph:
    """A graph in ONNX Runtime, without state: threads may run it at the same time, each on buffers of its own."""

    def __init__(self, session: ort.InferenceSession, path: Path | None = None) -> None:
        self._session, self._name = session, str(path or "the graph")
        self.runtime: RuntimeName = "cuda" if CUDA in session.get_providers() else "cpu"
        self.inputs: Shapes = {node.name: tuple(node.shape) for node in session.get_inputs()}
        self.outputs: Shapes = {node.name: tuple(node.shape) for node in session.get_outputs()}
        self.types = {node.name: _NUMPY.get(node.type) for node in session.get_inputs()}

    @classmethod
    def open(cls, path: Path, runtime: Literal["cpu", "cuda"] = "cpu") -> "OnnxRuntimeGraph":
        """Load a graph.

        Raises:
            ModelError: ONNX Runtime refuses it, or has no working CUDA.
        """
        options = ort.SessionOptions()
        options.intra_op_num_threads = thread_count()
        options.log_severity_level = 3
        # Spinning threads would take the second core from the ray tracing that runs between two graphs.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # Hidden states that decay towards zero become denormals, which are 100 times slower than zero.
        options.add_session_config_entry("session.set_denormal_as_zero", "1")
        if runtime == "cuda":
            ort.preload_dlls()  # of PyPI's NVIDIA packages, where the dynamic linker does not look
        # Opened in a separate thread: with denormals as zero, ONNX Runtime changes the floating-point mode of the
        # opening thread for good, and the caller's thread must keep its own.
        with ThreadPoolExecutor(1) as opener:
            # TF32, the default on newer GPUs, keeps 10 bits of each product: light would differ in its third digit
            wanted = [(CUDA, {"use_tf32": "0"})] if runtime == "cuda" else ["CPUExecutionProvider"]
            opening = opener.submit(ort.InferenceSession, str(path), options, providers=wanted)
        error = opening.exception()
        if error is not None:  # ONNX Runtime's exceptions share no base class
            raise ModelError(f"{path}: ONNX Runtime cannot load it ({str(error).splitlines()[0]})") from error
        graph = cls(opening.result(), path)
        if graph.runtime != runtime:  # it falls back to the CPU with a warning
            raise ModelError(
                'provider="cuda": ONNX Runtime found no GPU, or not the CUDA libraries that it needs (pip install '
                "'onnxruntime-gpu[cuda,cudnn]')"
            )
        return graph

    def bind(self, inputs: Buffers, outputs: Buffers) -> Callable[[], object]:
        """Return a function that runs the graph on these buffers, which the caller keeps alive; nothing is copied.

        The buffers fit: contiguous, of the graph's names and shapes.
        """
        session, binding = self._session, self._session.io_binding()
        for name, array in inputs.items():
            binding.bind_ortvalue_input(name, ort.OrtValue.ortvalue_from_numpy(array))
        for name, array in outputs.items():
            binding.bind_ortvalue_output(name, ort.OrtValue.ortvalue_from_numpy(array))
        return lambda: session.run_with_iobinding(binding)

    def run(self, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Run the graph on arrays of any shape, in the types that it declares; for graphs with dynamic shapes.

        Raises:
            ModelError: ONNX Runtime fails on them.
        """
        unknown = [name for name, kind in self.types.items() if kind is None]
        if unknown:
            raise ModelError(f"{self._name}: the type of its input {unknown[0]} is none of {', '.join(_NUMPY)}")
        feed = {name: np.ascontiguousarray(array, self.types[name]) for name, array in inputs.items()}
        try:
            values = self._session.run(None, feed)
        except Exception as error:  # ONNX Runtime's exceptions share no base class
            raise ModelError(f"{self._name}: ONNX Runtime fails on it ({str(error).splitlines()[0]})") from error
        return dict(zip(self.outputs, map(np.asarray, values), strict=True))


_NUMPY: Final = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
}
