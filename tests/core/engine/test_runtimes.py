"""Graphs in OpenVINO, in bf16 or on a GPU where there is one: ONNX Runtime's numbers, in the caller's buffers."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from roomlight.engine.networks.graphs import SHIPPED, SINGLE_GRAPHS
from roomlight.engine.networks.openvino_runtime import BF16_TOLERANCE, TOLERANCE, computes_in_bf16
from roomlight.engine.networks.providers import open_graph
from roomlight.engine.networks.runtime import CUDA, ort
from roomlight.engine.session import Session, SessionOptions
from rooms import BoxRoom, camera_at
from sessions import session_of

_PRESENT = {
    "cpu": True,
    "openvino": True,
    "cuda": CUDA in ort.get_available_providers(),
    "openvino-bf16": computes_in_bf16(),
}


def _on(names):
    return pytest.mark.parametrize(
        "runtime",
        [pytest.param(name, marks=pytest.mark.skipif(not _PRESENT[name], reason=f"no {name}")) for name in names],
    )


on_each_runtime = _on(_PRESENT)
on_each_other_runtime = _on([name for name in _PRESENT if name != "cpu"])
on_each_fp32_runtime = _on(["openvino", "cuda"])
SHIPPED_GRAPHS = [("single", name) for name in SINGLE_GRAPHS] + [("clipping", "clipping"), ("objects", "objects")]


def _bound(graph, seed):
    random = np.random.default_rng(seed)
    inputs = {name: random.random(shape, dtype=np.float32) for name, shape in graph.inputs.items()}
    outputs = graph.new_outputs()
    return graph.bind(inputs, outputs), inputs, outputs


@on_each_fp32_runtime
@pytest.mark.parametrize(("folder", "name"), SHIPPED_GRAPHS)
def test_shipped_graphs_agree_with_onnx_runtime(folder, name, runtime):
    results = []
    for opened in ("cpu", runtime):
        bound, _, outputs = _bound(open_graph(SHIPPED / folder / f"{name}.onnx", opened), 0)
        bound.run()
        results.append(outputs)
    for key, wanted in results[0].items():
        assert np.abs(results[1][key] - wanted).max() <= TOLERANCE * np.abs(wanted).max()


@on_each_runtime
def test_a_bound_graph_reads_and_writes_in_place(tiny_video, runtime):
    graph = open_graph(tiny_video / "single_sg_encoder.onnx", runtime)
    bound, inputs, outputs = _bound(graph, 0)
    bound.run()
    first = {name: array.copy() for name, array in outputs.items()}
    inputs["volume"][:] = 0
    bound.run()
    assert all((outputs[name] != first[name]).any() for name in outputs)


@on_each_other_runtime
def test_threads_run_one_graph_at_the_same_time_with_equal_bits(tiny_video, runtime):
    graph = open_graph(tiny_video / "single_sg_encoder.onnx", runtime)
    alone = []
    for seed in range(4):
        bound, _, outputs = _bound(graph, seed)
        bound.run()
        alone.append(outputs)
    together = [_bound(graph, seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda entry: [entry[0].run() for _ in range(10)], together))
    for (_, _, outputs), wanted in zip(together, alone, strict=True):
        assert all((outputs[name] == wanted[name]).all() for name in wanted)


@on_each_other_runtime
def test_a_session_saved_in_one_runtime_goes_on_in_the_other(tiny_video, tmp_path, runtime):
    room = BoxRoom(lamp=((0.3, 1.6, -2.5), 0.35), lamp_radiance=30.0)
    frames = [room.frame(camera_at((0, 1.4, 0), 9 * index), index=index, width=96, height=72) for index in range(5)]
    options: dict[str, Any] = {"model": "single", "weights": tiny_video, "height": 32}
    whole = session_of(frames[:3], probes=[(0.1, 1.2, -0.5)], provider="cpu", **options)
    whole.save(tmp_path / "room.state")
    other = Session.load(tmp_path / "room.state", SessionOptions(provider=runtime, **options))
    for frame in frames[3:]:
        whole.push(frame)
        other.push(frame)
    wanted, got = whole.lights()[0].panorama, other.lights()[0].panorama
    assert (got != wanted).any()  # it is another runtime
    if runtime == "openvino-bf16":
        assert np.sqrt(np.mean((np.log1p(got) - np.log1p(wanted)) ** 2)) <= BF16_TOLERANCE
    else:
        assert np.abs(got - wanted).max() <= 10 * TOLERANCE * wanted.max()  # two frames of five graphs each


@pytest.mark.slow
@_on(["openvino-bf16"])
@pytest.mark.parametrize("form", ["single", "video"])
def test_the_light_of_shipped_networks_in_bf16_is_that_of_fp32(form, runtime):
    room = BoxRoom(lamp=((0.3, 1.6, -2.5), 0.35), lamp_radiance=30.0)
    frames = [room.frame(camera_at((0, 1.4, 0), 20 * index), index=index, width=96, height=72) for index in range(3)]
    logarithms = []
    for provider in ("cpu", runtime):
        (light,) = session_of(frames, probes=[(0.1, 1.2, -0.5)], model=form, provider=provider).lights()
        logarithms.append(np.log1p([light.reflection, light.panorama]))
    assert np.sqrt(np.mean((logarithms[1] - logarithms[0]) ** 2, axis=(1, 2, 3))).max() <= BF16_TOLERANCE
    assert (logarithms[1] != logarithms[0]).any()  # it is another runtime


def test_openvinos_converter_which_reports_its_import_is_not_loaded(tiny_video):
    program = f"""
import sys
from pathlib import Path
from roomlight.engine.networks.providers import open_graph
from roomlight.engine.networks.runtime import CUDA, ort
open_graph(Path({str(tiny_video)!r}) / "single_sg_encoder.onnx", "openvino")
assert "openvino" in sys.modules
assert not [name for name in sys.modules if "telemetry" in name or name.startswith("openvino.tools")]
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_fork_of_a_process_that_uses_openvino_has_onnx_runtime():
    code = """
import multiprocessing, sys
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.engine.networks.openvino_runtime import OpenVinoGraph
from roomlight.engine.networks.providers import open_graphs

path = SHIPPED / "objects" / "objects.onnx"

def work():
    (graph,) = open_graphs([path], "any", "auto")
    outputs = graph.new_outputs()
    graph.bind(graph.new_inputs(), outputs).run()
    try:
        open_graphs([path], "any", "openvino")
    except Exception as error:
        print(error)

OpenVinoGraph.open(path, "openvino")
child = multiprocessing.get_context("fork").Process(target=work)
child.start()
child.join()
sys.exit(child.exitcode)
"""
    environment = os.environ | {"ROOMLIGHT_PROVIDER": "auto"}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert 'start processes by "spawn", or use provider="cpu"' in ran.stdout
