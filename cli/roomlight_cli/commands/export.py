"""`roomlight export`: a PyTorch checkpoint as a model folder of ONNX graphs."""

from pathlib import Path
from typing import get_args

from roomlight.engine.networks.graphs import PARTS, NetworkForm
from roomlight_cli.console import remark, say
from roomlight_cli.progress import Progress
from roomlight_export.exporting import ExportReport, export_checkpoint
from roomlight_model.checkpoint import load_checkpoint


def export(checkpoint: Path, *, out: Path, ort: bool = True) -> None:
    """Export a checkpoint as verified ONNX graphs (needs the `train` extra).

    Each graph's output is compared with the PyTorch network's.

    Args:
        checkpoint: A PyTorch checkpoint that `roomlight train` wrote.
        out: Model folder to write, for --weights of the other commands. Of the networks that serve every model
            (clipping, objects, depth), the folder that is to hold it under its form's name.
        ort: Also write .ort files, ONNX Runtime's format for phones.
    """
    with Progress("exporting and verifying the graphs") as progress:
        folder = model_folder(out, load_checkpoint(checkpoint).form)
        report = export_checkpoint(checkpoint, folder, ort=ort, progress=progress.say)
    warn_of_untrained(report)
    say(
        f"{report.form} model, {report.parameters / 1e6:.2f} M parameters: {len(report.graphs)} graphs in "
        f"{report.out}, {report.onnx_bytes / 1e6:.1f} MB of ONNX"
        + (f", {report.ort_bytes / 1e6:.1f} MB of .ort" if report.ort_bytes else "")
    )
    for network, parity in report.parity.items():
        say(
            f"  {network}: largest difference to PyTorch {parity.largest:.2e} over {parity.steps} steps "
            f"(tolerance {report.tolerance:.0e})"
        )
    say(f"Use it with {use_of(report)}")


def model_folder(out: Path, form: str) -> Path:
    """Return where a model of a form is written: of networks that serve every model, in a folder of their own."""
    return out if form in get_args(NetworkForm) else out / form


def use_of(report: ExportReport) -> str:
    """Return the option by which other commands use an exported model."""
    if report.form == "depth":
        return f"--depth-model {report.out}"
    return f"--parts {report.out.parent}" if report.form in PARTS else f"--weights {report.out}"


def warn_of_untrained(report: ExportReport) -> None:
    """Print which networks of an exported model no stage trained."""
    of_video = "had no stage of its own, so its light may be wrong"
    effect = of_video if report.form == "video" else "is untrained, so its light is wrong"
    for name in report.untrained:
        end = "sglv" if name == "sglv" else "blend"
        stages = f"{report.form}-{end} or {report.form}-joint"
        remark("warning:", f"{report.out}: its {name} network {effect}; train {stages} too")
