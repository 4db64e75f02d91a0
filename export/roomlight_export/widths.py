"""Measure the cost of each network width: parameters, multiply-adds and milliseconds, on this machine in one run.

This gives the table in `docs/networks.md`. Times are the minimum of many runs, because other processes only add time.
Weights are untrained, which does not change the time. Sessions are created as the server does.
"""

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from roomlight.engine.networks.openvino_runtime import openvino_version
from roomlight.engine.networks.providers import open_graph
from roomlight.threads import thread_count
from roomlight_export.exporting import ProgressCallback
from roomlight_export.graphs import Graph, graphs_of, sample_inputs
from roomlight_export.inputs import room_volume
from roomlight_export.onnx_file import half_rounded, to_onnx
from roomlight_export.parity import session_runner, torch_runner
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import VideoModel

CONFIGS: tuple[ModelConfig, ...] = (
    ModelConfig(SGConfig(channels=16, full_channels=8), BlendConfig(channels=8, full_channels=4)),
    ModelConfig(SGConfig(channels=24, full_channels=16), BlendConfig(channels=16, full_channels=8)),
    ModelConfig(SGConfig(channels=32, full_channels=8), BlendConfig(channels=16, full_channels=8)),
    ModelConfig(),
    ModelConfig(SGConfig(fine_gate_kernel=3), BlendConfig(channels=32, full_channels=16)),
    ModelConfig(SGConfig(norm="none")),
    ModelConfig(SGConfig(channels=48, full_channels=24), BlendConfig(channels=48, full_channels=16)),
    ModelConfig(SGConfig(channels=64, full_channels=32), BlendConfig(channels=64, full_channels=32)),
)
"""From a quarter of the paper's widths (as read from its figure) to the full widths."""


@dataclass(frozen=True)
class GraphCost:
    """One graph's cost; NaN for a runtime that is not installed."""

    parameters: int
    gmac: float
    torch_ms: float
    ort_ms: float
    openvino_ms: float

    def __add__(self, other: "GraphCost") -> "GraphCost":
        """Add the cost of running both, one after the other."""
        return GraphCost(
            self.parameters + other.parameters,
            self.gmac + other.gmac,
            self.torch_ms + other.torch_ms,
            self.ort_ms + other.ort_ms,
            self.openvino_ms + other.openvino_ms,
        )


@dataclass(frozen=True)
class WidthRow:
    """One configuration: the single-view 3D network, a recurrent 3D step, its GRUs, a recurrent 2D step."""

    config: ModelConfig
    single_sg: GraphCost
    video_sg: GraphCost
    sg_gru: GraphCost
    video_blend: GraphCost


def measure_widths(
    configs: Sequence[ModelConfig] = CONFIGS,
    *,
    rounds: int = 15,
    progress: ProgressCallback | None = None,
) -> list[WidthRow]:
    """Measure each configuration's graphs in PyTorch, ONNX Runtime and, if available, OpenVINO.

    All graphs are prepared first and then timed in rounds over all configurations, so that a busy minute of the
    machine affects all of them and the minimum times are comparable. `progress` receives a message for each step.
    """
    report_step: ProgressCallback = progress or _ignore
    before = torch.get_num_threads()
    torch.set_num_threads(thread_count())
    try:
        prepared: list[tuple[ModelConfig, dict[str, _Prepared]]] = []
        for config in configs:
            report_step(f"exporting {describe(config)}")
            prepared.append((config, _prepare(config)))
        for index in range(rounds):
            report_step(f"timing, round {index + 1} of {rounds}")
            for _, graphs in prepared:
                for graph in graphs.values():
                    graph.time_once()
        return [_row(config, graphs) for config, graphs in prepared]
    finally:
        torch.set_num_threads(before)


def describe(config: ModelConfig) -> str:
    """Describe the widths in short: channels at half / full resolution, and differences from the defaults."""
    sg, blend, default = config.sg, config.blend, SGConfig()
    text = f"SG {sg.channels}/{sg.full_channels}, blend {blend.channels}/{blend.full_channels}"
    if sg.full_layers != default.full_layers:
        text += f", {sg.full_layers} full layers"
    if sg.norm != default.norm:
        text += f", norm {sg.norm}"
    if sg.fine_gate_kernel != default.fine_gate_kernel:
        text += f", gates {sg.fine_gate_kernel}^3"
    return text if sg.spherical_gaussians else f"{text}, RGB-alpha"


def format_widths(rows: Sequence[WidthRow]) -> str:
    """Format the rows as a Markdown table; times are PyTorch fp32 / ONNX Runtime CPU fp32 / OpenVINO, in ms."""

    def cell(cost: GraphCost) -> str:
        times = (cost.torch_ms, cost.ort_ms, cost.openvino_ms)
        return f"{cost.gmac:.2f} | " + " / ".join("-" if math.isnan(ms) else f"{ms:.3g}" for ms in times)

    lines = [
        "| widths | M parameters (3D + video 2D) | GMAC | single-view SG ms | GMAC | video SG ms "
        "| GMAC | of it GRUs ms | GMAC | video blend ms |",
        "| --- |" + " ---: |" * 9,
    ]
    for row in rows:
        parameters = (row.single_sg + row.video_sg + row.video_blend).parameters / 1e6
        cells = [cell(cost) for cost in (row.single_sg, row.video_sg, row.sg_gru, row.video_blend)]
        lines.append(f"| {describe(row.config)} | {parameters:.2f} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


class _Prepared:
    """One graph with the runtimes that can run it, and the minimum time of each."""

    def __init__(self, graph: Graph) -> None:
        inputs = sample_inputs(graph)
        feed = {name: value.numpy() for name, value in zip(graph.inputs, inputs, strict=True)}
        random = np.random.default_rng(0)
        for name, value in feed.items():  # some runtimes are faster on zeros
            if name == "volume":
                value[:] = room_volume((value.shape[2], value.shape[3], value.shape[4]), frame=0)
            else:
                value[:] = random.random(value.shape, dtype=np.float32)
        with torch.inference_mode(), FlopCounterMode(display=False) as counter:
            graph.module(*inputs)
        self.gmac = counter.get_total_flops() / 2e9
        self.parameters = sum(weight.numel() for weight in graph.module.parameters())
        run_torch = torch_runner({graph.name: graph})
        self._runs: dict[str, Callable[[], object]] = {"torch": lambda: run_torch(graph.name, feed)}
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{graph.name}.onnx"
            path.write_bytes(to_onnx(graph, metadata={}).SerializeToString())
            run_ort = session_runner({graph.name: open_graph(path, "cpu")})
            self._runs["ort"] = lambda: run_ort(graph.name, feed)
            if openvino_version() is not None:
                run_openvino = session_runner({graph.name: open_graph(path, "openvino")})
                self._runs["openvino"] = lambda: run_openvino(graph.name, feed)
        for run in self._runs.values():  # the first run allocates
            run()
        self._minimum_ms = dict.fromkeys(self._runs, math.inf)

    def time_once(self) -> None:
        """Run once in each runtime and update the minimum times."""
        for name, run in self._runs.items():
            start = time.perf_counter()
            run()
            self._minimum_ms[name] = min(self._minimum_ms[name], (time.perf_counter() - start) * 1e3)

    def cost(self) -> GraphCost:
        """Return the measured cost."""
        return GraphCost(
            parameters=self.parameters,
            gmac=self.gmac,
            torch_ms=self._minimum_ms["torch"],
            ort_ms=self._minimum_ms["ort"],
            openvino_ms=self._minimum_ms.get("openvino", math.nan),
        )


def _prepare(config: ModelConfig) -> dict[str, _Prepared]:
    model = half_rounded(VideoModel(config), "untrained")
    assert isinstance(model, VideoModel)
    return {graph.name: _Prepared(graph) for graph in graphs_of(model) if not graph.name.startswith("single_blend")}


def _row(config: ModelConfig, graphs: dict[str, _Prepared]) -> WidthRow:
    cost = {name: graph.cost() for name, graph in graphs.items()}
    gru = cost["video_sg_gru"]
    return WidthRow(
        config=config,
        single_sg=cost["single_sg_encoder"] + cost["single_sg_decoder"],
        video_sg=cost["video_sg_encoder"] + gru + cost["video_sg_decoder"],
        sg_gru=gru,
        video_blend=cost["video_blend_encoder"] + cost["video_blend_gru"] + cost["video_blend_decoder"],
    )


def _ignore(_: str) -> None:
    pass
