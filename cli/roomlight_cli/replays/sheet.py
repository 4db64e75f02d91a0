"""The summary picture of a replay: frames over time, and the light at each probe beside the truth.

On top is a frame with mirror spheres at the probes, and frames over time. Each probe has the last panorama, the ground
truth beside it if there is one, panoramas with spheres over time, and plots. Spheres are seen from the same direction
at all times, so that changes in them are changes of the light. Tone mapping is that of `roomlight.imaging.drawing`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, UInt8

from roomlight.conventions import LUMINANCE, panorama_solid_angles
from roomlight.imaging.drawing import BACKGROUND, HEADING, LABEL_ROWS, Canvas, Colour, text_width
from roomlight.imaging.plots import Plot, Series, draw_plot
from roomlight.spheres import SphereRenderer
from roomlight_cli.probe_notes import percent

COLUMNS: Final = 6
"""Times shown: enough to see a room filling up, few enough to see details of each panorama."""
WIDE_PROBES: Final = 3
"""With more probes the panoramas are smaller, so that the page stays one that a viewer opens at once."""
PANORAMA_COLUMNS: Final = (960, 720)
"""Width of a probe's panorama: with few probes, and with many."""

_MARGIN: Final = 64
_GUTTER: Final = 48
_GAP: Final = 12
_TITLE_SIZE: Final = 40
_HEADER_ROWS: Final = 112
_SECTION_SIZE: Final = 22
_SECTION_ROWS: Final = 44
_SECTION_GAP: Final = 72
_BADGE: Final = 14.0
_TINT: Final = (0.10, 0.14, 0.34)
_TINT_SHARE: Final = 0.72
"""A dark blue: inferred directions step back, and no room's own colour is mistaken for it."""
_TRUTH: Final = 0.95
_RULE: Final = 0.24
_PROBE_COLOURS: Final = (
    (1.0, 0.72, 0.30),
    (0.36, 0.80, 0.98),
    (0.97, 0.47, 0.66),
    (0.62, 0.86, 0.42),
    (0.78, 0.62, 1.0),
    (1.0, 0.55, 0.38),
)
"""Colours of the probes' badges and lines, which begin again after the last."""


@dataclass(frozen=True)
class SheetTime:
    """One time of the sheet.

    Attributes:
        label: The time's title.
        frame: The camera's picture, linear RGB.
        panoramas: Each probe's panorama.
        observed: How far each direction of a panorama was seen, 0 to 1; None where that is unknown.
    """

    label: str
    frame: Float[np.ndarray, "h w 3"]
    panoramas: tuple[Float[np.ndarray, "..."], ...]
    observed: tuple[Float[np.ndarray, "..."] | None, ...] = ()


@dataclass(frozen=True)
class SheetProbe:
    """One probe of the sheet.

    Attributes:
        label: The probe's title.
        view: World direction along which its spheres are seen (`spheres.view_toward`).
        truth: Its measured panorama; None without one.
        light: The panorama's mean luminance at each of the sheet's `indices`.
        coverage: The share of the sphere seen at each of them, 0 to 1.
    """

    label: str
    view: tuple[float, float, float]
    truth: Float[np.ndarray, "h w 3"] | None = None
    light: tuple[float, ...] = ()
    coverage: tuple[float, ...] = ()


@dataclass(frozen=True)
class InsertedObjects:
    """A frame with an object at each probe.

    Attributes:
        image: The composited frame, 8-bit sRGB.
        label: Its title.
        marks: Where the probes' badges go, as shares of width and height; None for a probe out of view.
    """

    image: UInt8[np.ndarray, "h w 3"]
    label: str
    marks: tuple[tuple[float, float] | None, ...] = ()


@dataclass(frozen=True)
class Sheet:
    """What a summary picture shows.

    Attributes:
        title: The page's title.
        subtitle: A line below it.
        times: The times, in order; at least one.
        probes: The probes.
        indices: Frame indices of the probes' `light` and `coverage`.
        inserted: A frame with objects; None: the last frame is shown as it is.
    """

    title: str
    subtitle: str
    times: Sequence[SheetTime]
    probes: Sequence[SheetProbe]
    indices: Sequence[int] = ()
    inserted: InsertedObjects | None = None


def sheet_times(frames: int) -> list[int]:
    """Return the numbers (from 0) of the frames to show: evenly spread, with the first and the last."""
    if frames <= 0:
        return []
    return sorted({round(position) for position in np.linspace(0, frames - 1, min(COLUMNS, frames)).tolist()})


def compose_sheet(sheet: Sheet) -> UInt8[np.ndarray, "h w 3"]:
    """Return the summary as 8-bit sRGB.

    Raises:
        ValueError: There is no time, or a time's panoramas are not one for each probe.
    """
    if not sheet.times:
        raise ValueError("a summary needs at least one time")
    for time in sheet.times:
        if len(time.panoramas) != len(sheet.probes):
            raise ValueError(f"time {time.label!r} has {len(time.panoramas)} panoramas, not {len(sheet.probes)}")
    return _Page(sheet).draw()


class _Page:
    """The layout: two columns as wide as a panorama, a section for the frames and one for each probe."""

    def __init__(self, sheet: Sheet) -> None:
        self._sheet = sheet
        self._wide = PANORAMA_COLUMNS[len(sheet.probes) > WIDE_PROBES]
        self._left, self._right = _MARGIN, _MARGIN + self._wide + _GUTTER
        self._tile = (self._wide - (COLUMNS - 1) * _GAP) // COLUMNS
        self._small_sphere = (self._tile - 6) // 2
        self._sphere = self._wide // 10
        hero = sheet.times[-1].frame if sheet.inserted is None else sheet.inserted.image
        self._hero_size = _fit(hero.shape, self._wide, self._wide * 3 // 4)
        rows = -(-len(sheet.times) // 3)
        self._frame_size = _fit(sheet.times[0].frame.shape, (self._wide - 2 * _GAP) // 3, self._wide // 4)
        frames_rows = rows * (LABEL_ROWS + self._frame_size[1] + _GAP) + self._legend_rows()
        self._top_rows = max(LABEL_ROWS + self._hero_size[1], frames_rows)
        self._strip_rows = LABEL_ROWS + self._tile // 2 + _GAP + self._small_sphere
        self._detail_rows = max(self._strip_rows, LABEL_ROWS + self._sphere + 40)
        self._probe_rows = _SECTION_GAP + _SECTION_ROWS + LABEL_ROWS + self._wide // 2 + 2 * _GAP + self._detail_rows
        height = _MARGIN + _HEADER_ROWS + self._top_rows + len(sheet.probes) * self._probe_rows + _MARGIN
        self._canvas = Canvas(self._right + self._wide + _MARGIN, height)

    def draw(self) -> UInt8[np.ndarray, "h w 3"]:
        """Draw everything and return the picture."""
        whole = self._right + self._wide - self._left
        self._canvas.text(
            (self._left, _MARGIN), self._sheet.title, size=_TITLE_SIZE, grey=HEADING, width=whole, weight="semibold"
        )
        self._canvas.text((self._left, _MARGIN + 54), self._sheet.subtitle, size=18, width=whole)
        top = _MARGIN + _HEADER_ROWS
        self._draw_hero(top)
        self._draw_frames(top)
        top += self._top_rows
        for number in range(len(self._sheet.probes)):
            self._draw_probe(number, top)
            top += self._probe_rows
        return self._canvas.image

    def _draw_hero(self, top: int) -> None:
        inserted, at = self._sheet.inserted, (self._left, top + LABEL_ROWS)
        if inserted is None:
            self._canvas.text((self._left, top), self._sheet.times[-1].label, width=self._wide)
            self._canvas.picture(at, self._sheet.times[-1].frame, size=self._hero_size)
            return
        self._canvas.text((self._left, top), inserted.label, width=self._wide)
        self._canvas.encoded(at, inserted.image, size=self._hero_size)
        for number, mark in enumerate(inserted.marks):
            if mark is not None:
                x, y = at[0] + mark[0] * self._hero_size[0], at[1] + mark[1] * self._hero_size[1]
                edge = _BADGE + 4.0
                x = min(max(x, at[0] + edge), at[0] + self._hero_size[0] - edge)
                y = min(max(y, at[1] + edge), at[1] + self._hero_size[1] - edge)
                self._badge((x, y), number)

    def _draw_frames(self, top: int) -> None:
        width, height = self._frame_size
        for number, time in enumerate(self._sheet.times):
            left = self._right + number % 3 * ((self._wide - 2 * _GAP) // 3 + _GAP)
            row = top + number // 3 * (LABEL_ROWS + height + _GAP)
            self._canvas.text((left, row), time.label, width=width)
            self._canvas.picture((left, row + LABEL_ROWS), time.frame, size=(width, height))
        rows = -(-len(self._sheet.times) // 3)
        self._draw_legend(top + max(rows * (LABEL_ROWS + height + _GAP), self._top_rows - self._legend_rows()))

    def _legend_rows(self) -> int:
        return 16 + 28 * len(self._legend())

    def _legend(self) -> list[tuple[str, str]]:
        """Return kinds of swatches with their meaning; only of what the page shows."""
        lines = [
            ("plain", "Estimated panorama, 360\u00b0 x 180\u00b0, in the first frame's exposure; clipped at white")
        ]
        if any(part is not None for time in self._sheet.times for part in time.observed):
            lines.append(("tint", "Not seen by any frame so far: inferred"))
        if any(probe.truth is not None for probe in self._sheet.probes):
            lines.append(("dash", "Ground truth"))
        return lines

    def _draw_legend(self, top: int) -> None:
        row = top + 16
        for kind, text in self._legend():
            if kind == "dash":
                middle = row + 9.0
                for start in (self._right, self._right + 15.0):
                    self._canvas.line([(float(start), middle), (start + 11.0, middle)], _TRUTH, width=2)
            else:
                self._canvas.box((self._right, row + 2), (26, 14), 0.5)
                if kind == "tint":
                    self._canvas.box((self._right, row + 2), (26, 14), _TINT, opacity=_TINT_SHARE)
            self._canvas.text((self._right + 40, row - 1), text, size=16, width=self._wide - 40)
            row += 28

    def _badge(self, centre: tuple[float, float], number: int) -> None:
        x, y = centre
        self._canvas.disc(centre, _BADGE + 2, BACKGROUND)
        self._canvas.disc(centre, _BADGE, _colour_of(number))
        text = str(number)
        left = round(x - text_width(text, size=16, weight="semibold") / 2)
        self._canvas.text((left, round(y) - 10), text, size=16, grey=BACKGROUND, weight="semibold")

    def _draw_probe(self, number: int, top: int) -> None:
        probe, last = self._sheet.probes[number], self._sheet.times[-1]
        canvas, whole = self._canvas, self._right + self._wide - self._left
        canvas.box((self._left, top + _SECTION_GAP // 2), (whole, 1), _RULE)
        row = top + _SECTION_GAP
        self._badge((float(self._left + _BADGE), row + 13.0), number)
        canvas.text((self._left + 42, row), probe.label, size=_SECTION_SIZE, grey=HEADING, weight="semibold")
        if probe.coverage:
            text = f"{percent(probe.coverage[-1])} of the sphere seen"
            canvas.text((self._right + self._wide - text_width(text, size=18), row + 3), text, size=18)
        row += _SECTION_ROWS
        size = (self._wide, self._wide // 2)
        canvas.text((self._left, row), f"Estimated, {last.label[:1].lower()}{last.label[1:]}", width=self._wide)
        canvas.picture((self._left, row + LABEL_ROWS), last.panoramas[number], size=size)
        canvas.text((self._right, row), "Ground truth" if probe.truth is not None else "Seen by the camera")
        panorama = last.panoramas[number] if probe.truth is None else probe.truth
        canvas.picture((self._right, row + LABEL_ROWS), panorama, size=size)
        if probe.truth is None:
            self._tint((self._right, row + LABEL_ROWS), size, _observed(last, number))
        row += LABEL_ROWS + size[1] + 2 * _GAP
        # a renderer's tables take 40 MB: one at a time, however many probes there are
        self._draw_strip(row, number, SphereRenderer(probe.view, size=self._small_sphere))
        self._draw_detail(row, number, SphereRenderer(probe.view, size=self._sphere))

    def _draw_strip(self, top: int, number: int, spheres: SphereRenderer) -> None:
        """Draw the panoramas over time, tinted where nothing was seen yet, with a mirror and a glossy sphere."""
        size = (self._tile, self._tile // 2)
        for column, time in enumerate(self._sheet.times):
            left, row = self._left + column * (self._tile + _GAP), top + LABEL_ROWS
            self._canvas.text((left, top), time.label, width=self._tile)
            self._canvas.picture((left, row), time.panoramas[number], size=size)
            self._tint((left, row), size, _observed(time, number))
            row += size[1] + _GAP
            for side, material in enumerate(("mirror", "glossy")):
                self._canvas.sphere(
                    (left + side * (self._small_sphere + 6), row), time.panoramas[number], spheres, material
                )

    def _draw_detail(self, top: int, number: int, spheres: SphereRenderer) -> None:
        """Draw the plots, and the spheres of the last time beside those of the truth."""
        probe = self._sheet.probes[number]
        lit = [("Estimated", self._sheet.times[-1].panoramas[number])]
        lit += [] if probe.truth is None else [("Ground truth", probe.truth)]
        pair = 2 * self._sphere + 8
        plots = self._wide - len(lit) * (pair + 24)
        left = self._right + plots + 24
        for title, panorama in lit:
            self._canvas.text((left, top), title, grey=HEADING, weight="semibold", width=pair)
            for side, material in enumerate(("mirror", "glossy")):
                at = (left + side * (self._sphere + 8), top + LABEL_ROWS + 12)
                self._canvas.sphere(at, panorama, spheres, material)
                self._canvas.text((at[0], at[1] + self._sphere + 6), material, size=12, width=self._sphere)
            left += pair + 24
        if self._sheet.indices and probe.light and probe.coverage:
            self._draw_plots((self._right, top), ((plots - 24) // 2, self._detail_rows), number)

    def _draw_plots(self, at: tuple[int, int], size: tuple[int, int], number: int) -> None:
        probe, colour = self._sheet.probes[number], _colour_of(number)
        light = [Series(probe.light, colour)]
        if probe.truth is not None:
            light.insert(0, Series((mean_light(probe.truth),), _TRUTH, dashed=True))
        draw_plot(self._canvas, at, size, Plot("Mean light, 1 is white", self._sheet.indices, light))
        seen = Plot("Sphere seen", self._sheet.indices, [Series(probe.coverage, colour, filled=True)], 1.0, True)
        draw_plot(self._canvas, (at[0] + size[0] + 24, at[1]), size, seen)

    def _tint(self, at: tuple[int, int], size: tuple[int, int], observed: Float[np.ndarray, "h w"] | None) -> None:
        if observed is not None:
            self._canvas.tint(at, _TINT_SHARE * (1 - observed), _TINT, size=size)


def mean_light(panorama: Float[np.ndarray, "h w 3"]) -> float:
    """Return the mean luminance over the sphere, in the panorama's units."""
    share = panorama_solid_angles(len(panorama)) / (4 * np.pi)
    return float(((panorama @ LUMINANCE) * share).sum(dtype=np.float64))


def _observed(time: SheetTime, number: int) -> Float[np.ndarray, "h w"] | None:
    return time.observed[number] if time.observed else None


def _colour_of(number: int) -> Colour:
    return _PROBE_COLOURS[number % len(_PROBE_COLOURS)]


def _fit(shape: tuple[int, ...], width: int, height: int) -> tuple[int, int]:
    """Return the largest (columns, rows) of a picture of this shape within width and height."""
    scale = min(width / shape[1], height / shape[0])
    return max(1, round(shape[1] * scale)), max(1, round(shape[0] * scale))
