"""Model directories: the ONNX graphs of `roomlight export`, checked and loaded once, shared by all sessions.

`model.json` states the network form, the configuration, the training card and each graph's digest. Form `single` has
single_{sg_encoder,sg_decoder,blend_encoder,blend_decoder}; `video` has these for its first frame, and
video_{sg_encoder,sg_gru,sg_decoder,blend_encoder,blend_gru,blend_decoder}.
"""

import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

from roomlight.engine.networks.graph import Graph
from roomlight.engine.networks.providers import Provider, open_graphs
from roomlight.errors import ModelError

NetworkForm = Literal["single", "video"]
"""Single-view networks take one volume, of a frame or fused; video networks keep hidden states between frames."""
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
PartForm = Literal["clipping", "objects", "depth"]
"""Networks that serve every model, each a model directory of its own."""
PARTS: Final = ("clipping", "objects", "prior")
"""Folders of `SessionOptions.parts`: two of networks, and the prior over panoramas."""
PartFiles = tuple[tuple[str, int, int], ...]
"""See `part_files`."""
FORMS: Final = (*get_args(NetworkForm), *get_args(PartForm))
"""Forms of a model directory."""
SHIPPED: Final = Path(__file__).parents[1] / "weights"
"""Trained weights inside the package: a directory for each network form."""


@dataclass(frozen=True)
class LightingGraphs:
    """A loaded model directory."""

    path: Path
    form: NetworkForm
    card: dict[str, Any]
    graphs: dict[str, Graph]

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
    parts = [name for name in (*PARTS, "depth") if (path / name).is_dir()]
    if parts and not (path / DESCRIPTION).exists():
        raise ModelError(f"{path}: holds {', '.join(parts)} and no model; {_use_of(parts[0], path / parts[0])}")
    index = read_description(path)
    form, card, entries = index["form"], index["card"], index["graphs"]
    if form not in get_args(NetworkForm):
        use = _use_of(form, path)
        raise ModelError(f"{path}: holds networks of the form {form}, which no model runs by itself; {use}")
    if not card.get("steps"):
        raise ModelError(
            f"{path}: these weights were never trained (steps = {card.get('steps', 'not stated')}), "
            "their light would be noise; train them with `roomlight train`"
        )
    names = SINGLE_GRAPHS + (VIDEO_GRAPHS if form == "video" else ())
    return LightingGraphs(path, form, card, _open_checked(path, names, entries, provider))


def _use_of(part: str, folder: Path) -> str:
    return f"use it with `depth_model` {folder}" if part == "depth" else f"use it with `parts` {folder.parent}"


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
    return _open_checked(path, (form,), index["graphs"], provider)[form]


def part_folder(parts: Path | None, name: str) -> Path:
    """Return the folder of one of `PARTS`: in `parts` if it is there, else inside the package.

    Raises:
        ModelError: `parts` has none of them.
    """
    if parts is None:
        return SHIPPED / name
    if not any((parts / known).is_dir() for known in PARTS):
        raise ModelError(f"{parts}: has none of the folders {', '.join(PARTS)}; `roomlight train` makes them in `onnx`")
    return parts / name if (parts / name).is_dir() else SHIPPED / name


def part_files(folder: Path) -> PartFiles:
    """Return name, time of change and size of a network's files: what is loaded of them once has these for a key."""
    files: list[tuple[str, int, int]] = []
    for file in sorted((folder / DESCRIPTION, *folder.glob("*.onnx"), *folder.glob("*.npz"))):
        with suppress(FileNotFoundError):  # loading tells what is missing
            status = file.stat()
            files.append((file.name, status.st_mtime_ns, status.st_size))
    return tuple(files)


def _open_checked(path: Path, names: Sequence[str], entries: dict[str, Any], provider: Provider) -> dict[str, Graph]:
    digests = [_checked_digest(path, name, entries) for name in names]
    whole = hashlib.sha256("".join(digests).encode()).hexdigest()
    graphs = open_graphs([path / f"{name}.onnx" for name in names], whole, provider)
    for graph, digest in zip(graphs, digests, strict=True):
        graph.digest = digest
    return {graph.name: graph for graph in graphs}


def _checked_digest(path: Path, name: str, entries: dict[str, Any]) -> str:
    """Return the SHA-256 of a graph's file, which is that in `model.json`."""
    file, entry = path / f"{name}.onnx", entries.get(name)
    if not isinstance(entry, dict) or not file.is_file():
        raise ModelError(f"{file}: missing; export the checkpoint again")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    if digest != entry.get("sha256"):
        raise ModelError(f"{file}: is not the graph that {DESCRIPTION} names (digest differs); export again")
    return digest


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
