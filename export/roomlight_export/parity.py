"""Compare the graphs with PyTorch: both run the paper's recursion over the same frames.

A drifting state shows only after several steps, so that one step is not enough. The same recursion code runs ONNX
Runtime and PyTorch, through a function that runs a graph by name.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch

from roomlight.engine.networks.graph import Graph as LoadedGraph
from roomlight.engine.networks.units import mean_colour
from roomlight_export.graphs import Graph
from roomlight_export.inputs import ProbeFrame, random_planes

_TRIALS: Final = 4
"""Random inputs of a small network."""
Tensors = dict[str, np.ndarray]
Run = Callable[[str, Tensors], Tensors]
"""Runs the graph of a name."""

TOLERANCE = 1e-3
"""Largest difference allowed between a graph and PyTorch with the same half-rounded weights, over all steps.

c, w and lambda are compared as log(1 + x), where the training loss compares them: 1e-3 is a tenth of a
percent of the light, half an 8-bit display step. Order of summation alone gives 1e-6 to 1e-4 (the HDR heads'
exponent multiplies it); a wrong graph (a layer's padding, a lost bias) gives 1e-2 and more.
"""


@dataclass(frozen=True)
class Parity:
    """The largest differences of one network over all steps, by output."""

    steps: int
    error: dict[str, float]
    """ONNX Runtime against PyTorch with the same weights; must be within the tolerance."""

    @property
    def largest(self) -> float:
        """Largest entry of `error`."""
        return max(self.error.values())


def torch_runner(graphs: Mapping[str, Graph]) -> Run:
    """Return a function that runs graphs as PyTorch modules."""

    def run(name: str, inputs: Tensors) -> Tensors:
        graph = graphs[name]
        with torch.inference_mode():
            outputs = graph.module(*(torch.from_numpy(inputs[key]) for key in graph.inputs))
        if isinstance(outputs, torch.Tensor):
            outputs = (outputs,)
        return {key: value.numpy() for key, value in zip(graph.outputs, outputs, strict=True)}

    return run


def session_runner(graphs: Mapping[str, LoadedGraph]) -> Run:
    """Return a function that runs graphs in the runtimes that they are loaded in."""

    def run(name: str, inputs: Tensors) -> Tensors:
        graph = graphs[name]
        outputs = graph.new_outputs()
        graph.bind({key: np.ascontiguousarray(inputs[key]) for key in graph.inputs}, outputs).run()
        return outputs

    return run


def compare_volumes(tested: Run, wanted: Run, *, volumes: list[np.ndarray], recurrent: bool) -> Parity:
    """Compare the 3D networks over a sequence of initial volumes; frame 0 is single-view."""
    return _compare(*(_run_volumes(run, volumes, recurrent=recurrent) for run in (tested, wanted)))


def compare_blending(tested: Run, wanted: Run, *, frames: list[ProbeFrame], recurrent: bool) -> Parity:
    """Compare the 2D networks over a probe's frames.

    Inputs are given, not accumulated from the outputs: the conservative rule is a step function, and a pixel at its
    threshold would count as an error of 1.
    """
    return _compare(*(_run_blending(run, frames, recurrent=recurrent) for run in (tested, wanted)))


def compare_small(tested: Run, wanted: Run, *, graph: Graph) -> Parity:
    """Compare the graph of a small network on several random inputs like the engine's."""
    inputs = [random_planes(graph, seed=seed) for seed in range(_TRIALS)]
    return _compare(*([run(graph.name, planes) for planes in inputs] for run in (tested, wanted)))


def _run_volumes(run: Run, volumes: list[np.ndarray], *, recurrent: bool) -> list[Tensors]:
    results: list[Tensors] = []
    state: Tensors = {}
    unit = mean_colour(volumes[0][0]).reshape(1, 3, 1, 1, 1)
    for index, volume in enumerate(volumes):
        if index == 0 or not recurrent:
            features = run("single_sg_encoder", {"volume": volume})
            light = run("single_sg_decoder", {**features, "volume": volume})
            hidden = {"h0": features["f0"], "h1": features["f1"]}
        else:
            features = run("video_sg_encoder", {"volume": volume, "unit": unit})
            updated = run("video_sg_gru", {"h0": state["h0"], "h1": state["h1"], **features})
            hidden = {"h0": updated["h0_next"], "h1": updated["h1_next"]}
            previous = {"alpha_previous": state["alpha"], "lobes_previous": state["lobes"]}
            light = run("video_sg_decoder", {**hidden, "volume": volume, **previous, "unit": unit})
        state = {**hidden, **light}
        results.append(state)
    return results


def _run_blending(run: Run, frames: list[ProbeFrame], *, recurrent: bool) -> list[Tensors]:
    results: list[Tensors] = []
    state: Tensors = {}
    for index, frame in enumerate(frames):
        if index == 0 or not recurrent:
            features = run("single_blend_encoder", {"panels": frame.single_panels})
            decoded = run("single_blend_decoder", {**features, "mask": frame.mask})
            hidden = {"h0": features["f0"], "h1": features["f1"]}
        else:
            features = run("video_blend_encoder", {"panels": frame.video_panels})
            updated = run("video_blend_gru", {"h0": state["h0"], "h1": state["h1"], **features})
            hidden = {"h0": updated["h0_next"], "h1": updated["h1_next"]}
            decoded = run("video_blend_decoder", {**hidden, "mask": frame.mask})
        state = {**hidden, **decoded}
        results.append(state)
    return results


def difference(name: str, first: np.ndarray, second: np.ndarray) -> float:
    """Return the largest difference of one output: NaN is infinite; c, w, lambda of `lobes` as log(1 + x)."""
    if name == "lobes":
        first, second = _compress(first), _compress(second)
    worst = float(np.abs(first - second).max())
    return worst if np.isfinite(worst) else float("inf")


def _compress(lobes: np.ndarray) -> np.ndarray:
    return np.concatenate([np.log1p(lobes[..., :7]), lobes[..., 7:]], axis=-1)


def _compare(tested: list[Tensors], wanted: list[Tensors]) -> Parity:
    error: dict[str, float] = {}
    for ours, theirs in zip(tested, wanted, strict=True):
        for name, value in ours.items():
            error[name] = max(error.get(name, 0.0), difference(name, value, theirs[name]))
    return Parity(len(tested), error)
