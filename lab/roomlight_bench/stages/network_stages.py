"""The networks' stages: ONNX graphs with bound buffers, as the server runs them, beside PyTorch in eager mode.

PyTorch is optional for `roomlight bench stages`: functions that use it import it when they are called.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from roomlight.engine.networks.graphs import LightingGraphs, NetworkForm, load_graphs
from roomlight.engine.networks.providers import available
from roomlight.engine.networks.runtime import RuntimeName
from roomlight_bench.stages import plain_torch
from roomlight_bench.stages.bench_stage import BenchStage
from roomlight_bench.timing import Implementation
from roomlight_model.config import ModelConfig

if TYPE_CHECKING:
    from roomlight_export.graphs import Graph

_RUNTIME_TITLES: dict[RuntimeName, str] = {
    "cpu": "ONNX Runtime fp32",
    "openvino": "OpenVINO fp32",
    "openvino-bf16": "OpenVINO bf16",
}


@dataclass(frozen=True)
class Networks:
    """A model's graphs, loaded in each runtime that this machine has."""

    config: ModelConfig
    loaded: dict[RuntimeName, LightingGraphs]

    @property
    def form(self) -> NetworkForm:
        """Whether the model is the single-view or the video form."""
        return next(iter(self.loaded.values())).form


def load_networks(model: Path) -> Networks:
    """Load a model folder in every runtime that this machine has.

    Raises:
        ModelError: The folder is not a model folder, or does not fit this version.
    """
    loaded: dict[RuntimeName, LightingGraphs] = {name: load_graphs(model, provider=name) for name in available()}
    described = json.loads((model / "model.json").read_text())
    return Networks(ModelConfig.from_dict(described.get("config", {})), loaded)


def network_stages(networks: Networks, volume: Float[np.ndarray, "5 z y x"]) -> list[BenchStage]:
    """Return the stages of the networks, one per runtime; PyTorch in eager mode is timed beside the first.

    Stages: 3D network, 3D GRU, blending network and 2D GRU. `volume` is the networks' input.
    """
    form = networks.form
    blend = f"{form}_blend"
    plan: list[tuple[str, tuple[str, ...], float, str]] = [
        ("SGLV network", (f"{form}_sg_encoder", f"{form}_sg_decoder"), 25.0, "3D encoder and decoder"),
        ("3D GRU", ("video_sg_gru",), 19.0, "both levels"),
        ("blending network", (f"{blend}_encoder", f"{blend}_decoder"), 5.2, "2D encoder and decoder"),
        ("2D GRU", ("video_blend_gru",), 2.1, "both levels"),
    ]
    modules = _graphs_in_pytorch(networks) if plain_torch.torch_installed() else None
    stages: list[BenchStage] = []
    for name, graphs, paper_ms, note in plan:
        if not all(graph in networks.loaded["cpu"].graphs for graph in graphs):
            continue  # a single-view model has no GRUs
        eager = _run_eager([modules[graph] for graph in graphs], volume) if modules is not None else None
        flops = _counted_flops(eager) if eager is not None else None  # the first run, which also warms it up
        for runtime, loaded in networks.loaded.items():
            first = runtime == "cpu"
            ours = Implementation(_run_bound(loaded, graphs, volume))
            ours.run()
            stages.append(
                BenchStage(
                    f"{name}, {_RUNTIME_TITLES[runtime]}",
                    ours,
                    torch=Implementation(eager) if eager is not None and first else None,
                    paper_ms=paper_ms if first else None,
                    flops=flops,
                    note=note,
                )
            )
    return stages


def _graph_input(name: str, shape: tuple[int, ...], volume: Float[np.ndarray, "5 z y x"]) -> Float[np.ndarray, "..."]:
    """Return the volume for the input of that name, and random values for the others."""
    if name == "volume":
        return np.ascontiguousarray(volume[None])
    return np.random.default_rng(0).random(shape, dtype=np.float32)


def _run_bound(
    loaded: LightingGraphs, names: tuple[str, ...], volume: Float[np.ndarray, "5 z y x"]
) -> Callable[[], object]:
    """Return a function that runs the graphs one after the other, with buffers that are bound beforehand."""
    bound = []
    for name in names:
        graph = loaded.graphs[name]
        feed = {key: _graph_input(key, shape, volume) for key, shape in graph.inputs.items()}
        bound.append(graph.bind(feed, graph.new_outputs()))

    def run() -> None:
        for graph in bound:
            graph.run()

    return run


def _graphs_in_pytorch(networks: Networks) -> dict[str, "Graph"]:
    """Return the same graphs (`roomlight_export.graphs.Graph`), whose modules run in PyTorch, by name."""
    from roomlight_export.graphs import graphs_of
    from roomlight_model.checkpoint import build_network

    model = build_network(networks.form, networks.config).eval()
    return {graph.name: graph for graph in graphs_of(model)}


def _run_eager(graphs: "list[Graph]", volume: Float[np.ndarray, "5 z y x"]) -> Callable[[], object]:
    """Return a function that runs the modules one after the other in eager mode."""
    import torch

    given = [
        [torch.from_numpy(_graph_input(key, shape, volume)) for key, shape in graph.inputs.items()] for graph in graphs
    ]

    @torch.inference_mode()
    def run() -> None:
        for graph, tensors in zip(graphs, given, strict=True):
            graph.module(*tensors)

    return run


def _counted_flops(run: Callable[[], object]) -> float:
    """Return the floating-point operations of a run, a multiply-add counted as two."""
    from torch.utils.flop_counter import FlopCounterMode

    with FlopCounterMode(display=False) as counter:
        run()
    return float(counter.get_total_flops())
