"""The session engine: ONNX Runtime, NumPy and numba only; never PyTorch."""
