"""`roomlight export`: a PyTorch checkpoint as a model folder of ONNX graphs."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight_cli.console import err, say
from roomlight_cli.lazy import single_command_app
from roomlight_export.exporting import export_checkpoint

app = single_command_app()


@app.command()
def export(
    checkpoint: Annotated[Path, typer.Argument(help="A PyTorch checkpoint that `roomlight train` wrote.")],
    out: Annotated[Path, typer.Option(help="Model folder to write, for --weights of the other commands.")],
    ort: Annotated[
        bool, typer.Option("--ort/--no-ort", help="Also write .ort files, ONNX Runtime's format for phones.")
    ] = True,
) -> None:
    """Export a checkpoint as verified ONNX graphs (needs the `train` extra).

    Each graph's output is compared with the PyTorch network's.
    """
    with err.status("exporting and verifying the graphs") as status:
        report = export_checkpoint(checkpoint, out, ort=ort, progress=status.update)
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
