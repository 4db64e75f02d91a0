"""Ceiling lamps and fans: their top, at y = height, touches the ceiling. Materials named `shade...` emit when on."""

from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight_generator.rooms.furniture_model import LightSource
from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, circle_points, light_source, uniform
from roomlight_generator.rooms.props.lamps import add_bulb, open_shade, reflector
from roomlight_generator.rooms.props.small_objects import solid_of_revolution
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, double_sided_sheet, lathe, sphere, tube

_PROTRUSION_M: Final = 0.03
"""Visible length of a recessed lamp's tube: the ceiling has no hole for the rest."""


def _add_canopy(parts: Parts, metal: Material, height: Number, low: Number, x: Number = 0.0, z: Number = 0.0) -> None:
    """Add a canopy under the ceiling and the cable down to `low`."""
    parts.add(
        solid_of_revolution([(0.02, height - 0.03), (0.05, height - 0.02), (0.05, height)], segments=14),
        metal,
        (x, 0, z),
    )
    parts.bar(metal, (x, low, z), (x, height - 0.02, z), 0.004, segments=6)


def flush_dome(rng: np.random.Generator) -> Draft:
    """Make a shallow bowl, or a drum, directly under the ceiling."""
    across, height = uniform(rng, 0.24, 0.55), uniform(rng, 0.08, 0.15)
    drummed = rng.random() < 0.4

    def build() -> Mesh:
        parts = Parts()
        half, rim = across / 2, 0.02
        edge = palette.metal(rng) if rng.random() < 0.6 else palette.paint(rng, palette.neutral(rng, 210, 240))
        parts.add(solid_of_revolution([(half, height - rim), (half, height)], segments=28), edge)
        r = half * 0.94
        if drummed:
            profile = [[(1e-3, 0.0), (r, 0.0)], [(r, 0.0), (r, height - rim)]]
        else:
            depth_m = height - rim
            profile = [
                [
                    (max(r * float(np.sin(t)), 1e-3), depth_m * (1 - float(np.cos(t))))
                    for t in np.linspace(0, np.pi / 2, 6)
                ]
            ]
        parts.add(lathe(profile, segments=28), palette.opal(rng))
        return parts.mesh()

    return Draft(
        "flush ceiling lamp", (across, height, across), build, lights=(light_source(0, height * 0.5, 0, 0.04),)
    )


def pendant(rng: np.random.Generator) -> Draft:
    """Make a pendant: a globe, a metal cone or bell, a cloth drum, a paper sphere, a bare bulb."""
    kind = int(rng.integers(5))
    across = (uniform(rng, 0.18, 0.42), uniform(rng, 0.2, 0.48), uniform(rng, 0.3, 0.6), uniform(rng, 0.35, 0.6),
              uniform(rng, 0.1, 0.13))[kind]  # fmt: skip
    height_m = (across, across * uniform(rng, 0.5, 0.9), across * uniform(rng, 0.4, 0.7), across, across * 1.2)[kind]
    height = min(height_m + uniform(rng, 0.2, 0.75), 1.1)
    middle = height_m * (0.4 if kind == 1 else 0.5)

    def build() -> Mesh:
        parts = Parts()
        half = across / 2
        metal = palette.metal(rng)
        if kind in (0, 3):
            parts.add(
                sphere(half, rings=12, segments=20),
                palette.opal(rng) if kind == 0 else palette.shade(rng),
                (0, half, 0),
            )
        elif kind == 1:
            skin = metal if rng.random() < 0.4 else palette.paint(rng)
            parts.add(reflector(half, half * uniform(rng, 0.12, 0.5), height_m), skin)
            add_bulb(parts, rng, (0, middle, 0), min(0.04, half * 0.3))
            parts.bar(palette.black(rng), (0, middle + 0.02, 0), (0, height_m, 0), 0.014)
        elif kind == 2:
            parts.add(open_shade(half, half * uniform(rng, 0.75, 1.0), height_m), palette.shade(rng))
            if rng.random() < 0.5:
                parts.add(
                    solid_of_revolution([(half * 0.97, 0.008), (half * 0.97, 0.012)], segments=24), palette.opal(rng)
                )
            parts.blocks(
                metal,
                [
                    (across * 0.8, 0.004, 0.004, 0, height_m - 0.03, 0),
                    (0.004, 0.004, across * 0.8, 0, height_m - 0.03, 0),
                ],
            )
        else:
            add_bulb(parts, rng, (0, half, 0), half)
            parts.bar(palette.black(rng), (0, across * 0.95, 0), (0, height_m, 0), 0.02)
        _add_canopy(parts, metal, height, middle + 0.03 if kind == 2 else height_m - 0.01)
        return parts.mesh()

    return Draft("pendant lamp", (across, height, across), build, lights=(light_source(0, middle, 0, 0.06),))


def pendant_row(rng: np.random.Generator) -> Draft:
    """Make two to four pendants on one bar, for a table or a counter."""
    count = int(rng.integers(2, 5))
    across, pitch = uniform(rng, 0.11, 0.26), uniform(rng, 0.28, 0.4)
    width, height = (count - 1) * pitch + across, uniform(rng, 0.5, 1.0)
    height_m = across * uniform(rng, 0.8, 1.4)
    globes = rng.random() < 0.5
    if globes:
        height_m = across
    xs = [float(x) for x in np.linspace(-0.5, 0.5, count) * (count - 1) * pitch]

    def build() -> Mesh:
        parts = Parts()
        metal = palette.metal(rng)
        skin = metal if rng.random() < 0.4 else palette.paint(rng)
        glow = palette.opal(rng)
        parts.slab(metal, (max(width - across, 0.3), 0.03, 0.06), (0, height - 0.03, 0), radius=0)
        for x in xs:
            parts.bar(metal, (x, height_m * 0.95, 0), (x, height - 0.02, 0), 0.004, segments=6)
            if globes:
                parts.add(sphere(across / 2, rings=8, segments=14), glow, (x, across / 2, 0))
            else:
                parts.add(reflector(across / 2, across * 0.15, height_m, segments=14), skin, (x, 0, 0))
                parts.add(sphere(min(0.03, across * 0.2), rings=5, segments=8), glow, (x, height_m * 0.35, 0))
        return parts.mesh()

    lights = tuple(light_source(x, across / 2 if globes else height_m * 0.35, 0, 0.04) for x in xs)
    return Draft("row of pendants", (width, height, across), build, lights=lights)


def chandelier(rng: np.random.Generator) -> Draft:
    """Make arms around a column with candles, globes or small shades; or spikes with bulbs."""
    arms = int(rng.integers(3, 8))
    across, drop = uniform(rng, 0.45, 0.8), uniform(rng, 0.15, 0.45)
    body = uniform(rng, 0.22, 0.4)
    height = body + drop
    kind = int(rng.integers(3))
    size = (0.013, uniform(rng, 0.035, 0.055), uniform(rng, 0.045, 0.07))[kind]
    tips = circle_points(arms, across / 2 - size, uniform(rng, 0, 1))
    low_corner, high_corner = tips.min(0) - size, tips.max(0) + size
    middle = (low_corner + high_corner) / 2
    level = body * uniform(rng, 0.4, 0.6)
    low = {0: level + 0.07, 1: level + size, 2: level + 0.05}[kind]
    extent = float(high_corner[0] - low_corner[0]), float(high_corner[1] - low_corner[1])

    def build() -> Mesh:
        parts = Parts()
        metal = palette.metal(rng)
        glow = palette.opal(rng) if kind < 2 else palette.shade(rng)
        parts.add(
            solid_of_revolution(
                [(0.008, 0.0), (0.035, body * 0.12), (0.012, body * 0.3), (0.045, body * 0.55), (0.012, body)],
                segments=14,
            ),
            metal,
        )
        _add_canopy(parts, metal, height, body * 0.9)
        for x, z in tips:
            path = [
                (x * t, body * 0.5 + (level - body * 0.5) * t - 0.28 * body * float(np.sin(np.pi * t)), z * t)
                for t in np.linspace(0.05, 1, 6)
            ]
            parts.add(tube([(float(a), b, float(c)) for a, b, c in path], 0.006, segments=6), metal)
            if kind == 0:
                parts.bar(metal, (x, level, z), (x, level + 0.05, z), 0.011, segments=8)
                parts.add(
                    solid_of_revolution([(0.008, 0.0), (0.013, 0.012), (0.003, 0.045)], segments=8),
                    glow,
                    (x, level + 0.05, z),
                )
            elif kind == 1:
                parts.add(sphere(size, rings=8, segments=12), glow, (x, level + size, z))
            else:
                parts.bar(metal, (x, level, z), (x, level + 0.04, z), 0.008, segments=6)
                parts.add(open_shade(size, size * 0.6, 0.09, segments=14), glow, (x, level + 0.02, z))
        return parts.mesh()

    lights = tuple(light_source(float(x), low, float(z), 0.03) for x, z in tips - middle)
    return Draft("chandelier", (extent[0], height, extent[1]), build, lights=lights)


def _add_spotlight_tube(
    parts: Parts,
    skin: Material,
    glow: Material,
    radius: Number,
    length: Number,
    at: np.ndarray,
    pitch: Number,
    yaw: Number,
) -> None:
    """Add a tube open at its lower end with a bright disc recessed in it; `at` is the middle of its top."""
    r, t = radius, radius * 0.88
    shape = lathe(
        [
            [(r, -length), (r, 0.0)],
            [(r, 0.0), (1e-3, 0.0)],
            [(1e-3, -0.01), (t, -0.01)],
            [(t, -0.01), (t, -length)],
            [(t, -length), (r, -length)],
        ],
        segments=16,
    )
    parts.add(shape, skin, at, pitch=pitch, yaw=yaw)
    parts.add(
        solid_of_revolution([(t * 0.96, -0.4 * length), (t * 0.96, -0.4 * length + 0.004)], segments=14),
        glow,
        at,
        pitch=pitch,
        yaw=yaw,
    )


def _tilted(points: Float[np.ndarray, "n 3"], pitch: Number, yaw: Number) -> Float[np.ndarray, "n 3"]:
    """Rotate points about x by pitch, then about y by yaw, as `Parts.add` does."""
    p, y = np.radians(pitch), np.radians(yaw)
    about_x = np.array([[1, 0, 0], [0, np.cos(p), -np.sin(p)], [0, np.sin(p), np.cos(p)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    return points @ (about_y @ about_x).T


def track(rng: np.random.Generator) -> Draft:
    """Make a rail or a bar with tilted spotlights: dark or white tubes with a recessed disc."""
    count = int(rng.integers(2, 6))
    width = uniform(rng, 0.32, 0.42) * count
    radius, length = uniform(rng, 0.028, 0.045), uniform(rng, 0.09, 0.15)
    tilts = [(uniform(rng, 12, 42), uniform(rng, -180, 180)) for _ in range(count)]
    xs = [float(x) for x in np.linspace(-0.5, 0.5, count) * (width - 0.18)]
    ring = circle_points(16, radius)
    rims = np.concatenate([np.stack([ring[:, 0], np.full(16, y), ring[:, 1]], 1) for y in (0.0, -length)])
    cans = [_tilted(rims, pitch, yaw) + np.array([x, 0, 0]) for x, (pitch, yaw) in zip(xs, tilts, strict=True)]
    corners = np.concatenate([*cans, [[-width / 2, 0, -0.02], [width / 2, 0, 0.02]]])
    low, high = corners.min(0), corners.max(0)
    middle, height = (low + high) / 2, 0.055 - float(low[1])
    bulbs = [
        _tilted(np.array([[0.0, -0.2 * length, 0.0]]), pitch, yaw)[0]
        + np.array([x - middle[0], height - 0.055, -middle[2]])
        for x, (pitch, yaw) in zip(xs, tilts, strict=True)
    ]

    def build() -> Mesh:
        parts = Parts()
        skin = palette.black(rng) if rng.random() < 0.5 else palette.paint(rng, palette.neutral(rng, 180, 240))
        glow = palette.opal(rng)
        parts.slab(skin, (width, 0.025, 0.04), (0, height - 0.025, 0), radius=0)
        for x, (pitch, yaw) in zip(xs, tilts, strict=True):
            parts.bar(skin, (x, height - 0.06, 0), (x, height - 0.02, 0), 0.009, segments=6)
            _add_spotlight_tube(parts, skin, glow, radius, length, np.array([x, height - 0.055, 0.0]), pitch, yaw)
        return parts.mesh()

    size = (float(high[0] - low[0]), height, float(high[2] - low[2]))
    return Draft(
        "track with spots",
        size,
        build,
        lights=tuple(light_source(float(bulb[0]), float(bulb[1]), float(bulb[2]), 0.03) for bulb in bulbs),
    )


def batten(rng: np.random.Generator) -> Draft:
    """Make a fluorescent tube under its housing, bare or behind a diffuser."""
    width, height, depth = (
        float(rng.choice([0.6, 1.2, 1.5])) + uniform(rng, 0.0, 0.03),
        uniform(rng, 0.07, 0.1),
        uniform(rng, 0.08, 0.18),
    )
    bare = rng.random() < 0.4
    y = 0.016 if bare else height * 0.3

    def build() -> Mesh:
        parts = Parts()
        white = palette.paint(rng, palette.neutral(rng, 200, 240))
        parts.slab(white, (width, height * 0.5, depth if not bare else depth * 0.6), (0, height * 0.5, 0), radius=0)
        if bare:
            parts.bar(palette.opal(rng), (-width / 2 + 0.03, y, 0), (width / 2 - 0.03, y, 0), 0.014, segments=10)
            for x in (-1, 1):
                parts.slab(white, (0.03, height * 0.6, 0.05), (x * (width / 2 - 0.015), 0, 0), radius=0)
            parts.slab(white, (width, 0.004, depth), (0, height * 0.5 - 0.004, 0), radius=0)
        else:
            parts.slab(palette.opal(rng), (width - 0.04, height * 0.5, depth - 0.01), (0, 0, 0), radius=0.012)
            for x in (-1, 1):
                parts.slab(white, (0.02, height * 0.52, depth), (x * (width / 2 - 0.01), 0, 0), radius=0)
        return parts.mesh()

    lights = tuple(light_source(x * width, y, 0, 0.024) for x in (-0.3, 0.0, 0.3))
    return Draft("fluorescent batten", (width, height, depth), build, lights=lights)


def panel(rng: np.random.Generator) -> Draft:
    """Make a flat LED panel in a thin frame: 60 x 60, 30 x 120, 60 x 120 or 30 x 30 cm."""
    sizes = ((0.6, 0.6), (1.2, 0.3), (1.2, 0.6), (0.3, 0.3))
    width, depth = sizes[int(rng.choice(4, p=[0.45, 0.25, 0.15, 0.15]))]
    width, depth = width - uniform(rng, 0.002, 0.012), depth - uniform(rng, 0.002, 0.012)
    height = uniform(rng, 0.012, 0.035)

    def build() -> Mesh:
        parts = Parts()
        frame = palette.paint(rng, palette.neutral(rng, 200, 240)) if rng.random() < 0.8 else palette.metal(rng)
        edge = uniform(rng, 0.01, 0.025)
        parts.slab(frame, (width - 0.004, height * 0.4, depth - 0.004), (0, height * 0.6, 0), radius=0)
        parts.blocks(frame, [(edge, height, depth, x * (width - edge) / 2, 0, 0) for x in (-1, 1)])
        parts.blocks(frame, [(width - 2 * edge, height, edge, 0, 0, z * (depth - edge) / 2) for z in (-1, 1)])
        parts.slab(palette.opal(rng), (width - 2 * edge, 0.003, depth - 2 * edge), (0, 0.002, 0), radius=0)
        return parts.mesh()

    # The light source is behind the bright face, in the housing, so that only the face is visible.
    inside = light_source(0, (0.005 + 0.6 * height) / 2, 0, 0.02)
    return Draft("light panel", (width, height, depth), build, lights=(inside,))


def downlight(rng: np.random.Generator) -> Draft:
    """Make a recessed spotlight: 3 cm of its tube protrude from the ceiling, with the disc inside."""
    across = uniform(rng, 0.08, 0.105)
    lights = (light_source(0, _PROTRUSION_M - 0.0045, 0, 0.02),)
    return Draft("downlight", (across, _PROTRUSION_M, across), lambda: _downlight(rng, across), lights=lights)


def _downlight(rng: np.random.Generator, across: Number) -> Mesh:
    """Build the tube, its inside and the disc."""
    height = _PROTRUSION_M
    parts = Parts()
    skin = palette.paint(rng, palette.neutral(rng, 200, 240)) if rng.random() < 0.6 else palette.metal(rng)
    inside = palette.paint(rng, palette.neutral(rng, 150, 235)) if rng.random() < 0.6 else palette.black(rng)
    r, t = across / 2, across * 0.42
    parts.add(lathe([[(t, 0.0), (r, 0.0)], [(r, 0.0), (r, height)], [(r, height), (1e-3, height)]], segments=20), skin)
    parts.add(
        lathe([[(1e-3, height - 0.003), (t, height - 0.003)], [(t, height - 0.003), (t, 0.0)]], segments=20), inside
    )
    parts.add(
        solid_of_revolution([(t * 0.9, height - 0.009), (t * 0.9, height - 0.006)], segments=18), palette.opal(rng)
    )
    return parts.mesh()


def downlights(rng: np.random.Generator) -> Draft:
    """Make a 2 x 2 grid or a row of downlights as one model."""
    columns, rows = ((2, 2), (3, 1), (3, 2), (4, 1))[int(rng.integers(4))]
    pitch, across = uniform(rng, 0.6, 1.0), uniform(rng, 0.08, 0.105)
    width, depth = (columns - 1) * pitch + across, (rows - 1) * pitch + across
    places = [
        ((x - (columns - 1) / 2) * pitch, (z - (rows - 1) / 2) * pitch) for x in range(columns) for z in range(rows)
    ]

    def build() -> Mesh:
        mesh = _downlight(rng, across)
        parts = Parts()
        for x, z in places:
            parts.add_mesh(mesh, (x, 0, z))
        return parts.mesh()

    lights = tuple(light_source(x, _PROTRUSION_M - 0.0045, z, 0.02) for x, z in places)
    return Draft("downlights", (width, _PROTRUSION_M, depth), build, lights=lights)


def ceiling_fan(rng: np.random.Generator) -> Draft:
    """Make a fan with three to five blades, usually with a lamp below."""
    blades = int(rng.integers(3, 6))
    across, height = uniform(rng, 0.95, 1.35), uniform(rng, 0.3, 0.5)
    lamp = rng.random() < 0.7
    ends = np.array([[across / 2, 0.0, side] for side in (-0.065, 0.065)])
    corners = np.concatenate([_tilted(ends, 0, 360 * k / blades + 90) for k in range(blades)])
    low_corner, high_corner = corners.min(0), corners.max(0)
    middle = (low_corner + high_corner) / 2
    size = (float(high_corner[0] - low_corner[0]), height, float(high_corner[2] - low_corner[2]))
    lights: tuple[LightSource, ...] = (light_source(-middle[0], 0.07, -middle[2], 0.05),) if lamp else ()

    def build() -> Mesh:
        parts = Parts()
        metal = palette.metal(rng)
        blade = palette.wood_or_paint(rng, 0.6)
        low = 0.13 if lamp else 0.0
        parts.add(
            solid_of_revolution([(0.06, low), (0.1, low + 0.02), (0.1, low + 0.08), (0.05, low + 0.11)], segments=18),
            metal,
        )
        parts.add(solid_of_revolution([(0.03, height - 0.04), (0.06, height)], segments=14), metal)
        parts.bar(metal, (0, low + 0.1, 0), (0, height - 0.03, 0), 0.013)
        if lamp:
            parts.add(
                lathe(
                    [
                        [
                            (max(0.1 * float(np.sin(t)), 1e-3), 0.1 * (1 - float(np.cos(t))))
                            for t in np.linspace(0, np.pi / 2, 6)
                        ],
                        [(0.1, 0.1), (0.1, 0.13)],
                        [(0.1, 0.13), (1e-3, 0.13)],
                    ],
                    segments=18,
                ),
                palette.opal(rng),
            )
        for k in range(blades):
            angle = 360.0 * k / blades
            reach = across / 2
            grid = np.array(
                [
                    [[0.1 + (reach - 0.1) * t, low + 0.05 + 0.006 * s, 0.065 * s * (0.7 + 0.3 * t)] for s in (1, -1)]
                    for t in (0.0, 0.15, 0.9, 1.0)
                ],
                np.float32,
            )
            parts.add(double_sided_sheet(grid, thickness=0.008), blade, yaw=angle + 90)
        return parts.mesh()

    return Draft("ceiling fan", size, build, lights=lights)
