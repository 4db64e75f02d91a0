"""`roomlight bench rendering`: how the rendering layer of training samples light."""

from pathlib import Path
from typing import Annotated

import typer

from roomlight.captures import open_capture
from roomlight.files import write_json
from roomlight.images import read_panorama
from roomlight.sample import sample_capture
from roomlight.spheres import view_toward
from roomlight_bench.training.rendering import compare_sampling
from roomlight_cli import arguments, console
from roomlight_cli.lazy import single_command_app

app = single_command_app()


@app.command("rendering")
def bench_rendering(
    panorama: Annotated[
        Path | None, typer.Argument(help="An HDR panorama (EXR) that lights the sphere; default: the sample room's.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Also write a PNG of the spheres.")] = None,
    json_out: arguments.FiguresJson = None,
) -> None:
    """Compare importance sampling of the rendering layer with uniform directions (needs the `train` extra).

    Both use the same number of directions.
    """
    view = (0.0, 0.0, -1.0)
    if panorama is None:
        capture = open_capture(sample_capture())
        probe = capture.probes[0]
        light, view = probe.panorama(), view_toward(next(iter(capture)).camera_to_world, probe.position)
    else:
        light = read_panorama(panorama)
    with console.err.status("rendering") as status:
        report = compare_sampling(light, view, progress=status.update)
    console.print_table(console.out, report.table())
    if json_out:
        write_json(json_out, report.to_json())
    if picture:
        report.write_picture(picture)
        console.say(f"Picture: {picture}")
