"""Model folders: missing, foreign, changed or untrained graphs are refused before anything runs."""

import json
import shutil

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper

from roomlight.engine.models import choosing
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graph import Graph
from roomlight.engine.networks.graphs import load_graphs
from roomlight.engine.networks.runtime import OnnxRuntimeGraph
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import ModelError, OptionError


@pytest.fixture
def folder(tiny_video, tmp_path):
    """A copy of the model folder that a test may damage."""
    return shutil.copytree(tiny_video, tmp_path / "model")


def _load(folder, **options):
    return load_graphs(folder, **{"provider": "cpu", **options})


def _edit(folder, **changes):
    index = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps({**index, **changes}))


def test_a_complete_folder_loads_with_its_shapes(folder):
    graphs = _load(folder)
    assert graphs.form == "video"
    assert graphs.volume_shape == (16, 15, 21)
    assert graphs.panorama_height == 32
    assert graphs.graphs["single_sg_encoder"].runtime == "cpu"
    assert len(graphs.graphs) == 10


@pytest.mark.parametrize(
    ("card", "message"), [({"steps": 0}, r"never trained \(steps = 0\).*train"), ({}, "not stated")]
)
def test_untrained_weights_are_refused(folder, card, message):
    _edit(folder, card=card)
    with pytest.raises(ModelError, match=message):
        load_graphs(folder, provider="cpu")
    with pytest.raises(ModelError, match="never trained"):
        Session(SessionOptions(weights=folder, provider="cpu"))


def test_damaged_graphs_are_named(folder):
    index = json.loads((folder / "model.json").read_text())
    _edit(folder, graphs={name: graph for name, graph in index["graphs"].items() if name != "single_blend_encoder"})
    with pytest.raises(ModelError, match="single_blend_encoder"):
        _load(folder)
    _edit(folder, **index)
    path = folder / "video_sg_gru.onnx"
    whole = path.read_bytes()
    path.write_bytes(whole + b"\0")
    with pytest.raises(ModelError, match=r"video_sg_gru\.onnx: is not the graph"):
        _load(folder)
    path.write_bytes(whole)
    for name in ("video_blend_decoder", "single_sg_encoder"):
        (folder / f"{name}.onnx").unlink()
        with pytest.raises(ModelError, match=rf"{name}\.onnx: missing"):
            _load(folder)


@pytest.mark.parametrize("changes", [
    {"format": 2}, {"format": None}, {"form": "triple"}, {"form": ["video"]}, {"graphs": [1, 2]},
    {"graphs": {"single_sg_encoder": "digest"}}, {"card": ["steps"]},
])  # fmt: skip
def test_an_index_of_another_kind_is_refused(folder, changes):
    _edit(folder, **changes)
    with pytest.raises(ModelError, match=r"model\.json|missing"):
        _load(folder)


def test_a_malformed_index_is_refused(folder, tmp_path):
    for content in (b"", b"{", b"[]", b"null", b"\xff\xfe\x00", b'"text"'):
        (folder / "model.json").write_bytes(content)
        with pytest.raises(ModelError, match=r"model\.json"):
            _load(folder)
    with pytest.raises(ModelError, match=r"model\.json: cannot be read.*roomlight export"):
        load_graphs(tmp_path)


@pytest.mark.parametrize("shipped", [False, True])
@pytest.mark.parametrize("form", ["single", "video"])
def test_a_folder_serves_its_own_form_and_those_below(folder, monkeypatch, form, shipped):
    _edit(folder, form=form, card={"steps": 1000})
    if shipped:
        (folder.parent / "shipped").mkdir()
        folder.rename(folder.parent / "shipped" / form)
        monkeypatch.setattr(choosing, "SHIPPED", folder.parent / "shipped")

    def chosen(model):
        graphs = choose_graphs(SessionOptions(model=model, provider="cpu", weights=None if shipped else folder))
        return graphs and graphs.form

    assert chosen("single") == "single"
    assert chosen("auto") == ("single" if shipped else form)
    assert chosen("classical") is None
    if form == "video":
        assert chosen("video") == "video"
        return
    error, message = (ModelError, "no trained weights") if shipped else (OptionError, "single-view weights only")
    with pytest.raises(error, match=message):
        chosen("video")


def _identity(shape):
    value = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("x", "y")]
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "identity", value[:1], value[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model)
    return OnnxRuntimeGraph(ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]))


def test_buffers_that_do_not_fit_are_refused():
    with pytest.raises(ModelError, match="graph free: x has the shape"):
        Graph(_identity(["batch", 3]), "free")
    graph = Graph(_identity([2, 3]), "identity")
    for name, buffer, message in (
        ("z", np.zeros((2, 3), np.float32), r"has \['x'\], the engine gives \['z'\]"),
        ("x", np.zeros((2, 4), np.float32), r"x is \(2, 3\), the engine has \(2, 4\)"),
        ("x", np.zeros((2, 6), np.float32)[:, ::2], "not contiguous"),
    ):
        with pytest.raises(ModelError, match=message):
            graph.bind({name: buffer}, graph.new_outputs())
