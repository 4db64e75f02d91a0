"""ONNX Runtime, imported with its telemetry switched off: all other modules import `ort` from here.

From version 1.29 on, ONNX Runtime on Linux writes a device id and a database of events under `~/.cache/Microsoft` and
looks up a host of Microsoft when it is loaded. It reads the variable once, at its import.
"""

import os

os.environ["ORT_DISABLE_TELEMETRY"] = "1"

import onnxruntime as ort

__all__ = ["ort"]
