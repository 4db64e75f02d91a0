"""Model folders: missing, foreign, changed or untrained graphs are refused before anything runs."""

import hashlib
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

FORMS_ASKED = ("single", "video", "auto")


@pytest.fixture
def folder(tiny_video, tmp_path):
    """A copy of the model folder that a test may damage."""
    return shutil.copytree(tiny_video[1], tmp_path / "model")


def _load(folder, **options):
    return load_graphs(folder, **{"provider": "cpu", **options})


def _chosen_form(model, **options):
    graphs = choose_graphs(SessionOptions(model=model, **options))
    assert graphs is not None
    return graphs.form


def _edit(folder, **changes):
    index = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps({**index, **changes}))


def test_a_complete_folder_loads_with_its_shapes(folder):
    graphs = _load(folder)
    assert graphs.form == "video"
    assert graphs.volume_shape == (16, 15, 21)
    assert graphs.panorama_height == 32
    assert graphs.runtime == "cpu"
    assert len(graphs.graphs) == 10


def test_untrained_weights_are_refused(folder):
    _edit(folder, card={"steps": 0})
    with pytest.raises(ModelError, match=r"never trained \(steps = 0\).*roomlight train"):
        load_graphs(folder, provider="cpu")
    with pytest.raises(ModelError, match="never trained"):
        Session(SessionOptions(weights=folder, provider="cpu"))


def test_an_empty_card_counts_as_untrained(folder):
    _edit(folder, card={})
    with pytest.raises(ModelError, match="not stated"):
        load_graphs(folder, provider="cpu")


def test_a_changed_graph_is_refused(folder):
    path = folder / "video_sg_gru.onnx"
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(ModelError, match=r"video_sg_gru\.onnx: is not the graph"):
        _load(folder)


@pytest.mark.parametrize("name", ["single_sg_encoder", "video_blend_decoder"])
def test_a_missing_graph_is_named(folder, name):
    (folder / f"{name}.onnx").unlink()
    with pytest.raises(ModelError, match=rf"{name}\.onnx: missing"):
        _load(folder)


def test_a_graph_that_the_index_does_not_name_is_missing(folder):
    index = json.loads((folder / "model.json").read_text())
    del index["graphs"]["single_blend_encoder"]
    _edit(folder, graphs=index["graphs"])
    with pytest.raises(ModelError, match="single_blend_encoder"):
        _load(folder)


@pytest.mark.parametrize(
    "changes",
    [
        {"format": 2},
        {"format": None},
        {"form": "triple"},
        {"form": ["video"]},
        {"graphs": [1, 2]},
        {"graphs": {"single_sg_encoder": "digest"}},
        {"card": ["steps"]},
    ],
)
def test_an_index_of_another_kind_is_refused(folder, changes):
    _edit(folder, **changes)
    with pytest.raises(ModelError, match=r"model\.json|missing"):
        _load(folder)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"\xff\xfe\x00", b'"text"'])
def test_a_malformed_index_is_refused(folder, content):
    (folder / "model.json").write_bytes(content)
    with pytest.raises(ModelError, match=r"model\.json"):
        _load(folder)


def test_a_folder_without_a_model_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"model\.json: cannot be read.*roomlight export"):
        load_graphs(tmp_path)


def test_what_onnx_runtime_refuses_is_named(folder):
    path = folder / "single_sg_encoder.onnx"
    path.write_bytes(b"not a graph")
    index = json.loads((folder / "model.json").read_text())
    index["graphs"]["single_sg_encoder"]["sha256"] = hashlib.sha256(b"not a graph").hexdigest()
    _edit(folder, graphs=index["graphs"])
    with pytest.raises(ModelError, match=r"single_sg_encoder\.onnx: ONNX Runtime cannot load it"):
        _load(folder)


def test_a_single_view_folder_supports_single_and_auto_not_video(folder):
    _edit(folder, form="single")
    options = {"weights": folder, "provider": "cpu"}
    for model in ("single", "auto"):
        assert _chosen_form(model, **options) == "single"
    with pytest.raises(OptionError, match="single-view weights only"):
        choose_graphs(SessionOptions(model="video", **options))


def test_a_video_folder_serves_every_form(folder):
    options = {"weights": folder, "provider": "cpu"}
    forms = {model: _chosen_form(model, **options) for model in FORMS_ASKED}
    assert forms == {"single": "single", "video": "video", "auto": "video"}


def test_shipped_video_weights_serve_every_form(folder, monkeypatch):
    _edit(folder, card={"steps": 1000})
    (folder.parent / "shipped").mkdir()
    folder.rename(folder.parent / "shipped" / "video")
    monkeypatch.setattr(choosing, "SHIPPED", folder.parent / "shipped")
    forms = {model: _chosen_form(model, provider="cpu") for model in ("single", "video", "auto")}
    assert forms == {"single": "single", "video": "video", "auto": "single"}


def test_shipped_single_weights_serve_all_but_video(folder, monkeypatch):
    _edit(folder, card={"steps": 1000}, form="single")
    (folder.parent / "shipped").mkdir()
    folder.rename(folder.parent / "shipped" / "single")
    monkeypatch.setattr(choosing, "SHIPPED", folder.parent / "shipped")
    assert {_chosen_form(model, provider="cpu") for model in ("single", "auto")} == {"single"}
    assert choose_graphs(SessionOptions(model="classical")) is None
    with pytest.raises(ModelError, match=r'model="video": .* no trained weights'):
        choose_graphs(SessionOptions(model="video", provider="cpu"))


def _identity(shape):
    value = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("x", "y")]
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "identity", value[:1], value[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model)
    return OnnxRuntimeGraph(ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]))


def test_a_bound_graph_reads_and_writes_in_place():
    graph = Graph(_identity([2, 3]), "identity")
    x, y = np.zeros((2, 3), np.float32), graph.new_outputs()["y"]
    bound = graph.bind({"x": x}, {"y": y})
    for value in (1, 2):
        x[:] = value
        bound.run()
        assert (y == value).all()


def test_a_graph_without_static_shapes_is_refused():
    with pytest.raises(ModelError, match="graph free: x has the shape"):
        Graph(_identity(["batch", 3]), "free")


@pytest.mark.parametrize(
    ("name", "shape", "message"),
    [("z", (2, 3), r"has \['x'\], the engine gives \['z'\]"), ("x", (2, 4), r"x is \(2, 3\), the engine has \(2, 4\)")],
)
def test_mismatched_buffers_are_refused(name, shape, message):
    graph = Graph(_identity([2, 3]), "identity")
    with pytest.raises(ModelError, match=message):
        graph.bind({name: np.zeros(shape, np.float32)}, graph.new_outputs())


def test_a_buffer_that_would_be_copied_is_refused():
    graph = Graph(_identity([6]), "identity")
    with pytest.raises(ModelError, match="not contiguous"):
        graph.bind({"x": np.zeros((3, 4), np.float32)[:, ::2]}, graph.new_outputs())
