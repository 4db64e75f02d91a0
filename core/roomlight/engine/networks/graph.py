"""A loaded graph, whichever runtime it is in, and the buffers that it is run on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from roomlight.engine.networks.openvino_runtime import OpenVinoGraph
from roomlight.engine.networks.runtime import Buffers, OnnxRuntimeGraph, RuntimeName
from roomlight.errors import ModelError


class Graph:
    """A loaded graph, run on fixed buffers."""

    def __init__(self, loaded: OnnxRuntimeGraph | OpenVinoGraph, name: str, digest: str = "") -> None:
        """Check that all shapes are static.

        Args:
            digest: SHA-256 of the graph's file.

        Raises:
            ModelError: a shape is dynamic.
        """
        self._loaded = loaded
        self.name, self.digest = name, digest
        self.inputs = {key: _static(name, key, shape) for key, shape in loaded.inputs.items()}
        self.outputs = {key: _static(name, key, shape) for key, shape in loaded.outputs.items()}

    @property
    def runtime(self) -> RuntimeName:
        """Where it runs."""
        return self._loaded.runtime

    def new_inputs(self) -> Buffers:
        """Return zeroed buffers for every input."""
        return {name: np.zeros(shape, np.float32) for name, shape in self.inputs.items()}

    def new_outputs(self) -> Buffers:
        """Return zeroed buffers for every output."""
        return {name: np.zeros(shape, np.float32) for name, shape in self.outputs.items()}

    def bind(self, inputs: Buffers, outputs: Buffers) -> "BoundGraph":
        """Bind the buffers once: every later run reads and writes them in place, without a copy.

        Raises:
            ModelError: names, sizes or memory layout do not fit the graph.
        """
        fitting = [self._fit(self.inputs, inputs), self._fit(self.outputs, outputs)]
        return BoundGraph(self._loaded.bind(*fitting), (*inputs.values(), *outputs.values()))

    def _fit(self, wanted: dict[str, tuple[int, ...]], given: Buffers) -> Buffers:
        """Return the buffers with the graph's shapes."""
        if wanted.keys() != given.keys():
            raise ModelError(f"graph {self.name} has {sorted(wanted)}, the engine gives {sorted(given)}")
        for name, array in given.items():
            if array.size != int(np.prod(wanted[name])):
                raise ModelError(f"graph {self.name}: {name} is {wanted[name]}, the engine has {array.shape}")
            if not array.flags.c_contiguous:
                raise ModelError(f"graph {self.name}: the buffer for {name} is not contiguous")
        return {name: array.reshape(wanted[name]) for name, array in given.items()}


@dataclass(frozen=True)
class BoundGraph:
    """A graph with its buffers; `arrays` keeps them alive, because the runtime holds only their addresses."""

    call: Callable[[], object]
    arrays: tuple[Float32[np.ndarray, "..."], ...]

    def run(self) -> None:
        """Run once on the bound buffers."""
        self.call()


def _static(graph: str, key: str, shape: tuple[int | str, ...]) -> tuple[int, ...]:
    sizes = tuple(size for size in shape if isinstance(size, int))
    if len(sizes) != len(shape):
        raise ModelError(f"graph {graph}: {key} has the shape {shape}; RoomLight's graphs have static shapes")
    return sizes
