"""Export of the small networks, which serve every model: parity with PyTorch, the folder, the way back."""

import hashlib
import json

import numpy as np
import onnxruntime
import pytest
import torch

from roomlight.engine.networks.graphs import SHIPPED, load_part
from roomlight.errors import ModelError
from roomlight_export.exporting import export_checkpoint
from roomlight_export.graphs import graphs_of
from roomlight_export.importing import load_exported
from roomlight_export.inputs import random_planes
from roomlight_export.onnx_file import half_rounded
from roomlight_model.checkpoint import build_network, load_checkpoint, save_checkpoint
from roomlight_model.config import ModelConfig

FORMS = ("clipping", pytest.param("objects", marks=pytest.mark.slow))
CARD = {"steps": 7, "scores": {"loss": 0.5}}


def network(form):
    """A network in which every weight differs from every other, as in trained ones: heads and biases begin at zero."""
    torch.manual_seed(4)
    built = build_network(form, ModelConfig())
    with torch.no_grad():
        for weight in built.parameters():
            weight += 0.05 * torch.randn_like(weight)
    return built.eval()


@pytest.fixture(scope="module", params=FORMS)
def exported(request, tmp_path_factory):
    """(form, checkpoint, model folder, report)."""
    folder = tmp_path_factory.mktemp(request.param)
    checkpoint = folder / "weights.pt"
    save_checkpoint(checkpoint, network(request.param), card=CARD)
    return request.param, checkpoint, folder / "out", export_checkpoint(checkpoint, folder / "out", ort=False)


def test_an_exported_network_is_described_and_loads(exported):
    form, _, folder, report = exported
    assert (report.form, report.graphs, set(report.parity)) == (form, (form,), {form})
    assert report.parameters == sum(weight.numel() for weight in network(form).parameters())
    described = json.loads((folder / "model.json").read_text())
    stored = (folder / f"{form}.onnx").read_bytes()
    assert described["graphs"][form]["sha256"] == hashlib.sha256(stored).hexdigest()
    assert (described["card"], described["config"]) == (CARD, {})
    assert max(described["parity"][form]["error"].values()) <= described["parity"]["tolerance"]
    assert report.onnx_bytes == len(stored) < 5e6
    graph = load_part(folder, form, provider="cpu")
    (expected,) = graphs_of(network(form))
    assert (graph.inputs, graph.outputs) == (expected.inputs, expected.outputs)


def test_the_graph_equals_pytorch(exported):
    form, _, folder, _ = exported
    session = onnxruntime.InferenceSession(folder / f"{form}.onnx", providers=["CPUExecutionProvider"])
    (graph,) = graphs_of(network(form))
    ((name, shape),) = graph.inputs.items()
    values = np.random.default_rng(8).random(shape).astype(np.float32)
    (found,) = session.run(None, {name: values})
    with torch.no_grad():
        wanted = half_rounded(network(form), form)(torch.from_numpy(values)).numpy()
        original = network(form)(torch.from_numpy(values)).numpy()
    assert found == pytest.approx(wanted, abs=1e-4)  # another order of summation
    assert wanted.std() > 0.01
    assert found == pytest.approx(original, abs=0.02, rel=0.02)  # weights of half precision


def test_every_weight_comes_back_rounded_to_half(exported):
    form, checkpoint, folder, _ = exported
    loaded = load_exported(folder)
    assert (loaded.form, loaded.card) == (form, CARD)
    wanted = half_rounded(load_checkpoint(checkpoint).model, form).state_dict()
    assert loaded.model.state_dict().keys() == wanted.keys()
    for name, value in loaded.model.state_dict().items():
        assert torch.equal(value, wanted[name]), name


@pytest.mark.parametrize("form", FORMS)
def test_the_shipped_weights_can_be_trained_further(form):
    loaded = load_exported(SHIPPED / form)
    assert (loaded.form, loaded.card["stage"]) == (form, form)
    assert all(torch.isfinite(weight).all() and weight.any() for weight in loaded.model.parameters())


def test_inputs_of_the_comparison_are_like_the_engines():
    for form, brightest in (("clipping", 1), ("objects", 30)):
        (graph,) = graphs_of(network(form))
        ((_, values),) = random_planes(graph, seed=0).items()
        assert 0.8 * brightest < values.max() <= brightest
        assert values.min() >= 0
        assert not np.array_equal(values, next(iter(random_planes(graph, seed=1).values())))


def test_a_graph_that_differs_is_not_written(exported, tmp_path):
    _, checkpoint, _, _ = exported
    with pytest.raises(ModelError, match=r"differ from PyTorch by .* nothing was written"):
        export_checkpoint(checkpoint, tmp_path / "out", tolerance=-1.0)
    assert not (tmp_path / "out").exists()
