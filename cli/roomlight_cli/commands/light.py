"""`roomlight light`: HDR light at points of a room, from one photograph with depth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from roomlight_cli import arguments as given
from roomlight_cli import console


def light(
    image: Annotated[Path, typer.Argument(help="The photograph: JPEG, PNG, or linear EXR.")],
    depth: Annotated[Path, typer.Option(help="Its depth: 16-bit PNG in mm, EXR in m, or .npy (floats: m).")],
    probe: Annotated[
        list[str],
        typer.Option(help="A point X,Y,Z in metres from the camera: x right, y up, z backward; repeatable."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for panoramas and pictures.")],
    fov: Annotated[float, typer.Option(min=5, max=150, help="Horizontal field of view in degrees.")] = 60.0,
    depth_unit: Annotated[
        float | None, typer.Option(min=1e-6, max=1000, help="Metres for one stored unit of a PNG or .npy.")
    ] = None,
    height: Annotated[int, typer.Option(min=16, max=2048, help="Panorama height in pixels.")] = 120,
    model: given.Model = "auto",
    weights: given.Weights = None,
    provider: given.Runtime = "auto",
    allow_untrained: given.AllowUntrained = False,
    unknown_depth: given.UnknownDepthOption = "rim",
) -> None:
    """Light at points of a single photograph: EXR and PNG panoramas, mirror and glossy spheres, the main light."""
    from roomlight.engine.session import choose_graphs, warm_up
    from roomlight_cli.photo import light_photo, read_photo

    positions = [given.parse_position(text) for text in probe]
    options = given.session_options(
        model=model,
        weights=weights,
        provider=provider,
        allow_untrained=allow_untrained,
        unknown_depth=unknown_depth,
        height=height,
    )
    frame = read_photo(image, depth, fov_deg=fov, depth_unit_m=depth_unit)
    graphs = choose_graphs(options)
    with console.err.status("estimating the light"):
        warm_up()
        found = light_photo(frame, positions, out, options=options, graphs=graphs)
    for one in found:
        x, y, z = one.position
        note = "" if one.inside else "  [yellow](outside the lighting volume: distant light only)[/]"
        console.out.print(
            f"({x:.2f}, {y:.2f}, {z:.2f}) m: {one.light.coverage:.0%} of the sphere is in the photograph{note}",
            soft_wrap=True,
        )
        console.out.print(f"  {_described(one.heading, one.main.intensity.tolist())}", soft_wrap=True)
    console.say(f"Look at {out / found[0].files[2]}; the light is {out / found[0].files[0]}, figures in light.json")


def _described(heading: tuple[float, float], intensity: list[float]) -> str:
    if not any(intensity):
        return "no main light: it comes evenly from everywhere"
    elevation, azimuth = heading
    red, green, blue = intensity
    side = "right" if azimuth >= 0 else "left"
    return (
        f"main light {abs(elevation):.0f} degrees {'above' if elevation >= 0 else 'below'} the horizon, "
        f"{abs(azimuth):.0f} degrees to the {side} of the view; intensity {red:.3g} {green:.3g} {blue:.3g} (RGB)"
    )
