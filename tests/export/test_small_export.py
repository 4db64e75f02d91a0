"""Export of the small networks, which serve every model: parity with PyTorch, the folder, the way back."""

import hashlib
import json

import numpy as np
import onnxruntime
import pytest
import torch
from export_models import CARD, distinct_network

from roomlight.engine.networks.graphs import SHIPPED, load_part
from roomlight_export.graphs import graphs_of
from roomlight_export.importing import load_exported
from roomlight_export.inputs import random_planes
from roomlight_export.onnx_file import half_rounded


def test_an_exported_network_is_described_and_loads(small):
    form, report = small.form, small.report
    assert (report.form, report.graphs, set(report.parity)) == (form, (form,), {form})
    assert report.parameters == sum(weight.numel() for weight in distinct_network(form).parameters())
    described = json.loads((small.folder / "model.json").read_text())
    stored = (small.folder / f"{form}.onnx").read_bytes()
    assert described["graphs"][form]["sha256"] == hashlib.sha256(stored).hexdigest()
    assert (described["card"], described["config"]) == (CARD, {})
    assert max(described["parity"][form]["error"].values()) <= described["parity"]["tolerance"]
    assert report.onnx_bytes == len(stored) < 5e6
    graph = load_part(small.folder, form, provider="cpu")
    (expected,) = graphs_of(distinct_network(form))
    assert (graph.inputs, graph.outputs) == (expected.inputs, expected.outputs)


def test_the_graph_equals_pytorch(small):
    session = onnxruntime.InferenceSession(small.folder / f"{small.form}.onnx", providers=["CPUExecutionProvider"])
    network = distinct_network(small.form)
    (graph,) = graphs_of(network)
    ((name, shape),) = graph.inputs.items()
    values = np.random.default_rng(8).random(shape).astype(np.float32)
    (found,) = session.run(None, {name: values})
    with torch.no_grad():
        original = network(torch.from_numpy(values)).numpy()
        wanted = half_rounded(network, small.form)(torch.from_numpy(values)).numpy()
    assert found == pytest.approx(wanted, abs=1e-4)  # another order of summation
    assert wanted.std() > 0.01
    assert found == pytest.approx(original, abs=0.02, rel=0.02)  # weights of half precision


@pytest.mark.parametrize("form", ["clipping", pytest.param("objects", marks=pytest.mark.slow)])
def test_the_shipped_weights_can_be_trained_further(form):
    loaded = load_exported(SHIPPED / form)
    assert (loaded.form, loaded.card["stage"]) == (form, form)
    assert all(torch.isfinite(weight).all() and weight.any() for weight in loaded.model.parameters())


def test_inputs_of_the_comparison_are_like_the_engines():
    for form, brightest in (("clipping", 1), ("objects", 30)):
        (graph,) = graphs_of(distinct_network(form))
        ((_, values),) = random_planes(graph, seed=0).items()
        assert 0.8 * brightest < values.max() <= brightest
        assert values.min() >= 0
        assert not np.array_equal(values, next(iter(random_planes(graph, seed=1).values())))
