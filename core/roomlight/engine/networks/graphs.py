"""Model directories: the ONNX graphs of `roomlight export`, checked and loaded once, shared by all sessions.

`model.json` states the network form, the configuration, the training card and each graph's digest. Form `single` has
single_{sg_encoder,sg_decoder,blend_encoder,blend_decoder}; `video` has these for its first frame, and
video_{sg_encoder,sg_gru,sg_decoder,blend_encoder,blend_gru,blend_decoder}.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np
from jaxtyping import Float32

from roomlight.engine.networks.providers import Provider, open_graph, resolve_provider
from roomlight.engine.networks.runtime import ort
from roomlight.errors import ModelError

NetworkForm = Literal["single", "video"]
"""Single-view networks take one volume, of a frame or fused; video networks keep hidden states between frames."""
Buffers = dict[str, Float32[np.ndarray, "..."]]
"""Arrays by the names of a graph's inputs or outputs; their ranks differ, `Graph.bind` checks the shapes."""
FORMAT: Final = 1
"""Version of `model.json`; written by `roomlight_export.exporting`."""
DESCRIPTION: Final = "model.json"
SINGLE_GRAPHS: Final = (
    "single_sg_encoder",
    "single_sg_decoder",
    "single_blend_encoder",
    "single_blend_decoder",
)
VIDEO_GRAPHS: Final = (
    "video_sg_encoder",
    "video_sg_gru",
    "video_sg_decoder",
    "video_blend_encoder",
    "video_blend_gru",
    "video_blend_decoder",
)
PartForm = Literal["clipping", "objects"]
"""Networks that serve every model, each a model directory of its own."""
FORMS: Final = (*get_args(NetworkForm), *get_args(PartForm))
"""Forms of a model directory."""
SHIPPED: Final = Path(__file__).parents[1] / "weights"
"""Trained weights inside the package: a directory for each network form."""


class Graph:
    """A loaded graph, run on fixed buffers."""

    def __init__(self, session: ort.InferenceSession, name: str, digest: str = "") -> None:
        """Read the static shapes of inputs and outputs.

        digest:  SHA-256 of the graph's file.

        Raises:
            ModelError: a shape is dynamic.
        """
        self._session = session
        self.name, self.digest = name, digest
        self.inputs = {node.name: tuple(node.shape) for node in session.get_inputs()}
        self.outputs = {node.name: tuple(node.shape) for node in session.get_outputs()}
        for key, shape in (self.inputs | self.outputs).items():
            if not all(isinstance(size, int) for size in shape):
                raise ModelError(f"graph {name}: {key} has the shape {shape}; RoomLight's graphs have static shapes")

    def new_outputs(self) -> Buffers:
        """Return zeroed buffers for every output."""
        return {name: np.zeros(shape, np.float32) for name, shape in self.outputs.items()}

    def bind(self, inputs: Buffers, outputs: Buffers) -> "BoundGraph":
        """Bind the buffers once: every later run reads and writes them in place, without a copy.

        Raises:
            ModelError: names, sizes or memory layout do not fit the graph.
        """
        binding = self._session.io_binding()
        for wanted, given, bind in (
            (self.inputs, inputs, binding.bind_ortvalue_input),
            (self.outputs, outputs, binding.bind_ortvalue_output),
        ):
            if wanted.keys() != given.keys():
                raise ModelError(f"graph {self.name} has {sorted(wanted)}, the engine gives {sorted(given)}")
            for name, array in given.items():
                if array.size != int(np.prod(wanted[name])):
                    raise ModelError(f"graph {self.name}: {name} is {wanted[name]}, the engine has {array.shape}")
                if not array.flags.c_contiguous:
                    raise ModelError(f"graph {self.name}: the buffer for {name} is not contiguous")
                bind(name, ort.OrtValue.ortvalue_from_numpy(array.reshape(wanted[name])))
        return BoundGraph(self._session, binding, (*inputs.values(), *outputs.values()))


@dataclass(frozen=True)
class BoundGraph:
    """A graph with its buffers; `arrays` keeps them alive, because ONNX Runtime holds only their addresses."""

    session: ort.InferenceSession
    binding: ort.IOBinding
    arrays: tuple[Float32[np.ndarray, "..."], ...]

    def run(self) -> None:
        """Run once on the bound buffers."""
        self.session.run_with_iobinding(self.binding)


@dataclass(frozen=True)
class LightingGraphs:
    """A loaded model directory."""

    path: Path
    form: NetworkForm
    card: dict[str, Any]
    provider: Literal["cpu", "openvino"]
    graphs: dict[str, Graph]
    filled: bool
    """Whether a fill is mixed in beyond the mesh (`BlendConfig.filled`), or only the volume is used there."""

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """Shape (z, y, x) of the volumes that the graphs take."""
        z, y, x = self.graphs["single_sg_encoder"].inputs["volume"][-3:]
        return z, y, x

    @property
    def digest(self) -> str:
        """Identity of the weights, of all graphs together."""
        return hashlib.sha256("".join(graph.digest for graph in self.graphs.values()).encode()).hexdigest()

    @property
    def panorama_height(self) -> int:
        """Rows of the panoramas that the blending graphs take."""
        return self.graphs["single_blend_encoder"].inputs["panels"][-2]


def load_graphs(path: Path, *, provider: Provider = "auto") -> LightingGraphs:
    """Load and check a model directory.

    Raises:
        ModelError: it is not a model directory, a graph is missing or differs from its digest, the provider is not
            available, or the weights were never trained.
    """
    index = read_description(path)
    form, card, entries = index["form"], index["card"], index["graphs"]
    if form not in get_args(NetworkForm):
        raise ModelError(f"{path}: holds networks of the form {form}, which no model runs by itself")
    if not card.get("steps"):
        raise ModelError(
            f"{path}: these weights were never trained (steps = {card.get('steps', 'not stated')}), "
            "their light would be noise; train them with `roomlight train`"
        )
    resolved = resolve_provider(provider)
    graphs: dict[str, Graph] = {}
    for name in SINGLE_GRAPHS + (VIDEO_GRAPHS if form == "video" else ()):
        graphs[name] = _checked_graph(path, name, entries, resolved)
    return LightingGraphs(
        path, form, card, resolved, graphs, bool(index["config"].get("blend", {}).get("filled", True))
    )


def load_part(path: Path, form: PartForm, *, provider: Provider = "auto") -> Graph:
    """Load the directory of a network that serves every model: one graph, which has the name of its form.

    Raises:
        ModelError: it is not such a directory, the graph is missing or differs from its digest, the provider is not
            available, or the weights were never trained.
    """
    index = read_description(path)
    if index["form"] != form:
        raise ModelError(f"{path}: holds networks of the form {index['form']}, not {form}")
    if not index["card"].get("steps"):
        raise ModelError(f"{path}: these weights were never trained; train them with `roomlight train {form}`")
    return _checked_graph(path, form, index["graphs"], resolve_provider(provider))


def _checked_graph(path: Path, name: str, entries: dict[str, Any], provider: Literal["cpu", "openvino"]) -> Graph:
    file, entry = path / f"{name}.onnx", entries.get(name)
    if not isinstance(entry, dict) or not file.is_file():
        raise ModelError(f"{file}: missing; export the checkpoint again")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    if digest != entry.get("sha256"):
        raise ModelError(f"{file}: is not the graph that {DESCRIPTION} names (digest differs); export again")
    return Graph(open_graph(file, provider), name, digest)


def read_description(path: Path) -> dict[str, Any]:
    """Read `model.json` of a model directory: form, and the mappings config, card and graphs.

    Raises:
        ModelError: it is missing or damaged.
    """
    index_path = path / DESCRIPTION
    try:
        index = json.loads(index_path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(
            f"{index_path}: cannot be read ({error.strerror or error}); a model directory comes from `roomlight export`"
        ) from error
    except ValueError as error:
        raise ModelError(f"{index_path}: is not JSON ({error})") from error
    if not isinstance(index, dict) or index.get("format") != FORMAT or index.get("form") not in FORMS:
        raise ModelError(
            f"{index_path}: is not a RoomLight model of format {FORMAT} whose form is one of {', '.join(FORMS)}"
        )
    parts = {name: {} if index.get(name) is None else index[name] for name in ("config", "card", "graphs")}
    blend = parts["config"].get("blend", {}) if isinstance(parts["config"], dict) else None
    if not all(isinstance(part, dict) for part in (*parts.values(), blend)):
        raise ModelError(
            f"{index_path}: its card, its configuration or its list of graphs is damaged; export the checkpoint again"
        )
    return index | parts
