"""Export of the networks that serve every model: parity with PyTorch, the folder, refusals."""

import hashlib
import json

import numpy as np
import onnxruntime
import pytest
import torch

from roomlight.engine.networks.graphs import load_part
from roomlight.errors import ModelError, OutputError
from roomlight_export.onnx_file import half_rounded
from roomlight_export.parts import export_part, part_graph
from roomlight_model.clipping_network import ClippingNetwork
from roomlight_model.completion_network import PanelsNetwork
from roomlight_model.part_checkpoint import build_part, save_part_checkpoint

FORMS = ("clipping", "completion", "objects")


def network(form):
    """A network with random weights everywhere: the heads begin near zero."""
    torch.manual_seed(4)
    built = build_part(form)
    assert isinstance(built, ClippingNetwork | PanelsNetwork)
    head = built.head if isinstance(built, ClippingNetwork) else built.head.conv
    torch.nn.init.normal_(head.weight, std=0.1)
    return built.eval()


@pytest.fixture
def checkpoint(request, tmp_path):
    path = tmp_path / f"{request.param}.pt"
    save_part_checkpoint(path, request.param, network(request.param), card={"steps": 7, "scores": {"loss": 0.5}})
    return path


@pytest.mark.parametrize("checkpoint", FORMS, indirect=True)
def test_an_exported_part_is_described_and_loads(checkpoint, tmp_path):
    form = checkpoint.stem
    report = export_part(checkpoint, tmp_path / "out")
    assert (report.form, report.graphs) == (form, (form,))
    assert report.parameters == sum(weight.numel() for weight in network(form).parameters())
    described = json.loads((tmp_path / "out" / "model.json").read_text())
    stored = (tmp_path / "out" / f"{form}.onnx").read_bytes()
    assert described["graphs"][form]["sha256"] == hashlib.sha256(stored).hexdigest()
    assert described["card"] == {"steps": 7, "scores": {"loss": 0.5}}
    assert described["parity"]["largest"] <= described["parity"]["tolerance"]
    assert report.onnx_bytes == len(stored) < 5e6
    graph = load_part(tmp_path / "out", form, provider="cpu")
    expected = part_graph(form, network(form))
    assert (graph.inputs, graph.outputs) == (expected.inputs, expected.outputs)


@pytest.mark.parametrize("checkpoint", FORMS, indirect=True)
def test_the_graph_equals_pytorch(checkpoint, tmp_path):
    export_part(checkpoint, tmp_path / "out")
    form = checkpoint.stem
    file = tmp_path / "out" / f"{form}.onnx"
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    ((name, shape),) = part_graph(form, network(form)).inputs.items()
    values = np.random.default_rng(8).random(shape).astype(np.float32)
    (found,) = session.run(None, {name: values})
    with torch.no_grad():
        wanted = half_rounded(network(form), form)(torch.from_numpy(values)).numpy()
        original = network(form)(torch.from_numpy(values)).numpy()
    assert found == pytest.approx(wanted, abs=1e-4)  # another order of summation
    assert wanted.std() > 0.01
    assert found == pytest.approx(original, abs=0.02)  # weights of half precision


@pytest.mark.parametrize("checkpoint", ["clipping"], indirect=True)
def test_a_graph_that_differs_is_not_written(checkpoint, tmp_path):
    with pytest.raises(ModelError, match=r"differs from PyTorch by .* nothing was written"):
        export_part(checkpoint, tmp_path / "out", tolerance=-1.0)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("checkpoint", ["clipping"], indirect=True)
def test_export_replaces_a_model_and_nothing_else(checkpoint, tmp_path):
    export_part(checkpoint, tmp_path / "out")
    export_part(checkpoint, tmp_path / "out")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "cat.jpg").write_text("")
    with pytest.raises(OutputError, match="other"):
        export_part(checkpoint, tmp_path / "other")
    assert (tmp_path / "other" / "cat.jpg").exists()


def test_a_damaged_checkpoint_is_not_exported(tmp_path):
    (tmp_path / "weights.pt").write_bytes(b"nonsense")
    with pytest.raises(ModelError, match=r"weights\.pt: not the checkpoint"):
        export_part(tmp_path / "weights.pt", tmp_path / "out")
    assert not (tmp_path / "out").exists()
