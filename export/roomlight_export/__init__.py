"""From PyTorch checkpoints to verified ONNX graphs."""
