"""Export the small networks that serve every model: a folder of one verified graph, with its card."""

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import nn

from roomlight.compositing.light.object_light import OBJECT_PANELS
from roomlight.engine.networks.clipping import CHANNELS, SIDE
from roomlight.engine.networks.graphs import DESCRIPTION, FORMAT, PartForm
from roomlight.engine.networks.providers import open_graph
from roomlight.engine.panorama.panels import HEIGHT, PANELS
from roomlight.errors import ModelError
from roomlight_export.exporting import ExportReport
from roomlight_export.folder import check_target, new_folder
from roomlight_export.graphs import Graph
from roomlight_export.onnx_file import OPSET, half_rounded, to_onnx
from roomlight_export.parity import TOLERANCE, Parity
from roomlight_model.part_checkpoint import load_part_checkpoint

_TRIALS: Final = 4


def part_graph(form: PartForm, network: nn.Module) -> Graph:
    """Return the graph of a network, with the names that the engine binds."""
    if form == "clipping":
        shapes = {"planes": (1, CHANNELS, SIDE, SIDE)}, {"log_radiance": (1, 3, SIDE // 2, SIDE // 2)}
    elif form == "completion":
        shapes = {"panels": (1, PANELS, HEIGHT, 2 * HEIGHT)}, {"change": (1, 3, HEIGHT, 2 * HEIGHT)}
    else:
        shapes = {"panels": (1, OBJECT_PANELS, HEIGHT, 2 * HEIGHT)}, {"changes": (1, 6, HEIGHT, 2 * HEIGHT)}
    return Graph(form, network, *shapes)


def export_part(checkpoint: Path, out: Path, *, tolerance: float = TOLERANCE) -> ExportReport:
    """Write the verified model folder of a network that serves every model; an older model folder at `out` is replaced.

    Raises:
        ModelError: The checkpoint does not load, or the graph differs from PyTorch by more than `tolerance`.
        OutputError: `out` cannot be written, or holds other files.
    """
    loaded = load_part_checkpoint(checkpoint)
    check_target(out)
    rounded = half_rounded(loaded.network, str(checkpoint))
    graph = part_graph(loaded.form, rounded)
    with new_folder(out) as folder:
        file = folder / f"{graph.name}.onnx"
        card = {"roomlight.form": loaded.form, "roomlight.card": json.dumps(loaded.card)}
        file.write_bytes(to_onnx(graph, metadata=card).SerializeToString())
        error, rounding = _largest_differences(graph, file, loaded.network)
        if not error <= tolerance:
            raise ModelError(
                f"{checkpoint}: the exported network differs from PyTorch by {error:.2g}, more than the {tolerance:g} "
                "allowed; nothing was written"
            )
        described = {
            "format": FORMAT,
            "form": loaded.form,
            "config": {},
            "card": loaded.card,
            "opset": OPSET,
            "graphs": {
                graph.name: {
                    "inputs": {key: list(shape) for key, shape in graph.inputs.items()},
                    "outputs": {key: list(shape) for key, shape in graph.outputs.items()},
                    "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
                }
            },
            "parity": {"tolerance": tolerance, "largest": error},
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        (folder / DESCRIPTION).write_text(json.dumps(described, indent=1) + "\n", encoding="utf-8")
        size = file.stat().st_size
    (output,) = graph.outputs
    return ExportReport(
        out=out,
        form=loaded.form,
        graphs=(graph.name,),
        parameters=sum(weight.numel() for weight in loaded.network.parameters()),
        onnx_bytes=size,
        ort_bytes=0,
        tolerance=tolerance,
        parity={loaded.form: Parity(_TRIALS, {output: error}, {output: rounding})},
    )


def _largest_differences(graph: Graph, file: Path, original: nn.Module) -> tuple[float, float]:
    """Compare ONNX Runtime with PyTorch, with rounded and with original weights, on random inputs like the engine's."""
    session, rng = open_graph(file, "cpu"), np.random.default_rng(0)
    ((name, shape),) = graph.inputs.items()
    error = rounding = 0.0
    for _ in range(_TRIALS):
        values = rng.random(shape).astype(np.float32)
        if graph.name != "clipping":
            radiance = [0, 1, 2, *range(6, shape[1])]
            values[:, radiance] = np.exp(rng.normal(-1, 1.5, (1, len(radiance), *shape[2:]))).clip(0, 30)
        found = np.asarray(session.run(None, {name: values})[0])
        with torch.no_grad():
            wanted, exact = (module(torch.from_numpy(values)).numpy() for module in (graph.module, original))
        error = max(error, float(np.abs(found - wanted).max()))
        rounding = max(rounding, float(np.abs(found - exact).max()))
    return error, rounding
