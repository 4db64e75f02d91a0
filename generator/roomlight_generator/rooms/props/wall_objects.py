"""Wall objects: pictures, mirrors, clocks, shelves, whiteboards, air conditioners, and wall clutter.

Backs are at -depth/2, against the wall.
"""

from functools import partial

import numpy as np

from roomlight_generator.rooms.props import palette, textures
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.pictures import clock_texture, print_texture, rug_texture
from roomlight_generator.rooms.props.small_objects import solid_of_revolution, vessel
from roomlight_generator.rooms.props.storage import fill_shelf
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, double_sided_sheet, lathe, loft, rectangle, tube


def add_framed_face(
    parts: Parts, frame: Material, face: Material, width: Number, height: Number, depth: Number, bar: Number
) -> None:
    """Add a flat face in a frame of four bars, from y = 0."""
    for x in (-1, 1):
        parts.slab(frame, (bar, height, depth), (x * (width - bar) / 2, 0, 0), radius=min(0.004, bar / 4))
    for y in (0.0, height - bar):
        parts.slab(frame, (width - 2 * bar, bar, depth), (0, y, 0), radius=0)
    parts.slab(frame, (width - bar, height - bar, depth * 0.3), (0, bar / 2, -depth * 0.35), radius=0)
    inner = (width - 2 * bar, height - 2 * bar)
    shape = rectangle((-inner[0] / 2, bar, depth * 0.1), (inner[0], 0, 0), (0, inner[1], 0), step=9, unit_uv=True)
    parts.add(shape, face)


def picture(rng: np.random.Generator) -> Draft:
    """Make a framed print, an unframed canvas, or two to four small frames together."""
    aspect = float(rng.choice([0.7, 0.75, 1.0, 1.35, 1.5, 2.2])) * uniform(rng, 0.95, 1.05)
    long = uniform(rng, 0.25, 1.15)
    width, height = (long, long / aspect) if aspect > 1 else (long * aspect, long)
    depth = uniform(rng, 0.018, 0.04)
    group = int(rng.integers(2, 5)) if long < 0.5 and rng.random() < 0.4 else 1
    gap = 0.06
    total = group * width + (group - 1) * gap

    def build() -> Mesh:
        parts = Parts()
        frame = palette.metal(rng) if rng.random() < 0.35 else palette.wood_or_paint(rng, 0.6)
        bar = uniform(rng, 0.01, 0.05)
        bare = rng.random() < 0.2
        gloss = uniform(rng, 0.05, 0.15) if rng.random() < 0.6 and not bare else None
        for k in range(group):
            part = Parts()
            level = uniform(rng, 0.85, 0.95)
            face = Material("print", albedo=(level, level, level), texture=print_texture(rng, aspect), roughness=gloss)
            if bare:
                part.slab(palette.cloth(rng, patterned=0), (width, height, depth - 0.001), (0, 0, -0.0005), radius=0)
                shape = rectangle((-width / 2, 0, depth / 2), (width, 0, 0), (0, height, 0), step=9, unit_uv=True)
                part.add(shape, face)
            else:
                add_framed_face(part, frame, face, width, height, depth, min(bar, width * 0.12))
            parts.add_mesh(part.mesh(), ((k - (group - 1) / 2) * (width + gap), 0, 0))
        return parts.mesh()

    return Draft("picture" if group == 1 else "pictures", (total, height, depth), build, elevation_m=1.52 - height / 2)


def mirror(rng: np.random.Generator) -> Draft:
    """Make a mirror: rectangular, round or tall."""
    kind = int(rng.integers(3))
    width = uniform(rng, 0.4, 1.1) if kind == 0 else uniform(rng, 0.4, 0.8)
    height = (uniform(rng, 0.5, 1.0), width, uniform(rng, 1.2, 1.7))[kind]
    if kind == 2:
        width = uniform(rng, 0.35, 0.65)
    depth = uniform(rng, 0.015, 0.035)

    def build() -> Mesh:
        parts = Parts()
        frame = palette.metal(rng) if rng.random() < 0.5 else palette.wood_or_paint(rng, 0.6)
        glass = Material("mirror", mirror=uniform(rng, 0.84, 0.9))
        bar = uniform(rng, 0.008, 0.06)
        if kind == 1:
            r = width / 2
            ring = lathe([[(1e-3, 0.0), (r, 0.0)], [(r, 0.0), (r, depth)], [(r, depth), (r - bar, depth)],
                          [(r - bar, depth), (r - bar, depth * 0.6)]], segments=36)  # fmt: skip
            parts.add(ring, frame, (0, r, -depth / 2), pitch=90)
            parts.add(
                lathe([[(r - bar, 0.0), (r * 0.5, 0.0), (1e-3, 0.0)]], segments=36),
                glass,
                (0, r, depth * 0.1),
                pitch=90,
            )
        else:
            add_framed_face(parts, frame, glass, width, height, depth, bar)
        return parts.mesh()

    return Draft(
        "mirror", (width, height, depth), build, elevation_m=0.35 if kind == 2 else max(1.6 - height / 2, 1.05)
    )


def clock(rng: np.random.Generator) -> Draft:
    """Make a round or square clock."""
    across, depth = uniform(rng, 0.2, 0.5), uniform(rng, 0.03, 0.06)
    square = rng.random() < 0.25

    def build() -> Mesh:
        parts = Parts()
        rim = palette.metal(rng) if rng.random() < 0.5 else palette.wood_or_paint(rng)
        r = across / 2
        dial = Material(
            "dial", albedo=(0.9, 0.9, 0.9), texture=clock_texture(rng), roughness=0.1 if rng.random() < 0.5 else None
        )
        if square:
            add_framed_face(parts, rim, dial, across, across, depth, across * 0.04)
            return parts.mesh()
        ring = lathe(
            [
                [(1e-3, 0.0), (r, 0.0)],
                [(r, 0.0), (r, depth * 0.7), (r * 0.97, depth)],
                [(r * 0.97, depth), (r * 0.9, depth)],
                [(r * 0.9, depth), (r * 0.9, depth * 0.5)],
            ],
            segments=28,
        )
        parts.add(ring, rim, (0, r, -depth / 2), pitch=90)
        # The face is a triangle fan with the image of the dial across it.
        angle = np.linspace(0, 2 * np.pi, 29)
        edge = np.stack([np.cos(angle), np.sin(angle)], 1)
        vertices = np.concatenate([np.zeros((1, 2)), edge])
        fan = np.stack([np.zeros(28, np.int32), np.arange(1, 29), np.arange(2, 30)], 1).astype(np.int32)
        face = Mesh(
            np.concatenate([vertices * r * 0.9, np.zeros((30, 1))], 1).astype(np.float32),
            np.tile(np.array([[0, 0, 1]], np.float32), (30, 1)),
            (0.5 + vertices * np.array([0.5, -0.5])).astype(np.float32),
            fan, np.zeros(28, np.int32), (dial,),
        )  # fmt: skip
        parts.add(face, dial, (0, r, depth * 0.05))
        return parts.mesh()

    return Draft("clock", (across, across, depth), build, elevation_m=uniform(rng, 1.6, 1.9))


def wall_shelf(rng: np.random.Generator) -> Draft:
    """Make one or two boards with books and objects, or cubes."""
    boards = int(rng.integers(1, 4))
    width, depth = uniform(rng, 0.5, 1.3), uniform(rng, 0.16, 0.26)
    gap = uniform(rng, 0.28, 0.36)
    height = boards * gap

    def build() -> Mesh:
        parts = Parts()
        wood = palette.wood_or_paint(rng, 0.7)
        thickness = uniform(rng, 0.018, 0.04)
        brackets = palette.metal(rng) if rng.random() < 0.5 else None
        for k in range(boards):
            y = k * gap
            parts.slab(wood, (width, thickness, depth), (0, y, 0), radius=0)
            if brackets:
                for x in (-1, 1):
                    parts.slab(
                        brackets, (0.02, 0.12, 0.012), (x * width * 0.38, y + thickness, -depth / 2 + 0.006), radius=0
                    )
            fill_shelf(parts, rng, -width / 2 + 0.03, width / 2 - 0.03, y + thickness, gap - thickness, depth - 0.03, 0)
        # One object must be as tall as the draft's size says.
        height_m = gap - thickness
        parts.add_mesh(
            vessel(rng, height_m, min(height_m * 0.5, depth * 0.8), segments=12),
            (width / 2 - 0.1, (boards - 1) * gap + thickness, 0),
        )
        return parts.mesh()

    return Draft("wall shelf", (width, height, depth), build, elevation_m=uniform(rng, 1.1, 1.45))


def whiteboard(rng: np.random.Generator) -> Draft:
    """Make a white board, a cork board or a chalkboard, with notes on it."""
    width, height, depth = uniform(rng, 0.8, 2.0), uniform(rng, 0.6, 1.2), 0.06
    kind = int(rng.choice([0, 0, 1, 2]))

    def build() -> Mesh:
        parts = Parts()
        face = (
            Material("board", albedo=palette.neutral(rng, 228, 240), roughness=uniform(rng, 0.08, 0.2)),
            Material(
                "cork", albedo=(0.95, 0.95, 0.95), texture=textures.speckle(rng, palette.srgb(190, 146, 96), veins=0.0)
            ),
            Material("slate", albedo=palette.neutral(rng, 30, 60)),
        )[kind]
        frame = palette.metal(rng) if kind == 0 else palette.wood(rng)
        part = Parts()
        add_framed_face(part, frame, face, width, height, 0.02, 0.02)
        parts.add_mesh(part.mesh(), (0, 0, -depth / 2 + 0.01))
        notes: list[tuple[float, ...]] = []
        for _ in range(int(rng.integers(0, 9))):
            w, h = uniform(rng, 0.07, 0.21), uniform(rng, 0.07, 0.28)
            notes.append(
                (
                    w,
                    h,
                    0.003,
                    uniform(rng, -0.4, 0.4) * width,
                    uniform(rng, 0.05, 0.6) * (height - 0.3),
                    -depth / 2 + 0.0135,
                )
            )
        for note in notes:
            colour = palette.hue(rng, (0.3, 0.8), (0.8, 1.0)) if rng.random() < 0.5 else palette.neutral(rng, 215, 240)
            parts.blocks(Material("note", albedo=colour), [note])
        if kind == 0:
            ink = Material("ink", albedo=palette.hue(rng, (0.6, 1.0), (0.1, 0.6)))
            parts.blocks(
                ink,
                [
                    (
                        uniform(rng, 0.1, 0.4) * width,
                        0.008,
                        0.002,
                        uniform(rng, -0.2, 0.2) * width,
                        y * height,
                        -depth / 2 + 0.0125,
                    )
                    for y in np.linspace(0.3, 0.85, int(rng.integers(2, 8)))
                ],
            )
        parts.slab(frame, (width * 0.5, 0.012, depth), (0, 0.012, 0), radius=0)
        return parts.mesh()

    return Draft("whiteboard", (width, height, depth), build, elevation_m=uniform(rng, 0.9, 1.05))


def air_conditioner(rng: np.random.Generator) -> Draft:
    """Make a wide white air conditioner for mounting high on a wall."""
    width, height, depth = uniform(rng, 0.75, 1.0), uniform(rng, 0.26, 0.32), uniform(rng, 0.18, 0.24)

    def build() -> Mesh:
        parts = Parts()
        white = palette.sanitary(rng) if rng.random() < 0.92 else palette.black(rng)
        parts.slab(white, (width, height, depth), radius=0.04, arcs=2)
        parts.slab(palette.black(rng), (width * 0.86, 0.02, 0.05), (0, 0.012, depth / 2 - 0.036), radius=0, pitch=0)
        parts.slab(palette.black(rng), (0.07, 0.025, 0.004), (width * 0.35, height * 0.4, depth / 2 - 0.0025), radius=0)
        return parts.mesh()

    return Draft("air conditioner", (width, height, depth), build, elevation_m=uniform(rng, 2.0, 2.15))


def wall_clutter(rng: np.random.Generator) -> Draft:
    """Make coat hooks with coats, a wall hanging, plates, a guitar, a key box, or letters."""
    kind = int(rng.integers(5))
    size = (
        (uniform(rng, 0.5, 1.0), uniform(rng, 0.9, 1.1), 0.2),
        (uniform(rng, 0.5, 1.2), uniform(rng, 0.6, 1.4), 0.03),
        (uniform(rng, 0.5, 0.9), uniform(rng, 0.2, 0.5), 0.03),
        (uniform(rng, 0.36, 0.4), uniform(rng, 0.95, 1.05), 0.11),
        (uniform(rng, 0.2, 0.34), uniform(rng, 0.24, 0.4), 0.08),
    )[kind]
    top = (1.75, 2.0, 1.9, 1.9, 1.7)[kind]
    name = ("coat rack", "wall hanging", "plates on the wall", "guitar", "letter box")[kind]
    return Draft(name, size, partial(_clutter, rng, kind, size), elevation_m=top - size[1])


def _clutter(rng: np.random.Generator, kind: int, size: tuple[Number, Number, Number]) -> Mesh:
    parts = Parts()
    width, height, depth = size
    back = -depth / 2
    if kind == 0:
        parts.slab(palette.wood(rng), (width, 0.1, 0.02), (0, height - 0.1, back + 0.01), radius=0)
        metal = palette.metal(rng)
        xs = np.linspace(-width / 2 + 0.18, width / 2 - 0.18, 3 if width < 0.8 else 4)
        for k, x in enumerate(xs):
            parts.add(
                tube(
                    [(x, height - 0.06, back + 0.02), (x, height - 0.07, back + 0.08), (x, height - 0.03, back + 0.1)],
                    0.006,
                    segments=6,
                ),
                metal,
            )
            if k == 0 or rng.random() < 0.5:
                coat = palette.cloth(rng)
                height_m = height - 0.06 if k == 0 else uniform(rng, 0.5, 0.9)
                top = height - 0.06
                width_m, depth_m = uniform(rng, 0.15, 0.2), depth * uniform(rng, 0.2, 0.3)
                folds = [
                    (width_m * s, depth_m * r, top - height_m * t, float(x), 0.01)
                    for t, s, r in (
                        (1.0, 1.0, 0.8),
                        (0.5, 0.82, 0.8),
                        (0.2, 0.95, 1.0),
                        (0.07, 0.7, 0.6),
                        (0.0, 0.15, 0.25),
                    )
                ]
                parts.add(
                    loft(
                        [
                            [(1e-3, 1e-3, top - height_m, float(x), 0.01), folds[0]],
                            folds,
                            [folds[-1], (1e-3, 1e-3, top, float(x), 0.01)],
                        ],
                        exponent=2.6,
                        segments=16,
                    ),
                    coat,
                )
                for side in (-1, 1):
                    shoulder, hand = (
                        (float(x) + side * width_m * 0.8, top - height_m * 0.18, 0.02),
                        (float(x) + side * width_m * 0.9, top - height_m * 0.62, 0.05),
                    )
                    parts.bar(coat, shoulder, hand, 0.055, 0.04, segments=10)
    elif kind == 1:
        cloth = Material("tapestry", albedo=(0.95, 0.95, 0.95), texture=rug_texture(rng, width / height))
        parts.bar(palette.wood(rng), (-width / 2, height - 0.014, 0), (width / 2, height - 0.014, 0), 0.014)
        shape = rectangle((-width * 0.48, 0, 0), (width * 0.96, 0, 0), (0, height - 0.014, 0), step=9, unit_uv=True)
        parts.add(shape, cloth, (0, 0, 0.003))
        parts.slab(palette.cloth(rng, patterned=0), (width * 0.96, height - 0.014, 0.004), (0, 0, 0), radius=0)
    elif kind == 2:
        count = int(rng.integers(2, 6))
        for k in range(count):
            r = min(width / count, height) * (0.5 if k in (0, count - 1) else uniform(rng, 0.36, 0.5))
            x = (k + 0.5) / count * width - width / 2
            y = height - r if k % 2 else r
            parts.add(
                solid_of_revolution([(r * 0.6, 0.0), (r, 0.02), (r * 0.96, depth)], segments=20),
                palette.ceramic(rng),
                (x, y, back),
                pitch=90,
            )
    elif kind == 3:
        wood, dark = palette.wood(rng), palette.black(rng)
        for share, y in ((1.0, 0.5 * width), (0.76, height * 0.42)):
            r = width / 2 * share
            parts.add(solid_of_revolution([(r, 0.0), (r, depth * 0.8)], segments=24), wood, (0, y, back), pitch=90)
        parts.add(
            solid_of_revolution([(0.045, 0.0), (0.045, 0.003)], segments=16),
            dark,
            (0, height * 0.38, back + depth * 0.8),
            pitch=90,
        )
        parts.slab(dark, (0.05, height * 0.5, 0.025), (0, height * 0.42, back + depth * 0.8 - 0.004), radius=0)
        parts.slab(wood, (0.075, 0.13, 0.02), (0, height - 0.13, back + depth * 0.7), radius=0)
        parts.slab(dark, (0.15, 0.02, 0.012), (0, height * 0.16, back + depth * 0.8), radius=0)
    else:
        material = palette.wood_or_paint(rng, 0.4)
        parts.slab(material, (width, height, depth * 0.3), (0, 0, back + depth * 0.15), radius=0)
        parts.slab(material, (width, height * 0.5, depth * 0.3), (0, 0, back + depth * 0.85), radius=0)
        parts.slab(material, (width, 0.01, depth), (0, 0, 0), radius=0)
        for k in range(int(rng.integers(2, 6))):
            grid = np.array(
                [
                    [[x, y, back + depth * 0.5 + 0.006 * k - 0.01] for x in (-width * 0.4, width * 0.3 + 0.01 * k)]
                    for y in (0.02, height * uniform(rng, 0.55, 0.85))
                ],
                np.float32,
            )
            parts.add(double_sided_sheet(grid, thickness=0.002), palette.paper(rng))
    return parts.mesh()
