"""Load a model folder into PyTorch with `load_exported`, so that training can continue from shipped weights.

The files hold weights in half precision (`onnx_file`) under their names in the networks. The exporter unfolds group
normalisations and drops their weights' names; the convolution before each identifies them. The loaded weights are the
checkpoint's, rounded to half precision, as the graphs use them.
"""

import hashlib
from pathlib import Path

import numpy as np
import onnx
import torch
from jaxtyping import Float
from onnx import GraphProto, numpy_helper

from roomlight.engine.networks.graphs import DESCRIPTION, read_description
from roomlight.errors import ModelError
from roomlight_export.graphs import Graph, graphs_of
from roomlight_model.checkpoint import Checkpoint, build_network, load_checkpoint
from roomlight_model.config import ModelConfig


def load_weights(path: Path) -> Checkpoint:
    """Load a checkpoint file, or a model folder of `roomlight export`. Raises ModelError."""
    return load_exported(path) if path.is_dir() else load_checkpoint(path)


def load_exported(folder: Path) -> Checkpoint:
    """Load the networks of a model folder into PyTorch, with the folder's card.

    Raises:
        ModelError: The folder is not a model folder, a graph is not the one in `model.json`, or a weight is missing
            or does not fit.
    """
    described = read_description(folder)
    try:
        config = ModelConfig.from_dict(described["config"])
        model = build_network(described["form"], config)
    except ModelError as error:
        raise ModelError(f"{folder / DESCRIPTION}: {error}") from error
    for graph in graphs_of(model):
        _fill(graph, folder / f"{graph.name}.onnx", described["graphs"].get(graph.name))
    return Checkpoint(described["form"], config, model.eval(), described["card"])


def _fill(graph: Graph, path: Path, entry: object) -> None:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error}); export the checkpoint again") from error
    if not isinstance(entry, dict) or hashlib.sha256(data).hexdigest() != entry.get("sha256"):
        raise ModelError(f"{path}: is not the graph that {DESCRIPTION} names: the digest differs; export again")
    stored = _weights(onnx.load_from_string(data).graph)
    with torch.no_grad():
        for name, weight in graph.module.named_parameters():
            value = stored.get(name)
            if value is None:
                raise ModelError(f"{path}: holds no weight {name}; it is untrained, or of another version")
            if value.shape != weight.shape:
                raise ModelError(
                    f"{path}: weight {name} is {value.shape}, the configuration asks for {tuple(weight.shape)}"
                )
            weight.copy_(torch.from_numpy(value))


def _weights(graph: GraphProto) -> dict[str, Float[np.ndarray, "..."]]:
    """Return a graph's constants by name, with those of normalisations by the names of their modules."""
    weights = {
        tensor.name.removesuffix(".half"): numpy_helper.to_array(tensor).astype(np.float32)
        for tensor in graph.initializer
    }
    makes = {output: node for node in graph.node for output in node.output}
    uses = {given: node for node in graph.node for given in node.input}
    for node in graph.node:
        if node.op_type != "InstanceNormalization":
            continue
        # convolution, reshape, normalisation, reshape, Mul by the weight, Add of the bias
        convolution = makes[makes[node.input[0]].input[0]]
        scale = uses[uses[node.output[0]].output[0]]
        shift = uses[scale.output[0]]
        sequence, _, place = convolution.input[1].removesuffix(".weight").rpartition(".")
        for name, step in (("weight", scale), ("bias", shift)):
            if step.input[1] in weights:  # the exporter omits ones and zeros, which untrained networks have
                weights[f"{sequence}.{int(place) + 1}.{name}"] = weights[step.input[1]].reshape(-1)
    return weights
