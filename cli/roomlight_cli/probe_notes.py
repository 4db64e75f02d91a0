"""Words that commands print: numbers, and notes beside a probe whose light is mostly a guess."""

from typing import Final

from roomlight.conventions import Position

LITTLE_SEEN: Final = 0.05
"""Coverage below which a probe gets a warning. The sample room's first frame gives its probes 0.29 to 0.58."""


def position_text(position: Position) -> str:
    """Format a position as (x, y, z) m, with centimetres."""
    x, y, z = position
    return f"({x:.2f}, {y:.2f}, {z:.2f}) m"


def percent(share: float) -> str:
    """Format a share, 0 to 1, as whole percent."""
    return f"{100 * share:.0f} %"


def probe_warnings(coverage: float, *, inside_volume: bool = True, behind_camera: bool = False) -> list[str]:
    """Return what the user of a probe's light should know; empty for a probe that was seen well.

    Args:
        coverage: Share of the sphere of directions around the probe that was observed, 0 to 1.
        inside_volume: Whether the probe lies in the lighting volume.
        behind_camera: Whether it lies behind the only camera there is.
    """
    warnings: list[str] = []
    if not inside_volume:
        warnings.append("outside the lighting volume: distant light only")
    place = "this point is behind the camera: " if behind_camera else ""
    if coverage < LITTLE_SEEN:
        around = "it" if behind_camera else "this point"
        warnings.append(
            f"{place}only {percent(coverage)} of the light around {around} was seen; most of it is inferred"
        )
    elif behind_camera:
        warnings.append(f"{place}the photograph shows little of what is near it")
    return warnings
