"""`roomlight export`: a PyTorch checkpoint as a model folder of ONNX graphs."""

from pathlib import Path

from roomlight_cli.console import remark, say
from roomlight_cli.progress import Progress
from roomlight_export.exporting import ExportReport, export_checkpoint


def export(checkpoint: Path, *, out: Path, ort: bool = True) -> None:
    """Export a checkpoint as verified ONNX graphs (needs the `train` extra).

    Each graph's output is compared with the PyTorch network's.

    Args:
        checkpoint: A PyTorch checkpoint that `roomlight train` wrote.
        out: Model folder to write, for --weights of the other commands.
        ort: Also write .ort files, ONNX Runtime's format for phones.
    """
    with Progress("exporting and verifying the graphs") as progress:
        report = export_checkpoint(checkpoint, out, ort=ort, progress=progress.say)
    warn_of_untrained(report)
    say(
        f"{report.form} model, {report.parameters / 1e6:.2f} M parameters: {len(report.graphs)} graphs in {out}, "
        f"{report.onnx_bytes / 1e6:.1f} MB of ONNX"
        + (f", {report.ort_bytes / 1e6:.1f} MB of .ort" if report.ort_bytes else "")
    )
    for network, parity in report.parity.items():
        say(
            f"  {network}: largest difference to PyTorch {parity.largest:.2e} over {parity.steps} steps "
            f"(tolerance {report.tolerance:.0e})"
        )


def warn_of_untrained(report: ExportReport) -> None:
    """Print which networks of an exported model no stage trained."""
    for name in report.untrained:
        end = "sglv" if name == "sglv" else "blend"
        stages = f"{report.form}-{end} or {report.form}-joint"
        remark("warning:", f"{report.out}: its {name} network is untrained, so its light is wrong; train {stages} too")
