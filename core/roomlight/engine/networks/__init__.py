"""Networks of the engine: ONNX graphs, execution providers, and the models that use them."""
