"""`roomlight export`: a PyTorch checkpoint as a model folder of ONNX graphs."""

from pathlib import Path

from roomlight_cli.console import say
from roomlight_cli.progress import Progress
from roomlight_export.exporting import export_checkpoint


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
