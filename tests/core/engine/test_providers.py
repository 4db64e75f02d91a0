"""Where graphs run: a choice that is measured once and kept; opening graphs does not change the caller's thread."""

import json

import numpy as np
import pytest

from roomlight.engine.networks import providers
from roomlight.engine.networks.graphs import load_graphs
from roomlight.engine.networks.providers import VARIABLE, open_graph, open_graphs
from roomlight.engine.networks.runtime import CUDA, ort
from roomlight.errors import ModelError


@pytest.fixture
def both_runtimes(monkeypatch, tmp_path):
    """Pretend that OpenVINO is installed, with graphs of ONNX Runtime in its place; returns the cache folder."""
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(providers, "openvino_version", lambda: "1")
    monkeypatch.setattr(providers, "computes_in_bf16", lambda: True)
    opened = []

    def open_as(path, runtime):
        graph = open_graph(path, "cpu")
        graph._loaded.runtime = runtime
        opened.append(runtime)
        return graph

    monkeypatch.setattr(providers, "open_graph", open_as)
    return tmp_path / "cache", opened


def _runtime(path, **options):
    """Where a model's graphs run."""
    return load_graphs(path, **options).graphs["single_sg_encoder"].runtime


def _chosen(tiny_video):
    """The runtime that is chosen for one of the graphs."""
    (graph,) = open_graphs([tiny_video / "single_sg_encoder.onnx"], "any", "auto")
    return graph.runtime


def _measured(monkeypatch, cpu_ms, openvino_ms, bf16_ms=100.0):
    least_ms = dict(zip(providers.CHOICES, (cpu_ms, openvino_ms, bf16_ms), strict=True))
    monkeypatch.setattr(providers, "_least_ms", lambda loaded: {name: least_ms[name] for name in loaded})


@pytest.mark.parametrize("runtime", ["cpu", "openvino"])
def test_opening_a_graph_does_not_switch_the_callers_denormals(tiny_video, runtime):
    tiny = np.array([1e-310, 3e-40])
    graph = open_graph(tiny_video / "single_sg_encoder.onnx", runtime)
    graph.bind(graph.new_inputs(), graph.new_outputs()).run()
    assert (tiny * 0.5 > 0).all()
    assert np.float32(3e-40) * np.float32(0.5) > 0


@pytest.mark.parametrize(("runtime", "name"), [("cpu", "ONNX Runtime"), ("openvino", "OpenVINO")])
def test_a_file_that_is_no_graph_is_refused_by_name(tmp_path, runtime, name):
    path = tmp_path / "broken.onnx"
    path.write_bytes(b"not a graph")
    with pytest.raises(ModelError, match=rf"broken\.onnx: {name} cannot load it"):
        open_graph(path, runtime)


def test_without_openvino_onnx_runtime_runs_all(tiny_video, monkeypatch):
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(providers, "openvino_version", lambda: None)
    assert _runtime(tiny_video) == "cpu"
    with pytest.raises(ModelError, match=r'not installed.*provider="cpu"'):
        load_graphs(tiny_video, provider="openvino")


without_cuda = pytest.mark.skipif(CUDA in ort.get_available_providers(), reason="this ONNX Runtime has CUDA")


@without_cuda
def test_without_cuda_it_is_refused_with_what_to_install(tiny_video):
    with pytest.raises(ModelError, match=r"has no CUDA .*onnxruntime-gpu"):
        load_graphs(tiny_video, provider="cuda")


@without_cuda
@pytest.mark.filterwarnings("ignore:Specified provider")
def test_an_onnx_runtime_that_falls_back_to_the_cpu_is_refused(tiny_video):
    """It opens a graph with no more than a warning where the machine has no GPU."""
    with pytest.raises(ModelError, match="found no GPU"):
        open_graph(tiny_video / "single_sg_encoder.onnx", "cuda")


def test_the_variable_stands_for_auto_and_is_checked(tiny_video, monkeypatch):
    monkeypatch.setenv(VARIABLE, "cpu")
    assert _runtime(tiny_video) == "cpu"
    monkeypatch.setenv(VARIABLE, "gpu")
    assert _runtime(tiny_video, provider="cpu") == "cpu"
    with pytest.raises(
        ModelError, match="ROOMLIGHT_PROVIDER must be one of auto, cpu, openvino, openvino-bf16, cuda; got 'gpu'"
    ):
        load_graphs(tiny_video)
    monkeypatch.setenv(VARIABLE, "")  # blank is unset
    assert _runtime(tiny_video) != "cuda"


@pytest.mark.usefixtures("both_runtimes")
@pytest.mark.parametrize(
    ("openvino_ms", "bf16_ms", "chosen"),
    [(8.9, 8.1, "openvino"), (9.1, 9.1, "cpu"), (8.0, 7.1, "openvino-bf16"), (12.0, 8.9, "openvino-bf16")],
)
def test_auto_takes_openvino_and_bf16_where_each_is_a_tenth_faster(
    tiny_video, monkeypatch, openvino_ms, bf16_ms, chosen
):
    _measured(monkeypatch, 10.0, openvino_ms, bf16_ms)
    assert _chosen(tiny_video) == chosen


def test_a_processor_without_bf16_is_not_measured_in_it(tiny_video, both_runtimes, monkeypatch):
    monkeypatch.setattr(providers, "computes_in_bf16", lambda: False)
    _chosen(tiny_video)
    assert set(both_runtimes[1]) == {"cpu", "openvino"}
    with pytest.raises(ModelError, match=r'does not compute in bf16; use provider="openvino"'):
        load_graphs(tiny_video, provider="openvino-bf16")


def test_auto_measures_once_and_keeps_its_choice(tiny_video, both_runtimes, monkeypatch):
    folder, opened = both_runtimes
    assert _runtime(tiny_video) in providers.CHOICES  # a real measurement
    (kept,) = folder.glob("runtime-*.json")
    stated = json.loads(kept.read_text())
    assert set(stated["least_ms"]) == set(providers.CHOICES)
    assert min(stated["least_ms"].values()) > 0
    for first, later in ((1.0, 9.0), (9.0, 1.0)):
        kept.write_text(json.dumps({"runtime": "openvino"}))
        _measured(monkeypatch, first, later)
        opened.clear()
        assert _runtime(tiny_video) == "openvino"
        assert set(opened) == {"openvino"}  # the other is not even loaded


def test_of_two_processes_the_first_choice_counts(tiny_video, both_runtimes, monkeypatch):
    folder, _ = both_runtimes

    def measured(_):
        _measured(monkeypatch, 10.0, 1.0)
        assert _chosen(tiny_video) == "openvino"  # another process, meanwhile
        return {"cpu": 1.0, "openvino": 10.0, "openvino-bf16": 10.0}

    monkeypatch.setattr(providers, "_least_ms", measured)
    assert _chosen(tiny_video) == "openvino"
    assert len(list(folder.iterdir())) == 1


def test_a_damaged_choice_is_measured_again(tiny_video, both_runtimes, monkeypatch):
    folder, _ = both_runtimes
    _measured(monkeypatch, 10.0, 1.0)
    _chosen(tiny_video)
    (kept,) = folder.glob("runtime-*.json")
    for damaged in ("", "[]", "{}", '{"runtime": "gpu"}'):
        kept.write_text(damaged)
        assert _chosen(tiny_video) == "openvino"
        assert json.loads(kept.read_text())["runtime"] == "openvino"


def test_a_folder_that_cannot_be_written_is_no_error(tiny_video, both_runtimes, monkeypatch):
    both_runtimes[0].write_text("a file in its place")
    _measured(monkeypatch, 10.0, 1.0)
    assert _chosen(tiny_video) == "openvino"
