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
    unit = {"unit": mean_colour(volumes[0][0]).reshape(1, 3, 1, 1, 1)}
    results: list[Tensors] = []
    for volume in volumes:
        given = {"volume": volume}
        if not results or not recurrent:
            results.append(_first(run, "sg", given, given))
        else:
            before = {f"{name}_previous": results[-1][name] for name in ("alpha", "lobes")}
            results.append(_next(run, "sg", results[-1], given | unit, given | before | unit))
    return results


def _run_blending(run: Run, frames: list[ProbeFrame], *, recurrent: bool) -> list[Tensors]:
    results: list[Tensors] = []
    for frame in frames:
        mask = {"mask": frame.mask}
        if not results or not recurrent:
            results.append(_first(run, "blend", {"panels": frame.single_panels}, mask))
        else:
            results.append(_next(run, "blend", results[-1], {"panels": frame.video_panels}, mask))
    return results


def _first(run: Run, kind: str, encoded: Tensors, decoded: Tensors) -> Tensors:
    """Run the single-view graphs on an encoder's and a decoder's own inputs; their features are the hidden states."""
    features = run(f"single_{kind}_encoder", encoded)
    return {"h0": features["f0"], "h1": features["f1"], **run(f"single_{kind}_decoder", features | decoded)}


def _next(run: Run, kind: str, state: Tensors, encoded: Tensors, decoded: Tensors) -> Tensors:
    features = run(f"video_{kind}_encoder", encoded)
    updated = run(f"video_{kind}_gru", {"h0": state["h0"], "h1": state["h1"], **features})
    hidden = {"h0": updated["h0_next"], "h1": updated["h1_next"]}
    return hidden | run(f"video_{kind}_decoder", hidden | decoded)


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
