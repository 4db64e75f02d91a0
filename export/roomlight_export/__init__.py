"""Export PyTorch checkpoints to verified ONNX graphs, and import them back.

Start at `exporting.export_checkpoint`; `graphs` has the names and shapes of the graphs, `parity` compares them with
PyTorch, `importing` loads a model folder for further training. Needs PyTorch.
"""
