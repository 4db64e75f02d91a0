"""Export a checkpoint to a verified model folder: `export_checkpoint`.

The folder holds `model.json`, one ONNX file for each graph (`roomlight_export.graphs` has names and shapes), and in
`ort/` the same graphs in ONNX Runtime's own format for phones. It is created atomically, after verification.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from roomlight.engine.networks.graphs import DESCRIPTION, FORMAT
from roomlight.engine.networks.providers import open_graph
from roomlight.errors import ModelError
from roomlight_export.folder import check_target, new_folder
from roomlight_export.graphs import Graph, graphs_of
from roomlight_export.inputs import probe_frames, room_volume
from roomlight_export.onnx_file import OPSET, half_rounded, to_onnx
from roomlight_export.ort_file import write_ort
from roomlight_export.parity import (
    TOLERANCE,
    Parity,
    compare_blending,
    compare_small,
    compare_volumes,
    session_runner,
    torch_runner,
)
from roomlight_model.checkpoint import Checkpoint, load_checkpoint

ProgressCallback = Callable[[str], object]

RECURRENT_STEPS = 8
"""Steps after frame 0 over which parity is checked."""


@dataclass(frozen=True)
class ExportReport:
    """The files written and their differences to PyTorch."""

    out: Path
    form: str
    graphs: tuple[str, ...]
    parameters: int
    onnx_bytes: int
    ort_bytes: int
    tolerance: float
    parity: dict[str, Parity]
    """By network: "sg" and "blend", or the small network's form."""
    untrained: tuple[str, ...] = ()
    """Of "sglv" and "blending": what no stage of the form trained, if the card names all stages."""


def export_checkpoint(
    checkpoint: Path,
    out: Path,
    *,
    ort: bool = True,
    tolerance: float = TOLERANCE,
    progress: ProgressCallback | None = None,
) -> ExportReport:
    """Write a verified model folder from a checkpoint; an older model folder at `out` is replaced.

    Args:
        ort: Whether to write the `.ort` files too.
        tolerance: Largest difference to PyTorch.
        progress: Receives a message at the start of each step.

    Raises:
        ModelError: The checkpoint does not load, or a graph differs from PyTorch by more than `tolerance`.
        OutputError: `out` cannot be written, or holds other files.
    """
    report_step: ProgressCallback = progress or (lambda _: None)
    loaded = load_checkpoint(checkpoint)
    check_target(out)
    graphs = {graph.name: graph for graph in graphs_of(half_rounded(loaded.model, str(checkpoint)))}
    with new_folder(out) as folder:
        for name, graph in graphs.items():
            report_step(f"exporting {name}")
            model = to_onnx(graph, metadata=_metadata(loaded, name))
            (folder / f"{name}.onnx").write_bytes(model.SerializeToString())
        report_step("comparing with PyTorch")
        parity = _verify(loaded, folder, graphs)
        _check_parity(parity, tolerance, checkpoint)
        if ort:
            (folder / "ort").mkdir()
            for name, graph in graphs.items():
                report_step(f"writing {name}.ort")
                write_ort(folder / f"{name}.onnx", folder / "ort" / f"{name}.ort", graph, tolerance=tolerance)
        report = ExportReport(
            out=out,
            form=loaded.form,
            graphs=tuple(graphs),
            parameters=sum(weight.numel() for weight in loaded.model.parameters()),
            onnx_bytes=sum(path.stat().st_size for path in folder.glob("*.onnx")),
            ort_bytes=sum(path.stat().st_size for path in folder.glob("ort/*.ort")),
            tolerance=tolerance,
            parity=parity,
            untrained=_untrained(loaded),
        )
        _describe(folder, loaded, graphs, report)
    return report


def _untrained(loaded: Checkpoint) -> tuple[str, ...]:
    cards = [loaded.card]
    while (before := cards[-1].get("before")) is not None:
        cards.append(before)
    stages = {str(card.get("stage", "")) for card in cards}
    if loaded.form not in ("single", "video") or "" in stages:
        return ()
    networks = (("sglv", "sglv"), ("blending", "blend"))
    return tuple(name for name, own in networks if not stages & {f"{loaded.form}-{end}" for end in (own, "joint")})


def _metadata(loaded: Checkpoint, name: str) -> dict[str, str]:
    return {
        "roomlight.format": str(FORMAT),
        "roomlight.form": loaded.form,
        "roomlight.graph": name,
        "roomlight.config": json.dumps(_config(loaded)),
        "roomlight.card": json.dumps(loaded.card),
    }


def _config(loaded: Checkpoint) -> dict[str, object]:
    """Return the configuration of the networks; the small ones have none."""
    return dict(loaded.config.to_dict()) if loaded.form in ("single", "video") else {}


def _verify(loaded: Checkpoint, folder: Path, graphs: Mapping[str, Graph]) -> dict[str, Parity]:
    files = session_runner({name: open_graph(folder / f"{name}.onnx", "cpu") for name in graphs})
    runs = files, torch_runner(graphs)
    if loaded.form not in ("single", "video"):
        return {loaded.form: compare_small(*runs, graph=graphs[loaded.form])}
    recurrent = loaded.form == "video"
    shape, frames = loaded.config.sg.volume_shape, RECURRENT_STEPS + 1
    volumes = [room_volume(shape, frame=frame) for frame in range(frames)]
    panoramas = probe_frames(loaded.config.blend.height, frames=frames)
    return {
        "sg": compare_volumes(*runs, volumes=volumes, recurrent=recurrent),
        "blend": compare_blending(*runs, frames=panoramas, recurrent=recurrent),
    }


def _check_parity(parity: Mapping[str, Parity], tolerance: float, checkpoint: Path) -> None:
    for network, result in parity.items():
        name, worst = max(result.error.items(), key=lambda entry: entry[1])
        if not worst <= tolerance:
            raise ModelError(
                f"{checkpoint}: the exported {network} networks differ from PyTorch by {worst:.2g} in {name} "
                f"over {result.steps} frames, more than the {tolerance:g} allowed; nothing was written"
            )


def _describe(folder: Path, loaded: Checkpoint, graphs: Mapping[str, Graph], report: ExportReport) -> None:
    def entry(name: str, graph: Graph) -> dict[str, object]:
        files = {"onnx": folder / f"{name}.onnx", "ort": folder / "ort" / f"{name}.ort"}
        described: dict[str, object] = {
            "inputs": {key: list(shape) for key, shape in graph.inputs.items()},
            "outputs": {key: list(shape) for key, shape in graph.outputs.items()},
            "sha256": _sha256(files["onnx"]),
        }
        if files["ort"].exists():
            described["ort_sha256"] = _sha256(files["ort"])
        return described

    card = {
        "format": FORMAT,
        "form": loaded.form,
        "config": _config(loaded),
        "card": loaded.card,
        "opset": OPSET,
        "graphs": {name: entry(name, graph) for name, graph in graphs.items()},
        "parity": {
            "tolerance": report.tolerance,
            **{network: asdict(parity) for network, parity in report.parity.items()},
        },
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    (folder / DESCRIPTION).write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
