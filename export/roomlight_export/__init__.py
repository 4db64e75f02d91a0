"""Export PyTorch checkpoints to verified ONNX graphs, and import them back."""
