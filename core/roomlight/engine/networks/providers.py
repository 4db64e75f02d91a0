"""Execution providers of ONNX graphs: the OpenVINO plugin if it supports this processor, else the CPU provider."""

import importlib
import importlib.util
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Literal

from roomlight.engine.networks.runtime import ort
from roomlight.errors import ModelError
from roomlight.threads import thread_count

Provider = Literal["auto", "cpu", "openvino"]
_PLUGIN = "onnxruntime_ep_openvino"


@cache
def openvino_device() -> "ort.OrtEpDevice | None":
    """Return the OpenVINO plugin's CPU device; None if it is not installed or does not support this processor."""
    if importlib.util.find_spec(_PLUGIN) is None:
        return None
    plugin = importlib.import_module(_PLUGIN)
    ort.register_execution_provider_library("roomlight_openvino", plugin.get_library_path())
    for device in ort.get_ep_devices():
        if device.ep_name == plugin.get_ep_name() and device.device.type == ort.OrtHardwareDeviceType.CPU:
            return device
    return None


def resolve_provider(provider: Provider) -> Literal["cpu", "openvino"]:
    """Return the provider that is used on this machine; `auto` prefers OpenVINO.

    Raises:
        ModelError: OpenVINO is requested and not available.
    """
    if provider == "cpu":
        return "cpu"
    available = openvino_device() is not None
    if provider == "openvino" and not available:
        installed = importlib.util.find_spec(_PLUGIN) is not None
        reason = (
            "does not support this processor" if installed else "is not installed (pip install 'roomlight[openvino]')"
        )
        raise ModelError(f'provider="openvino": the plugin {_PLUGIN} {reason}; use provider="cpu"')
    return "openvino" if available else "cpu"


def open_graph(path: Path, provider: Literal["cpu", "openvino"]) -> ort.InferenceSession:
    """Load one graph.

    Raises:
        ModelError: ONNX Runtime refuses it.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = thread_count()
    options.log_severity_level = 3
    # Spinning threads would take the second core from the ray tracing that runs between two graphs.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # Hidden states that decay towards zero become denormals, which are 100 times slower than zero.
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    if provider == "openvino":
        # bf16 if the processor has it (AMX): 6 to 7 times as fast as the CPU provider; stated, not left to a default
        config = '{"CPU": {"INFERENCE_PRECISION_HINT": "bf16"}}'
        options.add_provider_for_devices([openvino_device()], {"load_config": config})
    providers = None if provider == "openvino" else ["CPUExecutionProvider"]
    # Opened in a separate thread: with denormals as zero, ONNX Runtime changes the floating-point mode of the opening
    # thread for good, and the caller's thread must keep its own.
    with ThreadPoolExecutor(1) as opener:
        opening = opener.submit(ort.InferenceSession, str(path), sess_options=options, providers=providers)
    error = opening.exception()
    if error is not None:  # ONNX Runtime's exceptions share no base class
        raise ModelError(f"{path}: ONNX Runtime cannot load it ({str(error).splitlines()[0]})") from error
    return opening.result()
