"""Choice of a room's windows: one design for all of them, with variation from window to window."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roomlight_generator.rooms.shell.holes import Cover, Window, WindowDesign
from roomlight_generator.rooms.shell.polygons import Rect
from roomlight_generator.rooms.shell.style import CoverKind, Range, ShellStyle, WindowKind, uniform


@dataclass(frozen=True)
class _Sizes:
    width: Range
    bottom: Range
    top: Range
    sash: Range
    """Width of one sash."""


_SIZES: Final[dict[WindowKind, _Sizes]] = {
    "casement": _Sizes((0.8, 2.4), (0.7, 1.0), (2.0, 2.55), (0.45, 0.8)),
    "sash": _Sizes((0.75, 1.3), (0.45, 0.85), (2.05, 2.7), (2.0, 2.0)),
    "picture": _Sizes((1.6, 4.5), (0.1, 0.7), (2.1, 3.0), (1.2, 3.5)),
    "french": _Sizes((1.2, 4.0), (0.02, 0.06), (2.05, 2.7), (0.6, 1.05)),
    "office": _Sizes((1.2, 2.4), (0.65, 1.0), (2.25, 3.4), (0.8, 1.8)),
    "bathroom": _Sizes((0.45, 0.95), (1.1, 1.5), (1.8, 2.2), (0.9, 0.9)),
}


_ORDINARY_HEIGHT_M: Final = 3.2
"""Height of a room up to which windows have the heights in `_SIZES`."""


@dataclass(frozen=True)
class WindowStyle:
    """One design of window and of covering. Widths and heights are for every window of the room."""

    kind: WindowKind
    design: WindowDesign
    cover: Cover
    width_m: float
    bottom_m: float
    top_m: float
    sash_m: float
    wall_m: float
    french_share: float
    covered_share: float
    rng: np.random.Generator

    @property
    def fills_wall_first(self) -> bool:
        """Whether the windows fill one wall before the next, as in offices."""
        return self.kind == "office"

    @property
    def pier_m(self) -> float:
        """Width of wall between two windows; half of it is left beside the last one."""
        if self.cover.curtains:
            return 2 * self.cover.spread_m + 0.08
        return 0.14 if self.fills_wall_first else 0.3

    def window(self, side: int, s0: float, s1: float) -> Window | None:
        """Make the window from s0 to s1; None if that is too narrow."""
        if s1 - s0 < 0.38:
            return None
        low = self.bottom_m
        if self.kind == "french" and self.rng.random() > self.french_share:
            low = max(low, 0.85)
        columns = max(1, round((s1 - s0) / self.sash_m))
        sill = min(self.design.sill_m, 0.025 if self.cover.curtains else 1.0) if low > 0.2 else 0.0
        design = replace(self.design, columns=columns, sill_m=sill)
        return Window(side, (s0, s1, low, self.top_m), self.wall_m, design, self._cover(low))

    def skylight(self, slope: int, hole: Rect, depth_m: float) -> Window:
        """Make a roof window: one sash, with a blind or nothing in front of it."""
        design = replace(
            self.design, kind="picture", columns=1, bars=(1, 1), inset=0.5, sill_m=0.0, frame_m=0.06, transom=0.0
        )
        cover = replace(self.cover, share=uniform(self.rng, (0.2, 0.7)))
        if cover.kind not in ("roller", "roller_down", "venetian"):
            cover = Cover("none")
        return Window(slope, hole, depth_m, design, cover, in_slope=True)

    def _cover(self, low: float) -> Cover:
        """Choose a window's covering: the same kind for every window, drawn to a random extent."""
        cover = self.cover
        if cover.full and self.rng.random() > self.covered_share:
            cover = replace(cover, kind="open_curtains" if cover.curtains else "roller")
        if cover.curtains and cover.bottom_m > 0.1:
            cover = replace(cover, bottom_m=max(low - 0.15, 0.02))
        if cover.kind in ("roller", "venetian") and self.rng.random() < 0.5:
            cover = replace(cover, share=uniform(self.rng, (0.15, 1.0)))
        if cover.kind == "roller":
            cover = replace(cover, share=min(cover.share, 0.8))
        return cover


def choose_window_style(
    style: ShellStyle, height_m: float, wall_m: float, area_m2: float, rng: np.random.Generator
) -> WindowStyle:
    """Choose the design for a room of this height and floor area: large rooms have wider windows."""
    kind = style.window_kinds[_weighted([weight for _, weight in style.window_kinds], rng)][0]
    covers = style.covers[_weighted([weight for _, weight in style.covers], rng)][0]
    cover = _cover(covers, kind, height_m, rng)
    sizes = _SIZES[kind]
    least = 0.13 + (cover.lift_m if cover.curtains else 0.0)
    # Windows of tall rooms are tall.
    top = min(uniform(rng, sizes.top) * max(1.0, height_m / _ORDINARY_HEIGHT_M), height_m - least)
    bottom = min(uniform(rng, sizes.bottom), top - 0.4)
    bars = (1, 1)
    if kind in ("casement", "sash", "french") and rng.random() < 0.45:
        bars = (int(rng.integers(2, 5 if kind == "french" else 4)), 1 if kind == "french" else int(rng.integers(1, 3)))
    design = WindowDesign(
        kind=kind,
        columns=1,
        bars=bars,
        frame_m=uniform(rng, (0.045, 0.08)),
        thickness_m=uniform(rng, (0.05, 0.08)),
        inset=uniform(rng, (0.35, 0.95)),
        sill_m=uniform(rng, (0.02, 0.12)) if rng.random() < 0.85 else 0.0,
        transom=uniform(rng, (0.22, 0.32)) if kind in ("casement", "office") and rng.random() < 0.3 else 0.0,
    )
    return WindowStyle(
        kind=kind,
        design=design,
        cover=cover,
        width_m=uniform(
            rng, (sizes.width[0] + min(area_m2 / 80, 0.5) * (sizes.width[1] - sizes.width[0]), sizes.width[1])
        ),
        bottom_m=bottom,
        top_m=top,
        sash_m=uniform(rng, sizes.sash),
        wall_m=wall_m,
        french_share=0.6 if rng.random() < 0.5 else 1.0,
        # In half of the rooms only some of the curtains are drawn.
        covered_share=1.0 if rng.random() < 0.5 else 0.5,
        rng=rng,
    )


def _weighted(weights: list[float], rng: np.random.Generator) -> int:
    share = np.array(weights, np.float64)
    return int(rng.choice(len(share), p=share / share.sum()))


def _cover(kind: CoverKind, window: WindowKind, height_m: float, rng: np.random.Generator) -> Cover:
    cover = Cover(kind)
    if cover.curtains:
        long = window == "french" or rng.random() < 0.7
        # The rod hangs at most half a metre above the window, and clear of the ceiling.
        lift = uniform(rng, (0.06, min(0.3, max(height_m - 2.15, 0.07))))
        return replace(
            cover,
            spread_m=uniform(rng, (0.14, 0.32)),
            lift_m=lift,
            bottom_m=uniform(rng, (0.01, 0.04)) if long else 0.5,
            share=uniform(rng, (0.25, 0.75)),
            pitch_m=uniform(rng, (0.09, 0.17)),
        )
    if kind in ("roller", "roller_down"):
        share = 1.0 if kind == "roller_down" else uniform(rng, (0.12, 0.8))
        return replace(cover, share=share, translucent=bool(kind == "roller_down" or rng.random() < 0.6))
    if kind == "venetian":
        share = uniform(rng, (0.5, 1.0)) if rng.random() < 0.6 else 1.0
        return replace(
            cover, share=share, tilt_degrees=uniform(rng, (-60.0, 60.0)), pitch_m=uniform(rng, (0.022, 0.05))
        )
    if kind == "vertical":
        return replace(cover, tilt_degrees=uniform(rng, (15.0, 80.0)), pitch_m=uniform(rng, (0.09, 0.13)))
    return cover
