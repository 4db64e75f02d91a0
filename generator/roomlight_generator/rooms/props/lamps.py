"""Floor, table and wall lamps. Materials named `shade...` emit when the lamp is on."""

from collections.abc import Sequence

import numpy as np

from roomlight_generator.rooms.furniture_model import LightSource
from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, light_source, uniform
from roomlight_generator.rooms.props.small_objects import solid_of_revolution, vessel
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, Vector, double_sided_sheet, lathe, loft, sphere, tube


def open_shade(low_radius: Number, high_radius: Number, height: Number, *, segments: int = 24) -> Mesh:
    """Make an open lampshade standing on y = 0: a single layer, facing outward."""
    return lathe([[(float(low_radius), 0.0), (float(low_radius + high_radius) / 2, float(height) / 2),
                   (float(high_radius), float(height))]], segments=segments)  # fmt: skip


def reflector(
    low_radius: Number, high_radius: Number, height: Number, *, thickness: Number = 0.004, segments: int = 20
) -> Mesh:
    """Make an opaque reflector open below, closed above, with an inner and an outer wall."""
    a, b, h, t = float(low_radius), float(high_radius), float(height), float(thickness)
    curve = [(a, 0.0), (a + (b - a) * 0.35, h * 0.45), (b, h)]
    inner = [(b - t, h - t), (a + (b - a) * 0.35 - t, h * 0.45), (a - t, 0.0)]
    return lathe([curve, [(b, h), (1e-3, h)], [(1e-3, h - t), (b - t, h - t)], inner, [(a - t, 0.0), (a, 0.0)]],
                 segments=segments)  # fmt: skip


def disc_base(radius: Number, thickness: Number = 0.018) -> Mesh:
    """Make a base plate."""
    return solid_of_revolution([(radius, 0.0), (radius, thickness * 0.7), (radius * 0.9, thickness)], segments=22)


def add_bulb(parts: Parts, rng: np.random.Generator, at: Vector, radius: Number = 0.03) -> None:
    """Add a bare glowing bulb."""
    parts.add(sphere(radius, rings=6, segments=10), palette.opal(rng), at)


def _add_stand(
    parts: Parts, rng: np.random.Generator, metal: Material, low: Number, top: Number, reach: Number
) -> None:
    """Add a pole on a plate, or three legs."""
    if rng.random() < 0.7:
        parts.add(disc_base(reach), metal)
        parts.bar(metal, (0, 0.01, 0), (0, top, 0), 0.011)
    else:
        wood = palette.wood(rng)
        for angle in np.radians([90.0, 210.0, 330.0]):
            parts.bar(wood, (reach * np.cos(angle), 0, reach * np.sin(angle)), (0, low, 0), 0.012, 0.016)
        parts.bar(metal, (0, low - 0.05, 0), (0, top, 0), 0.012)


def floor_lamp(rng: np.random.Generator) -> Draft:
    """Make a floor lamp: a shade on a stand, an uplighter, an arc, a reading lamp, or a tall paper lantern."""
    kind = int(rng.integers(5))
    height = (uniform(rng, 1.4, 1.75), uniform(rng, 1.65, 1.9), uniform(rng, 1.75, 2.1), uniform(rng, 1.3, 1.6),
              uniform(rng, 0.9, 1.6))[kind]  # fmt: skip
    across = (uniform(rng, 0.3, 0.5), uniform(rng, 0.26, 0.4), 0.0, 0.26, uniform(rng, 0.2, 0.38))[kind]
    if kind == 0:
        height_m = uniform(rng, 0.2, 0.34)
        low = height - height_m
        lights = (light_source(0, low + height_m / 2, 0),)

        def build_drum() -> Mesh:
            parts = Parts()
            _add_stand(parts, rng, palette.metal(rng), low, low + height_m * 0.4, across * 0.45)
            parts.add(
                open_shade(across / 2, across / 2 * uniform(rng, 0.6, 1.0), height_m), palette.shade(rng), (0, low, 0)
            )
            return parts.mesh()

        return Draft("floor lamp", (across, height, across), build_drum, lights=lights)
    if kind == 1:

        def build_uplighter() -> Mesh:
            parts = Parts()
            metal = palette.metal(rng)
            _add_stand(parts, rng, metal, height - 0.2, height - 0.1, across * 0.42)
            bowl = palette.shade(rng)
            half = across / 2
            parts.add(
                lathe([[(0.02, 0.0), (half * 0.7, 0.04), (half, 0.11)]], segments=24), bowl, (0, height - 0.11, 0)
            )
            return parts.mesh()

        return Draft(
            "uplighter", (across, height, across), build_uplighter, lights=(light_source(0, height - 0.05, 0, 0.05),)
        )
    if kind == 2:
        return _arc_lamp(rng, height)
    if kind == 3:
        return _reading_lamp(rng, height)

    def build_lantern() -> Mesh:
        parts = Parts()
        half = across / 2
        bumps = int(rng.integers(1, 4))
        exponent = float(rng.choice([2.0, 2.0, 10.0]))
        side = [
            (half * (0.8 + 0.2 * abs(np.sin(np.pi * bumps * t))), half * (0.8 + 0.2 * abs(np.sin(np.pi * bumps * t))),
             0.05 + (height - 0.06) * t) for t in np.linspace(0, 1, 6 * bumps + 1)
        ]  # fmt: skip
        parts.add(loft([side, [side[-1], (1e-3, 1e-3, height)]], exponent=exponent, segments=24), palette.shade(rng))
        foot = palette.wood(rng)
        parts.slab(foot, (across, 0.05, across), radius=0.004) if exponent > 5 else parts.add(
            disc_base(half, 0.05), foot
        )
        return parts.mesh()

    lights = tuple(light_source(0, height * y, 0) for y in (0.3, 0.65))
    return Draft("paper lantern", (across, height, across), build_lantern, lights=lights)


def _arc_lamp(rng: np.random.Generator, height: Number) -> Draft:
    reach, across = uniform(rng, 0.7, 1.1), uniform(rng, 0.26, 0.4)
    width, depth = reach + across / 2 + 0.16, max(across, 0.32)
    foot_x, end_x = -width / 2 + 0.16, width / 2 - across / 2
    low = height - uniform(rng, 0.3, 0.5)
    metal_hat = rng.random() < 0.5

    def build() -> Mesh:
        parts = Parts()
        metal = palette.metal(rng)
        parts.add(disc_base(0.16, 0.04), palette.worktop(rng) if rng.random() < 0.4 else metal, (foot_x, 0, 0))
        turn = np.linspace(0, np.pi, 11)
        middle, half = (foot_x + end_x) / 2, (end_x - foot_x) / 2
        start, top = height * 0.45, height - 0.012
        end = low + 0.14
        path = [(foot_x, 0.02, 0.0), (foot_x, start * 0.5, 0.0)]
        for t in turn:
            rest = start if t < np.pi / 2 else end
            path.append((middle - half * float(np.cos(t)), rest + (top - rest) * float(np.sin(t)), 0.0))
        parts.add(tube([(float(x), float(y), z) for x, y, z in path], 0.011), metal)
        if metal_hat:
            parts.add(
                reflector(across / 2, 0.03, 0.15), metal if rng.random() < 0.5 else palette.paint(rng), (end_x, low, 0)
            )
            add_bulb(parts, rng, (end_x, low + 0.06, 0), 0.03)
        else:
            parts.add(open_shade(across / 2, across / 2 * 0.8, 0.2), palette.shade(rng), (end_x, low, 0))
        return parts.mesh()

    lights = (light_source(end_x, low + (0.06 if metal_hat else 0.1), 0, 0.05),)
    return Draft("arc lamp", (width, height, depth), build, lights=lights)


def _reading_lamp(rng: np.random.Generator, height: Number) -> Draft:
    width, depth = 0.26, uniform(rng, 0.4, 0.55)
    head = (0.0, height - 0.11, depth / 2 - 0.08)

    def build() -> Mesh:
        parts = Parts()
        metal = palette.metal(rng)
        back = -depth / 2 + 0.13
        parts.add(disc_base(0.13), metal, (0, 0, back))
        parts.bar(metal, (0, 0.01, back), (0, height - 0.03, back), 0.01)
        parts.bar(metal, (0, height - 0.05, back), (0, height - 0.01, head[2]), 0.008)
        parts.add(
            reflector(0.08, 0.025, 0.12),
            metal if rng.random() < 0.6 else palette.paint(rng),
            (head[0], head[1] - 0.02, head[2]),
        )
        add_bulb(parts, rng, (head[0], head[1] + 0.02, head[2]), 0.025)
        return parts.mesh()

    return Draft(
        "reading lamp", (width, height, depth), build, lights=(light_source(head[0], head[1] + 0.02, head[2], 0.04),)
    )


def table_lamp(rng: np.random.Generator) -> Draft:
    """Make a table lamp: a shade on a vase or a stick, a glowing sphere, a desk lamp with a jointed arm, a mushroom."""
    kind = int(rng.integers(5))
    if kind == 3:
        return _desk_lamp(rng)
    height = (uniform(rng, 0.35, 0.65), uniform(rng, 0.3, 0.6), uniform(rng, 0.14, 0.3), 0.0, uniform(rng, 0.24, 0.45))[
        kind
    ]
    across = (
        height * uniform(rng, 0.5, 0.8),
        height * uniform(rng, 0.4, 0.7),
        height,
        0.0,
        height * uniform(rng, 0.7, 1.0),
    )[kind]
    height_m = height * uniform(rng, 0.36, 0.5)
    low = height - height_m
    middle = {0: low + height_m * 0.5, 1: low + height_m * 0.5, 2: height / 2, 4: low + height_m * 0.4}[kind]

    def build() -> Mesh:
        parts = Parts()
        half = across / 2
        metal = palette.metal(rng)
        if kind == 2:
            parts.add(sphere(half * 0.98, rings=10, segments=18), palette.opal(rng), (0, half, 0))
            parts.add(disc_base(half * 0.5, 0.02), metal)
            return parts.mesh()
        if kind == 0:
            parts.add_mesh(vessel(rng, low * 0.95, half * uniform(rng, 0.8, 1.3)))
            parts.bar(metal, (0, low * 0.8, 0), (0, low + height_m * 0.25, 0), 0.008)
        else:
            stick = palette.wood_or_paint(rng) if rng.random() < 0.5 else metal
            parts.add(disc_base(half * 0.55), stick)
            parts.bar(stick, (0, 0.01, 0), (0, low + height_m * 0.2, 0), uniform(rng, 0.008, 0.02))
        if kind == 4:
            dome = [(half * np.sin(t), low + height_m * np.cos(t)) for t in np.linspace(np.pi / 2, 0.02, 7)]
            parts.add(lathe([[(max(float(r), 1e-3), float(y)) for r, y in dome]], segments=22), palette.shade(rng))
        else:
            parts.add(open_shade(half, half * uniform(rng, 0.5, 1.0), height_m), palette.shade(rng), (0, low, 0))
        return parts.mesh()

    return Draft("table lamp", (across, height, across), build, lights=(light_source(0, middle, 0, 0.05),))


def _desk_lamp(rng: np.random.Generator) -> Draft:
    height, depth, width = uniform(rng, 0.38, 0.6), uniform(rng, 0.36, 0.55), uniform(rng, 0.16, 0.2)
    head = np.array([0.0, height - 0.12, depth / 2 - 0.075])

    def build() -> Mesh:
        parts = Parts()
        metal = palette.metal(rng) if rng.random() < 0.5 else palette.paint(rng)
        back = -depth / 2 + width / 2
        parts.add(disc_base(width / 2), metal, (0, 0, back))
        elbow = (0, height * 0.55, back - 0.03)
        parts.bar(metal, (0, 0.01, back), elbow, 0.008)
        parts.bar(metal, elbow, (0, height - 0.012, head[2] - 0.03), 0.008)
        parts.add(reflector(0.072, 0.025, 0.11), metal, head - np.array([0, 0.02, 0]), pitch=-14)
        add_bulb(parts, rng, head + np.array([0, 0.02, 0]), 0.024)
        return parts.mesh()

    return Draft("desk lamp", (width, height, depth), build, lights=(light_source(0, head[1] + 0.02, head[2], 0.04),))


def wall_lamp(rng: np.random.Generator) -> Draft:
    """Make a wall lamp: a half bowl, a cylinder open above and below, a globe or shade on an arm, a bar over a
    mirror."""
    kind = int(rng.integers(5))
    width, height, depth = (
        (uniform(rng, 0.22, 0.4), uniform(rng, 0.11, 0.2), uniform(rng, 0.1, 0.18)),
        (uniform(rng, 0.08, 0.12), uniform(rng, 0.16, 0.32), uniform(rng, 0.1, 0.14)),
        (uniform(rng, 0.12, 0.18), uniform(rng, 0.18, 0.26), uniform(rng, 0.16, 0.24)),
        (uniform(rng, 0.16, 0.24), uniform(rng, 0.24, 0.34), uniform(rng, 0.2, 0.3)),
        (uniform(rng, 0.4, 0.8), uniform(rng, 0.05, 0.08), uniform(rng, 0.08, 0.14)),
    )[kind]
    r = width / 2
    bulbs: Sequence[LightSource] = (
        (light_source(0, height * 0.7, -depth / 2 + 0.06, 0.05),),
        (light_source(0, height / 2, depth / 2 - r, 0.04),),
        (light_source(0, height - r, depth / 2 - r, 0.05),),
        (light_source(0, height - 0.08, depth / 2 - r, 0.05),),
        tuple(light_source(x * width, height / 2, depth / 2 - 0.03, 0.03) for x in (-0.3, 0.0, 0.3)),
    )[kind]

    def build() -> Mesh:
        parts = Parts()
        metal = palette.metal(rng)
        back = -depth / 2
        if kind == 0:
            angle = np.linspace(0, np.pi, 13)
            rings = [[(r * s * np.cos(a), height * y, back + depth * s * np.sin(a)) for a in angle]
                     for s, y in ((0.12, 0.0), (0.6, 0.25), (0.88, 0.6), (1.0, 1.0))]  # fmt: skip
            parts.add(
                double_sided_sheet(np.array(rings, np.float32)[:, ::-1].copy(), thickness=0.003), palette.shade(rng)
            )
            parts.slab(metal, (r * 0.6, height * 0.6, 0.02), (0, height * 0.2, back + 0.01), radius=0)
        elif kind == 1:
            z = depth / 2 - r
            parts.add(
                lathe(
                    [
                        [(r, 0.0), (r, height)],
                        [(r, height), (r * 0.93, height)],
                        [(r * 0.93, height), (r * 0.93, 0.0)],
                        [(r * 0.93, 0.0), (r, 0.0)],
                    ],
                    segments=20,
                ),
                metal,
                (0, 0, z),
            )
            for y in (height * 0.2, height * 0.8 - 0.008):
                parts.add(
                    solid_of_revolution([(r * 0.9, 0.0), (r * 0.9, 0.008)], segments=16), palette.opal(rng), (0, y, z)
                )
            parts.slab(
                metal, (0.05, 0.08, depth / 2 + z - r + 0.004), (0, height / 2 - 0.04, (back + z - r) / 2), radius=0
            )
        elif kind in (2, 3):
            z = depth / 2 - r
            parts.slab(metal, (0.08, 0.12, 0.02), (0, 0, back + 0.01), radius=0.006)
            low = height - (2 * r if kind == 2 else height * 0.6)
            parts.add(
                tube(
                    [(0, 0.06, back + 0.015), (0, 0.05, (back + z) / 2), (0, 0.06, z), (0, max(low + 0.02, 0.1), z)],
                    0.008,
                ),
                metal,
            )
            if kind == 2:
                parts.add(sphere(r, rings=9, segments=16), palette.opal(rng), (0, height - r, z))
            else:
                parts.add(open_shade(r, r * 0.7, height * 0.6), palette.shade(rng), (0, low, z))
        else:
            parts.slab(
                metal, (width * 0.3, height * 0.8, depth - 0.05), (0, height * 0.1, back + (depth - 0.05) / 2), radius=0
            )
            parts.bar(
                palette.opal(rng),
                (-width / 2 + 0.012, height / 2, depth / 2 - 0.03),
                (width / 2 - 0.012, height / 2, depth / 2 - 0.03),
                min(0.028, height / 2 * 0.95),
                segments=12,
            )
            for x in (-1, 1):
                parts.slab(metal, (0.014, height, 0.06), (x * (width / 2 - 0.007), 0, depth / 2 - 0.03), radius=0)
        return parts.mesh()

    return Draft("wall lamp", (width, height, depth), build, elevation_m=uniform(rng, 1.5, 1.9), lights=tuple(bulbs))
