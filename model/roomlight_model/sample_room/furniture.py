"""Pieces of furniture, each a list of meshes that stands on y = 0, is centred on the origin and faces +z.

Units: metres. `room` puts them in their places; `materials` says what their materials' names mean.
"""

from collections.abc import Sequence

import numpy as np

from roomlight_model.sample_room.shapes import Mesh, Number, box, cushion, lathe, moved, rectangle, rod, sheet
from roomlight_model.sample_room.textures import srgb

Tint = tuple[float, float, float]


def at(mesh: Mesh, x: Number, y: Number, z: Number) -> Mesh:
    """Short for `moved`, to keep tables of parts readable."""
    return mesh.moved(x, y, z)


def sofa(tint: Tint, accents: Sequence[tuple[str, Tint]], *, width: Number = 2.05, depth: Number = 0.92) -> list[Mesh]:
    """Two seats, two back cushions, arms, short legs, and scatter cushions in the accents (material, tint)."""
    arm = 0.17
    inner = width - 2 * arm
    parts = [at(box(width - 0.04, 0.2, depth - 0.06, radius=0.03), 0, 0.13, 0).of("cloth", tint)]
    parts += [at(box(width - 0.02, 0.62, 0.2, radius=0.07, arcs=3), 0, 0.16, -depth / 2 + 0.11).of("cloth", tint)]
    for side in (-1, 1):
        x = side * (width / 2 - arm / 2)
        parts.append(at(box(arm, 0.46, depth, radius=0.06, arcs=3), x, 0.13, 0).of("cloth", tint))
        for z in (-1, 1):
            foot = side * (width / 2 - 0.1), 0.0, z * (depth / 2 - 0.1)
            parts.append(rod(foot, (foot[0], 0.15, foot[2]), 0.014, 0.022).of("walnut"))
        seat = cushion(inner / 2 - 0.01, 0.17, depth - 0.22, plump=0.14, radius=0.06)
        parts.append(at(seat, side * inner / 4, 0.315, 0.10).of("cloth", tint))
        back = cushion(inner / 2 - 0.02, 0.2, 0.46, plump=0.35, radius=0.07).turned(90 - 14, "x")
        parts.append(at(back, side * inner / 4, 0.715, -depth / 2 + 0.14).of("cloth", tint))
    places = [(-0.66, 10.0), (-0.40, -14.0), (0.68, -8.0)]
    for (x, roll), (material, colour) in zip(places, accents, strict=False):
        pillow = cushion(0.43, 0.17, 0.43, plump=0.85, radius=0.06).turned(roll).turned(90 - 24, "x")
        parts.append(at(pillow, x * inner / 1.71, 0.69, -depth / 2 + 0.36).of(material, colour))
    return parts


def armchair(tint: Tint, pillow: tuple[str, Tint]) -> list[Mesh]:
    """A wooden frame with a seat and a back cushion."""
    width, depth = 0.72, 0.74
    parts: list[Mesh] = []
    for side in (-1, 1):
        x = side * width / 2
        parts.append(rod((x, 0, depth / 2 - 0.04), (x, 0.58, depth / 2 - 0.08), 0.016, 0.022).of("walnut"))
        parts.append(rod((x, 0, -depth / 2), (x, 0.60, -depth / 2 + 0.10), 0.016, 0.022).of("walnut"))
        rest = box(0.06, 0.03, depth - 0.06, radius=0.012).turned(-1.5, "x")
        parts.append(at(rest, x, 0.585, 0).of("walnut"))
        parts.append(rod((x, 0.27, depth / 2 - 0.05), (x, 0.24, -depth / 2 + 0.05), 0.016).of("walnut"))
    for z in (-0.27, 0.28):
        parts.append(rod((-width / 2, 0.265, z), (width / 2, 0.265, z), 0.016).of("walnut"))
    seat = cushion(width - 0.08, 0.16, depth - 0.08, plump=0.14, radius=0.06).turned(4, "x")
    parts.append(at(seat, 0, 0.29, 0.02).of("cloth", tint))
    back = cushion(width - 0.10, 0.16, 0.56, plump=0.2, radius=0.06).turned(90 - 16, "x")
    parts.append(at(back, 0, 0.66, -depth / 2 + 0.08).of("cloth", tint))
    for x in (-0.2, 0.2):
        parts.append(rod((x, 0.27, -0.27), (x, 0.93, -0.47), 0.014).of("walnut"))
    small = cushion(0.38, 0.14, 0.30, plump=0.8, radius=0.05).turned(90 - 22, "x")
    parts.append(at(small, 0.02, 0.555, -0.13).of(*pillow))
    return parts


def coffee_table(rng: np.random.Generator) -> list[Mesh]:
    """Oak top on splayed legs; books, a bowl of oranges and a vase on it."""
    top = 0.42
    parts = [at(box(1.1, 0.035, 0.58, radius=0.014, step=0.06, arcs=3), 0, top - 0.035, 0).of("table")]
    parts.append(at(box(0.92, 0.018, 0.42, radius=0.007), 0, 0.17, 0).of("table"))
    for x in (-1, 1):
        for z in (-1, 1):
            foot, head = (x * 0.49, 0.0, z * 0.24), (x * 0.43, top - 0.03, z * 0.2)
            parts.append(rod(foot, head, 0.014, 0.021).of("table"))
    height = top
    for tint, size, turn in (
        (srgb(196, 84, 56), (0.29, 0.028, 0.21), 12.0),
        (srgb(240, 232, 214), (0.26, 0.022, 0.19), 4.0),
        (srgb(46, 82, 96), (0.21, 0.025, 0.15), 21.0),
    ):
        parts += [at(mesh.turned(turn), -0.30, height, 0.06) for mesh in flat_book(tint, size)]
        height += size[1]
    bowl_line = [(0.05, 0.0), (0.085, 0.02), (0.125, 0.06), (0.14, 0.085)]
    inside = [(0.132, 0.085), (0.117, 0.06), (0.08, 0.026), (0.002, 0.018)]
    bowl = lathe([[(0.001, 0.0), (0.05, 0.0)], bowl_line, [(0.14, 0.085), (0.132, 0.085)], inside], segments=40)
    parts.append(at(bowl, 0.30, top, 0.05).of("ceramic", srgb(70, 112, 120)))
    ball = lathe(
        [
            [
                (0.001, -0.036),
                (0.018, -0.031),
                (0.031, -0.018),
                (0.036, 0.0),
                (0.031, 0.018),
                (0.018, 0.031),
                (0.001, 0.034),
            ]
        ]
    )
    for x, y, z in ((0.26, 0.072, 0.05), (0.33, 0.074, 0.02), (0.315, 0.072, 0.095), (0.298, 0.125, 0.052)):
        parts.append(at(ball, x, top + y, z).of("ceramic", srgb(236, 138, 40)))
    parts += moved(vase(0.2, srgb(238, 232, 220)), 0.02, top, -0.12)
    for _ in range(9):
        lean = rng.uniform(-1, 1, 2) * 0.12
        tip = (0.02 + lean[0], top + 0.2 + rng.uniform(0.16, 0.3), -0.12 + lean[1])
        parts.append(rod((0.02, top + 0.17, -0.12), tip, 0.0022, 0.0016, segments=6).of("paint", srgb(150, 120, 80)))
        plume = lathe([[(0.001, -0.05), (0.012, -0.03), (0.016, 0.0), (0.010, 0.035), (0.001, 0.06)]], segments=12)
        parts.append(at(plume.turned(float(lean[0]) * -150, "z"), *tip).of("paint", srgb(226, 196, 150)))
    return parts


def flat_book(tint: Tint, size: tuple[float, float, float]) -> list[Mesh]:
    """A closed book lying down: covers and a block of pages."""
    width, height, depth = size
    cover = 0.003
    return [
        box(width, cover, depth, radius=0.001).of("paint", tint),
        at(box(width, cover, depth, radius=0.001), 0, height - cover, 0).of("paint", tint),
        at(box(width - 0.01, height - 2 * cover, depth - 0.012, radius=0.001), -0.003, cover, 0).of("paper"),
        at(box(0.004, height, depth, radius=0.0015), -width / 2 + 0.001, 0, 0).of("paint", tint),
    ]


def vase(height: Number, tint: Tint, *, belly: Number = 0.42) -> list[Mesh]:
    """A round-bellied vase."""
    t = np.linspace(0, 1, 22)
    radius = height * (0.16 + belly * 0.62 * np.sin(np.pi * np.clip(t * 1.1, 0, 1)) ** 1.3 * (1 - 0.35 * t))
    outside = [(float(r), float(height * y)) for r, y in zip(radius, t, strict=True)]
    rim = outside[-1][0]
    inside = [(rim - 0.006, height), (rim - 0.008, height * 0.8), (0.001, height * 0.75)]
    lines = [[(0.001, 0.0), outside[0]], outside, [(rim, height), (rim - 0.006, height)], inside]
    return [lathe(lines, segments=40).of("ceramic", tint)]


def bookshelf(rng: np.random.Generator, *, width: Number = 1.15, height: Number = 2.05, shelves: int = 5) -> list[Mesh]:
    """An open walnut bookcase, filled with books and a few pots."""
    depth, board = 0.3, 0.028
    parts = [
        at(box(board, height, depth, radius=0.003), side * (width - board) / 2, 0, 0).of("walnut") for side in (-1, 1)
    ]
    parts.append(at(box(width - 0.01, height - 0.02, 0.012, radius=0.002), 0, 0.01, -depth / 2 + 0.008).of("walnut"))
    gap = (height - 0.08 - board) / shelves
    covers = [
        srgb(*c)
        for c in (
            (178, 62, 46), (214, 148, 58), (44, 84, 102), (232, 222, 202), (86, 112, 84), (52, 52, 64),
            (160, 108, 76), (116, 46, 58), (110, 150, 160), (226, 186, 130), (60, 96, 146), (200, 196, 188),
        )
    ]  # fmt: skip
    for shelf in range(shelves + 1):
        y = 0.06 + gap * shelf
        parts.append(at(box(width - board, board, depth - 0.004, radius=0.003), 0, y, 0.0).of("walnut"))
        if shelf == shelves:
            break
        floor = y + board
        x, end = -width / 2 + board + 0.012, width / 2 - board - 0.02
        stop_early = end - (0.0, 0.3, 0.12, 0.34, 0.2)[shelf % 5]
        while x < stop_early:
            thick = float(rng.uniform(0.018, 0.046))
            tall = float(rng.uniform(0.55, 0.84) * (gap - board))
            deep = float(rng.uniform(0.16, 0.22))
            tint = covers[int(rng.integers(len(covers)))]
            leaning = rng.random() < 0.06
            book = box(thick, tall, deep, radius=0.003, step=0.12)
            band = at(
                box(thick * 1.01, tall * 0.09, deep * 1.004, radius=0.003), 0, tall * float(rng.uniform(0.6, 0.8)), 0
            )
            stamp = covers[int(rng.integers(len(covers)))] if rng.random() < 0.6 else tint
            for mesh, colour in ((book, tint), (band, stamp)):
                turned = mesh.turned(-7, "z") if leaning else mesh
                shift = 0.06 * tall if leaning else 0.0
                parts.append(
                    at(turned, x + thick / 2 + shift * 0.3, floor, depth / 2 - 0.03 - deep / 2).of("paint", colour)
                )
            x += thick + (0.13 * tall + 0.012 if leaning else 0.0015)
        spot = (stop_early + end) / 2 + 0.03
        if shelf == 1:
            parts += moved(vase(0.2, srgb(206, 142, 74)), spot, floor, 0.02)
        elif shelf == 3:
            parts += moved(vase(0.15, srgb(96, 140, 140), belly=0.5), spot - 0.06, floor, 0.0)
            parts += moved(vase(0.24, srgb(236, 228, 214), belly=0.22), spot + 0.08, floor, -0.02)
        elif shelf == 4:
            for step, tint in enumerate((covers[2], covers[3], covers[0])):
                parts += moved(
                    flat_book(tint, (0.19, 0.03, 0.16)), spot - 0.01, floor + 0.03 * step, 0, degrees=8.0 * step
                )
    return parts


def cabinet(*, width: Number = 1.5, height: Number = 0.5, depth: Number = 0.42, doors: int = 3) -> list[Mesh]:
    """A low sideboard: oak carcass on rods, painted doors with round knobs."""
    leg = 0.13
    body = height - leg
    parts = [at(box(width, body, depth - 0.02, radius=0.006), 0, leg, -0.01).of("oak")]
    each = (width - 0.05) / doors
    for door in range(doors):
        x = -width / 2 + 0.025 + each * (door + 0.5)
        panel = box(each - 0.008, body - 0.05, 0.02, radius=0.005)
        parts.append(at(panel, x, leg + 0.025, depth / 2 - 0.012).of("paint", srgb(226, 221, 208)))
        knob = rod(
            (x + each * 0.36, leg + body / 2, depth / 2 - 0.004),
            (x + each * 0.36, leg + body / 2, depth / 2 + 0.022),
            0.012,
        )
        parts.append(knob.of("brass"))
    for x in (-1, 1):
        for z in (-1, 1):
            foot = (x * (width / 2 - 0.1), 0.0, z * (depth / 2 - 0.07))
            parts.append(rod(foot, (foot[0] * 0.98, leg + 0.01, foot[2]), 0.013, 0.02).of("walnut"))
    return parts


def television(*, width: Number = 1.02) -> list[Mesh]:
    """A lit screen on a foot; the picture has 16 : 9."""
    height = width * 9 / 16
    parts = [at(box(width + 0.024, height + 0.03, 0.035, radius=0.006), 0, 0.07, 0).of("black")]
    face = rectangle((-width / 2, 0.087, 0.0185), (width, 0, 0), (0, height, 0), step=0.12, unit_uv=True)
    parts.append(face.of("screen"))
    parts.append(at(box(0.34, 0.012, 0.2, radius=0.005), 0, 0, 0).of("black"))
    parts.append(rod((0, 0.01, -0.01), (0, 0.09, -0.01), 0.022).of("black"))
    return parts


def floor_lamp(*, radius: Number, height: Number, bottom: Number) -> list[Mesh]:
    """A brass stand under a cloth shade (a cylinder) whose side and open ends shine."""
    disc = [(1e-4, 0.0), (radius * 0.5, 0.0), (radius, 0.0)]
    lid = [(radius, 0.0), (radius * 0.5, 0.0), (1e-4, 0.0)]
    side = [(radius, t * height) for t in np.linspace(0, 1, 5)]
    base = lathe(
        [
            [(1e-4, 0.0), (0.14, 0.0)],
            [(0.14, 0.0), (0.142, 0.012), (0.13, 0.022)],
            [(0.13, 0.022), (0.02, 0.03), (1e-4, 0.03)],
        ]
    )
    return [
        base.of("brass"),
        rod((0, 0.02, 0), (0, bottom, 0), 0.011).of("brass"),
        at(lathe([disc], segments=64), 0, bottom, 0).of("shade-end"),
        at(lathe([side], segments=64), 0, bottom, 0).of("shade-side"),
        at(lathe([lid], segments=64), 0, bottom + height, 0).of("shade-end"),
    ]


def plant(rng: np.random.Generator, *, height: Number = 1.35) -> list[Mesh]:
    """Long arching leaves out of a glazed pot."""
    outside = [(0.13, 0.0), (0.15, 0.08), (0.165, 0.2), (0.17, 0.3)]
    lines = [[(1e-4, 0.0), (0.13, 0.0)], outside, [(0.17, 0.3), (0.155, 0.3)], [(0.155, 0.3), (0.153, 0.265)]]
    parts = [lathe(lines, segments=40).of("ceramic", srgb(224, 214, 196))]
    parts.append(at(lathe([[(0.155, 0.0), (0.08, 0.008), (1e-4, 0.012)]]), 0, 0.265, 0).of("paint", srgb(62, 46, 36)))
    for leaf in range(26):
        azimuth = 2.399963 * leaf + float(rng.uniform(-0.25, 0.25))
        inner = leaf / 26
        reach = 0.20 + 0.30 * inner + float(rng.uniform(-0.04, 0.04))
        rise = (height - 0.3) * (1.0 - 0.62 * inner) * float(rng.uniform(0.88, 1.05))
        drop = 0.10 + 0.35 * inner
        t = np.linspace(0, 1, 15)
        along = reach * t**1.5
        up = 0.27 + rise * np.sin(np.pi / 2 * np.minimum(t * 1.15, 1.0)) - drop * np.clip(t - 0.55, 0, 1) ** 1.6
        wide = 0.052 * np.clip((t - 0.18) / 0.82, 0, 1) ** 0.55 * np.clip(1.04 - t, 0, 1) ** 0.6 * 1.55 + 0.004
        across = np.linspace(-1, 1, 5)
        points = np.empty((15, 5, 3))
        outward = np.array([np.cos(azimuth), 0, np.sin(azimuth)])
        sideways = np.array([-np.sin(azimuth), 0, np.cos(azimuth)])
        fold = -0.35 * np.abs(across)  # a leaf is folded along its rib
        for row in range(15):
            rib = outward * along[row] + np.array([0, up[row], 0])
            points[row] = rib + wide[row] * (across[:, None] * sideways - fold[:, None] * np.array([0.0, 0.6, 0.0]))
        green = srgb(*(np.array([66, 112, 58]) * rng.uniform(0.8, 1.25)).tolist())
        parts.append(sheet(points.astype(np.float32), thickness=0.003).of("leaf", green))
    return parts


def curtain(rng: np.random.Generator, *, width: Number, height: Number, folds: int = 7) -> list[Mesh]:
    """Hanging folds: from y = 0.03 up to `height`, pleated along x."""
    x = np.linspace(-width / 2, width / 2, folds * 12 + 1)
    phase = np.cumsum(rng.uniform(0.75, 1.25, len(x))) / 12 * 2 * np.pi
    y = np.linspace(0.03, height, 26)
    points = np.empty((len(y), len(x), 3), np.float32)
    for row, level in enumerate(y):
        loose = 1 - level / height
        points[row, :, 0] = x * (1 - 0.06 * np.sin(np.pi * loose)) + 0.012 * loose * np.sin(phase * 0.5)
        points[row, :, 1] = level
        points[row, :, 2] = (0.032 + 0.018 * loose) * np.sin(phase + 0.5 * loose)
    return [sheet(points, thickness=0.006).of("linen")]


def picture(material: str, *, width: Number, height: Number, frame: str = "walnut") -> list[Mesh]:
    """A framed print that hangs at z = 0; the origin is its middle."""
    bar = 0.022
    parts = [
        at(box(width + 2 * bar, bar, 0.026, radius=0.003), 0, side * (height + bar) / 2 - bar / 2, 0.013).of(frame)
        for side in (-1, 1)
    ]
    parts += [
        at(box(bar, height, 0.026, radius=0.003), side * (width + bar) / 2, -height / 2, 0.013).of(frame)
        for side in (-1, 1)
    ]
    face = rectangle((-width / 2, -height / 2, 0.012), (width, 0, 0), (0, height, 0), step=0.12, unit_uv=True)
    return [*parts, face.of(material)]


def door(*, width: Number = 0.86, height: Number = 2.05) -> list[Mesh]:
    """A panelled door in its frame, closed, standing proud of the wall at z = 0."""
    white = srgb(232, 228, 218)
    parts = [at(box(width, height, 0.03, radius=0.004), 0, 0, 0.015).of("paint", white)]
    for side in (-1, 1):
        parts.append(
            at(box(0.075, height + 0.075, 0.045, radius=0.006), side * (width / 2 + 0.03), 0, 0.022).of("paint", white)
        )
    parts.append(at(box(width + 0.21, 0.085, 0.05, radius=0.006), 0, height, 0.024).of("paint", white))
    for low, high in ((0.14, 0.86), (1.0, height - 0.14)):
        for side in (-1, 1):
            panel = box(width / 2 - 0.13, high - low, 0.02, radius=0.009, arcs=3)
            parts.append(at(panel, side * (width / 4 - 0.015), low, 0.03).of("paint", white))
    parts.append(rod((width / 2 - 0.07, 0.98, 0.02), (width / 2 - 0.07, 0.98, 0.075), 0.009).of("brass"))
    parts.append(rod((width / 2 - 0.06, 0.98, 0.07), (width / 2 - 0.19, 0.98, 0.07), 0.008).of("brass"))
    return parts
