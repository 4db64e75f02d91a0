"""`roomlight bench stages`: the engine's stages, one by one."""

from typing import Annotated

import typer

from roomlight.files import write_json
from roomlight_bench.stages.stages import run_stages
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("stages")
def bench_stages(
    repeats: Annotated[int, typer.Option(min=1, help="Interleaved repeats of each stage.")] = 7,
    weights: arguments.Weights = None,
    json_out: arguments.FiguresJson = None,
) -> None:
    """Time each stage beside its reference and plain PyTorch; networks also against this machine's peak."""
    with console.err.status("measuring") as status:
        report = run_stages(repeats=repeats, model=weights, progress=status.update)
    console.print_table(console.out, report.table(width=console.out.width))
    if json_out:
        write_json(json_out, report.to_json())
