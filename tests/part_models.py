"""Model folders of the networks that serve every model, with graphs whose output is known."""

import hashlib
import json
from pathlib import Path
from typing import Literal

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper

from roomlight.engine.lighting import LIGHTING_PANELS
from roomlight.engine.networks.clipping import CHANNELS, SIDE
from roomlight.engine.panorama.panels import HEIGHT

Form = Literal["clipping", "objects"]
SHAPES = {
    "clipping": ("planes", (1, CHANNELS, SIDE, SIDE), "log_radiance", (1, 3, SIDE // 2, SIDE // 2)),
    "objects": ("panels", (1, LIGHTING_PANELS, HEIGHT, 2 * HEIGHT), "change", (1, 3, HEIGHT, 2 * HEIGHT)),
}


def known_graph(form: Form, *, constant: float = 0.0, image: float = 0.0) -> ModelProto:
    """A graph that returns `constant` + `image` x the first channels of its input, averaged to its output."""
    source, shape, target, reduced = SHAPES[form]
    stride = shape[2] // reduced[2]
    numbers = {
        "starts": np.array([0], np.int64),
        "ends": np.array([reduced[1]], np.int64),
        "axes": np.array([1], np.int64),
        "factor": np.array(image, np.float32),
        "constant": np.array(constant, np.float32),
    }
    nodes = [
        helper.make_node("Slice", [source, "starts", "ends", "axes"], ["first"]),
        helper.make_node("AveragePool", ["first"], ["pooled"], kernel_shape=[stride] * 2, strides=[stride] * 2),
        helper.make_node("Mul", ["pooled", "factor"], ["scaled"]),
        helper.make_node("Add", ["scaled", "constant"], [target]),
    ]
    graph = helper.make_graph(
        nodes,
        form,
        [helper.make_tensor_value_info(source, TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info(target, TensorProto.FLOAT, reduced)],
        [numpy_helper.from_array(value, name) for name, value in numbers.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)


def write_part(folder: Path, form: Form, *, constant: float = 0.0, image: float = 0.0, steps: int = 1) -> Path:
    """Write the folder of `known_graph`, as `roomlight export` does; `steps` are those of its card."""
    folder.mkdir(parents=True)
    stored = known_graph(form, constant=constant, image=image).SerializeToString()
    (folder / f"{form}.onnx").write_bytes(stored)
    entry = {"sha256": hashlib.sha256(stored).hexdigest()}
    described = {"format": 1, "form": form, "config": {}, "card": {"steps": steps}, "graphs": {form: entry}}
    (folder / "model.json").write_text(json.dumps(described))
    return folder
