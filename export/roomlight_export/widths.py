"""What each width costs: parameters, multiply-adds and milliseconds, measured on this machine in one run.

The table in `model/NETWORKS.md` comes from here. Times are the least of several runs on two threads, because
other work on the machine only ever adds; weights are untrained, which changes nothing about time.
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

from roomlight.threads import thread_count
from roomlight_export.graphs import Graph, graphs_of, sample_inputs
from roomlight_export.inputs import room_volume
from roomlight_export.onnx_file import half_rounded, to_onnx
from roomlight_export.parity import session_runner
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import VideoModel
from roomlight_server.providers import open_graph, openvino_device

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
"""From a quarter of the paper's widths (its figure, as we read it) to all of them."""


@dataclass(frozen=True)
class GraphCost:
    """One graph's cost; NaN where a runtime is not there."""

    parameters: int
    gmac: float
    torch_ms: float
    ort_ms: float
    openvino_ms: float

    def __add__(self, other: "GraphCost") -> "GraphCost":
        """Cost of running both, one after the other."""
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
    repeats: int = 7,
    progress: Callable[[str], None] | None = None,
) -> list[WidthRow]:
    """Measure each configuration's graphs in PyTorch, ONNX Runtime and, where it serves, OpenVINO at bf16."""
    before = torch.get_num_threads()
    torch.set_num_threads(thread_count())
    try:
        rows: list[WidthRow] = []
        for config in configs:
            if progress is not None:
                progress(f"measuring {describe(config)}")
            rows.append(_measure(config, repeats))
        return rows
    finally:
        torch.set_num_threads(before)


def describe(config: ModelConfig) -> str:
    """Widths in short: half / full resolution channels, and what differs from the defaults."""
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
    """The rows as a Markdown table; times are PyTorch fp32 / ONNX Runtime CPU fp32 / OpenVINO bf16, in ms."""

    def cell(cost: GraphCost) -> str:
        times = (cost.torch_ms, cost.ort_ms, cost.openvino_ms)
        return f"{cost.gmac:.2f} | " + " / ".join("-" if math.isnan(ms) else f"{ms:.3g}" for ms in times)

    lines = [
        "| widths | M parameters (single + video) | GMAC | single-view SG ms | GMAC | video SG ms "
        "| GMAC | of it GRUs ms | GMAC | video blend ms |",
        "| --- |" + " ---: |" * 9,
    ]
    for row in rows:
        parameters = (row.single_sg + row.video_sg + row.video_blend).parameters / 1e6
        cells = [cell(cost) for cost in (row.single_sg, row.video_sg, row.sg_gru, row.video_blend)]
        lines.append(f"| {describe(row.config)} | {parameters:.2f} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _measure(config: ModelConfig, repeats: int) -> WidthRow:
    model = half_rounded(VideoModel(config), "untrained")
    assert isinstance(model, VideoModel)
    costs = {
        graph.name: _cost(graph, repeats)
        for graph in graphs_of(model)
        if not graph.name.startswith("single_blend")
    }
    gru = costs["video_sg_gru"]
    return WidthRow(
        config=config,
        single_sg=costs["single_sg_encoder"] + costs["single_sg_decoder"],
        video_sg=costs["video_sg_encoder"] + gru + costs["video_sg_decoder"],
        sg_gru=gru,
        video_blend=costs["video_blend_encoder"] + costs["video_blend_gru"] + costs["video_blend_decoder"],
    )


def _cost(graph: Graph, repeats: int) -> GraphCost:
    inputs = sample_inputs(graph)
    feed = {name: value.numpy() for name, value in zip(graph.inputs, inputs, strict=True)}
    random = np.random.default_rng(0)
    for name, value in feed.items():  # zeros would let denormals and branches flatter a runtime
        if name == "volume":
            value[:] = room_volume((value.shape[2], value.shape[3], value.shape[4]), frame=0)
        else:
            value[:] = random.random(value.shape, dtype=np.float32)
    with torch.inference_mode():
        with FlopCounterMode(display=False) as counter:
            graph.module(*inputs)
        torch_ms = _least_ms(lambda: graph.module(*inputs), repeats)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{graph.name}.onnx"
        path.write_bytes(to_onnx(graph, metadata={}).SerializeToString())
        run = session_runner({graph.name: open_graph(path, "cpu")})
        ort_ms = _least_ms(lambda: run(graph.name, feed), repeats)
        openvino_ms = math.nan
        if openvino_device() is not None:
            run_openvino = session_runner({graph.name: open_graph(path, "openvino")})
            openvino_ms = _least_ms(lambda: run_openvino(graph.name, feed), repeats)
    return GraphCost(
        parameters=sum(weight.numel() for weight in graph.module.parameters()),
        gmac=counter.get_total_flops() / 2e9,
        torch_ms=torch_ms,
        ort_ms=ort_ms,
        openvino_ms=openvino_ms,
    )


def _least_ms(work: Callable[[], object], repeats: int) -> float:
    work()
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times) * 1e3
