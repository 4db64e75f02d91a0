"""The generator's light against a path tracer's, as a table and as pictures."""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from rich.console import Console

from roomlight.imaging.drawing import HEADING, LABEL, LABEL_ROWS, Canvas
from roomlight_generator.reports.tables import figure_table
from roomlight_generator.verification.check import (
    JUDGED_NOISE,
    CheckReport,
    ProbeDeviation,
    RoomCheck,
    SurfaceDeviation,
    View,
)

DIFFUSE_TARGET: Final = 0.05
PROBE_TARGET: Final = 0.03

_SHOWN_ERROR: Final = 0.25
"""The relative error that is shown in full colour: red where RoomLight is brighter, blue where it is darker."""
_TILE: Final = (480, 360)
_PROBE: Final = (480, 240)
_MARGIN: Final = 12


def print_check(terminal: Console, report: CheckReport) -> None:
    """Print errors of surfaces and probes, a row per room, and compare the means with the two targets.

    Each error is followed by what the reference's noise alone would give; rms is the error without that noise.
    """
    diffuse, coated, probe = report.diffuse(), report.coated(), report.probe()
    for title, parts, total in (
        ("Diffuse surfaces in frames", [room.diffuse for room in report.rooms], diffuse),
        ("Coated surfaces in frames", [room.coated for room in report.rooms], coated),
    ):
        surfaces = figure_table(f"{title}: relative error in %", ("mean", "noise", "4x4", "noise", "rms", "bias"))
        for room, part in zip(report.rooms, parts, strict=True):
            surfaces.add_row(room.name, *_surface(part))
        surfaces.add_section()
        surfaces.add_row("all", *_surface(total))
        terminal.print(surfaces)
    probes = figure_table(
        "Probes: relative error of irradiance in %; seconds of computing; paths per point of the frames",
        ("mean", "noise", "bias", "log-L2", "RoomLight", "reference", "paths"),
    )
    for room in report.rooms:
        reference_s = room.frame.reference_s + room.panorama.reference_s + room.points_s
        own_s = room.solve_s + room.frame.ours_s + room.panorama.ours_s
        probes.add_row(room.name, *_probe(room.probe), f"{own_s:.1f}", f"{reference_s:.0f}", str(room.paths))
    probes.add_section()
    probes.add_row("all", *_probe(probe))
    terminal.print(probes)
    for message in report.left_out:
        terminal.print(f"left out: {message}", soft_wrap=True, markup=False)
    if diffuse is not None:
        mean = diffuse.pixels.mean
        terminal.print(
            f"frames, diffuse surfaces: {_percent(mean)} %, {_percent(diffuse.pixels.less_noise)} % without the "
            f"reference's noise, {_verdict(mean, DIFFUSE_TARGET)}",
            soft_wrap=True,
        )
        blocks = diffuse.blocks
        terminal.print(
            f"over blocks of 4 x 4 pixels: {_percent(blocks.mean)} %, {_percent(blocks.less_noise)} % without the "
            f"noise; rms {_percent(blocks.rms)} %",
            soft_wrap=True,
        )
    judged = CheckReport(report.judged(), ())
    known = judged.diffuse() if judged.rooms else None
    if known is not None and len(judged.rooms) < len(report.rooms):
        terminal.print(
            f"in the {len(judged.rooms)} rooms where the reference knows diffuse blocks to {_percent(JUDGED_NOISE)} %: "
            f"{_percent(known.blocks.mean)} %, {_percent(known.blocks.less_noise)} % without the noise; rms "
            f"{_percent(known.blocks.rms)} %; probes {_percent(judged.probe().irradiance)} %",
            soft_wrap=True,
        )
    terminal.print(
        f"probes, irradiance: {_percent(probe.irradiance)} %, {_verdict(probe.irradiance, PROBE_TARGET)}",
        soft_wrap=True,
    )


def compose_check(room: RoomCheck) -> UInt8[np.ndarray, "h w 3"]:
    """Return a picture, 8-bit sRGB, of frame and probe: RoomLight, the reference, the signed error."""
    width = 3 * (_TILE[0] + _MARGIN) + _MARGIN
    canvas = Canvas(width, 4 * LABEL_ROWS + _TILE[1] + _PROBE[1] + 3 * _MARGIN)
    lines = (
        (describe_room(room), HEADING),
        (
            "Error: red where RoomLight is brighter, blue where it is darker, full colour at "
            f"{100 * _SHOWN_ERROR:.0f} %; dimmed at edges and on surfaces that are neither diffuse nor coated",
            LABEL,
        ),
    )
    top = _MARGIN
    for line, grey in lines:
        canvas.text((_MARGIN, top), line, grey=grey, width=width - 2 * _MARGIN)
        top += LABEL_ROWS
    top += LABEL_ROWS // 2
    for k, title in enumerate(("RoomLight", "Reference (Mitsuba)", "Error")):
        canvas.text((_MARGIN + k * (_TILE[0] + _MARGIN), top), title)
    top += LABEL_ROWS
    judged = room.kinds.diffuse | room.kinds.coated
    gain = 0.6 / max(float(np.percentile(room.frame.reference, 90)), 1e-9)
    for view, size, judged_pixels in ((room.frame, _TILE, judged), (room.panorama, _PROBE, None)):
        error = _error_colours(view)
        if judged_pixels is not None:
            error = np.where(judged_pixels[..., None], error, 0.25 * error).astype(np.float32)
        pictures = (view.ours * np.float32(gain), view.reference * np.float32(gain), error)
        for k, picture in enumerate(pictures):
            canvas.picture((_MARGIN + k * (_TILE[0] + _MARGIN), top), picture, size=size, exposed=False)
        top += size[1] + _MARGIN
    return canvas.image


def _error_colours(view: View) -> Float[np.ndarray, "h w 3"]:
    """Return the signed error as linear RGB, white where both are equal.

    Both are averaged over 4 x 4 pixels first: the reference's picture is noisy.
    """
    ours, reference = (cv2.blur(image.mean(-1), (4, 4)) for image in (view.ours, view.reference))
    share = (ours - reference) / np.maximum(reference, 1e-3 * float(reference.mean()) + 1e-12) / _SHOWN_ERROR
    share = np.clip(share, -1, 1)
    red, blue = 1 - np.maximum(-share, 0), 1 - np.maximum(share, 0)
    return np.stack([red, 1 - np.abs(share), blue], -1).astype(np.float32)


def describe_room(room: RoomCheck) -> str:
    """Return the errors of a room as a line."""
    parts = [f"{room.name}, {room.about}:"]
    for name, part in (("diffuse", room.diffuse), ("coated", room.coated)):
        if part is not None:
            parts.append(
                f"{name} {_percent(part.pixels.mean)} % (noise {_percent(part.pixels.noise)}), "
                f"4x4 {_percent(part.blocks.mean)} % (noise {_percent(part.blocks.noise)}), bias {_signed(part.bias)};"
            )
    irradiance, noise, bias, _ = _probe(room.probe)
    parts.append(f"probe {irradiance} % (noise {noise}), bias {bias}")
    return " ".join(parts)


def _surface(part: SurfaceDeviation | None) -> tuple[str, ...]:
    if part is None:
        return ("-",) * 6
    figures = (part.pixels.mean, part.pixels.noise, part.blocks.mean, part.blocks.noise, part.blocks.rms)
    return (*(_percent(value) for value in figures), _signed(part.bias))


def _probe(probe: ProbeDeviation) -> tuple[str, str, str, str]:
    return _percent(probe.irradiance), _percent(probe.noise), _signed(probe.bias), f"{probe.log_l2:.4f}"


def _verdict(value: float, target: float) -> str:
    return f"{'under' if value < target else 'over'} the target of {_percent(target)} %"


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def _signed(value: float) -> str:
    return f"{100 * value:+.1f}"
