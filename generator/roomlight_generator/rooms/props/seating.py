"""Sofas, armchairs, chairs, stools, benches."""

from functools import partial

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, circle_points, uniform
from roomlight_generator.rooms.scene import Material, Mesh
from roomlight_generator.rooms.shapes import Number, cushion, double_sided_sheet, lathe, loft, tube


def add_cushion(
    parts: Parts,
    material: Material,
    size: tuple[Number, Number, Number],
    at: tuple[Number, Number, Number],
    *,
    plump: Number = 0.15,
    pitch: Number = 0,
    yaw: Number = 0,
) -> None:
    """Add a cushion of (width, thickness, depth) with the centre of its underside at `at`."""
    shape = cushion(*size, plump=plump, radius=min(0.06, size[1] * 0.4), step=max(size[0], size[2]) / 3, arcs=1)
    parts.add(shape, material, at, pitch=pitch, yaw=yaw)


def add_legs(
    parts: Parts,
    material: Material,
    size: tuple[Number, Number],
    height: Number,
    *,
    thickness: Number = 0.02,
    splay: Number = 0.0,
    square: bool = False,
    middle: tuple[Number, Number] = (0, 0),
) -> None:
    """Add four legs under the corners of a rectangle (width, depth), from the floor up to `height`."""
    (half_x, half_z), (x0, z0) = (size[0] / 2, size[1] / 2), middle
    for x in (-1, 1):
        for z in (-1, 1):
            if square:
                parts.slab(
                    material, (2 * thickness, height, 2 * thickness), (x0 + x * half_x, 0, z0 + z * half_z), radius=0
                )
            else:
                foot = (x0 + x * (half_x + splay), 0, z0 + z * (half_z + splay))
                parts.bar(material, foot, (x0 + x * half_x, height, z0 + z * half_z), thickness * 0.7, thickness)


def sofa(rng: np.random.Generator) -> Draft:
    """Make a sofa with two to four seats, straight or with a chaise; boxy, round-armed, on legs, or a wooden frame."""
    seats = int(rng.choice([2, 2, 3, 3, 4]))
    arm = uniform(rng, 0.08, 0.26)
    seat_width = uniform(rng, 0.56, 0.8) if seats < 4 else uniform(rng, 0.55, 0.62)
    width = seats * seat_width + 2 * arm
    depth, height = uniform(rng, 0.82, 1.02), uniform(rng, 0.72, 0.95)
    chaise = uniform(rng, 0.5, 0.75) if seats >= 3 and rng.random() < 0.4 else 0.0
    side = 1 if rng.random() < 0.5 else -1

    def build() -> Mesh:
        parts = Parts()
        body = palette.upholstery(rng)
        covers = body if rng.random() < 0.75 else palette.cloth(rng)
        leg = uniform(rng, 0.03, 0.17)
        seat_top = uniform(rng, 0.4, 0.47)
        thickness = uniform(rng, 0.13, 0.2)
        arm_top = uniform(rng, 0.52, min(0.68, height - 0.08))
        back_z = -(depth + chaise) / 2
        round_arm = uniform(rng, 0.02, 0.11)
        base = seat_top - thickness + 0.03
        parts.slab(body, (width, base - leg, depth - 0.06), (0, leg, back_z + depth / 2 - 0.01), radius=0.03)
        back = uniform(rng, 0.16, 0.24)
        parts.slab(body, (width, height - leg - 0.06, back), (0, leg, back_z + back / 2), radius=0.06, arcs=2)
        for x in (-1, 1):
            size = (arm, arm_top - leg, depth)
            parts.slab(body, size, (x * (width - arm) / 2, leg, back_z + depth / 2), radius=round_arm, arcs=2)
        foot = palette.wood(rng) if rng.random() < 0.6 else palette.metal(rng)
        add_legs(
            parts,
            foot,
            (width - 0.2, depth - 0.2),
            leg + 0.02,
            thickness=uniform(rng, 0.015, 0.03),
            middle=(0, back_z + depth / 2),
            square=rng.random() < 0.4,
        )
        front = back_z + depth
        inner = width - 2 * arm
        part_width = inner / seats
        for k in range(seats):
            x = -inner / 2 + part_width * (k + 0.5)
            long = chaise if chaise and (k == seats - 1) == (side > 0) and k in (0, seats - 1) else 0.0
            depth_m = depth - back - 0.02 + long
            if long:
                parts.slab(
                    body,
                    (part_width + arm * 0.6, base - leg, long + 0.1),
                    (x, leg, front + long / 2 - 0.05),
                    radius=0.03,
                )
                parts.slab(foot, (0.05, leg + 0.01, 0.05), (x, 0, front + long - 0.12), radius=0)
            add_cushion(
                parts,
                covers,
                (part_width - 0.008, thickness, depth_m),
                (x, seat_top - thickness, front - depth_m / 2 + long),
                plump=0.14,
            )
            height_m = height - seat_top + uniform(rng, -0.02, 0.04)
            middle = (seat_top + height) / 2 - 0.01
            shape = cushion(part_width - 0.02, 0.2, height_m, plump=0.35, radius=0.07, step=0.25, arcs=1)
            lean = uniform(rng, 10, 16)
            parts.add(shape, covers, (x, middle + 0.02, back_z + back + 0.01), pitch=90 - lean)
        for _ in range(int(rng.integers(0, 4))):
            pillow = palette.cloth(rng, patterned=0.4)
            across = min(uniform(rng, 0.36, 0.5), (height - seat_top) * 1.04)
            shape = cushion(across, 0.16, across, plump=0.85, radius=0.06, step=0.15, arcs=1)
            x = uniform(rng, -inner / 2 + 0.22, inner / 2 - 0.22)
            parts.add(
                shape,
                pillow,
                (x, seat_top + across * 0.46, back_z + back + 0.24),
                pitch=90 - uniform(rng, 18, 34),
                yaw=uniform(rng, -18, 18),
            )
        if rng.random() < 0.2:
            throw = palette.cloth(rng, patterned=0.5)
            x = uniform(rng, -inner / 3, inner / 3)
            path = [
                (seat_top + 0.02, front + 0.012),
                (seat_top + 0.025, front - 0.3),
                (height + 0.03, back_z + back + 0.06),
                (height + 0.02, back_z + 0.01),
            ]
            grid = np.array([[[x + across, y, z] for across in (-0.3, 0.0, 0.3)] for y, z in path], np.float32)
            parts.add(double_sided_sheet(grid, thickness=0.012), throw)
        return parts.mesh()

    return Draft("sofa", (width, height + 0.03, depth + chaise), build)


def armchair(rng: np.random.Generator) -> Draft:
    """Make an armchair: upholstered box, wooden frame, wing back or a round shell."""
    kind = int(rng.integers(4))
    width, depth = uniform(rng, 0.66, 0.95), uniform(rng, 0.72, 0.95)
    height = uniform(rng, 0.95, 1.12) if kind == 2 else uniform(rng, 0.7, 0.95)
    return Draft("armchair", (width, height, depth), partial(_armchair, rng, kind, width, height, depth))


def _armchair(rng: np.random.Generator, kind: int, width: Number, height: Number, depth: Number) -> Mesh:
    parts = Parts()
    body = palette.upholstery(rng)
    foot = palette.wood(rng) if rng.random() < 0.7 else palette.metal(rng)
    seat_top, thickness = uniform(rng, 0.4, 0.46), uniform(rng, 0.12, 0.18)
    if kind == 3:
        back, arms = height, uniform(rng, 0.55, 0.68)
        rise = seat_top - 0.08
        angle = np.linspace(-0.75 * np.pi, 0.75 * np.pi, 17)
        lift = arms + (back - arms) * np.clip(np.cos(angle * 0.62), 0, 1) ** 1.5
        rows: list[np.ndarray] = []
        for t in np.linspace(0, 1, 4):
            spread = 0.8 + 0.2 * t
            rows.append(
                np.stack(
                    [
                        width / 2 * spread * np.sin(angle) * 0.95,
                        rise - 0.1 + (lift - rise + 0.1) * t,
                        -depth / 2 * spread * np.cos(angle) * 0.95,
                    ],
                    1,
                )
            )
        parts.add(double_sided_sheet(np.array(rows, np.float32), thickness=0.05), body)
        parts.add(
            loft(
                [
                    [(1e-3, 1e-3, 0.0), (width * 0.42, depth * 0.42, 0.0)],
                    [
                        (width * 0.42, depth * 0.42, 0.0),
                        (width * 0.45, depth * 0.45, 0.06),
                        (width * 0.42, depth * 0.42, 0.12),
                    ],
                    [(width * 0.42, depth * 0.42, 0.12), (1e-3, 1e-3, 0.13)],
                ],
                segments=20,
            ),
            body,
            (0, seat_top - 0.13, 0.03),
        )
        if rng.random() < 0.5:
            add_legs(parts, foot, (width * 0.5, depth * 0.5), rise, splay=0.08)
        else:
            parts.bar(foot, (0, 0.02, 0), (0, rise, 0), 0.03)
            parts.bar(foot, (0, 0, 0), (0, 0.02, 0), width * 0.34, segments=20)
        return parts.mesh()
    if kind == 1:
        bar = uniform(rng, 0.014, 0.022)
        arm_top = uniform(rng, 0.54, 0.62)
        for x in (-1, 1):
            edge = x * (width / 2 - 0.025)
            parts.bar(foot, (edge, 0, depth / 2 - 0.04), (edge, arm_top, depth / 2 - 0.09), bar * 0.8, bar)
            parts.bar(foot, (edge, 0, -depth / 2 + 0.02), (edge, arm_top, -depth / 2 + 0.12), bar * 0.8, bar)
            parts.slab(foot, (0.05, 0.028, depth - 0.04), (edge, arm_top - 0.01, 0))
            parts.bar(foot, (edge, 0.27, depth / 2 - 0.06), (edge, 0.24, -depth / 2 + 0.06), bar)
            parts.bar(foot, (0.6 * edge, 0.27, -depth / 2 + 0.2), (0.6 * edge, height, -depth / 2 + 0.012), bar * 0.8)
        for z in (-depth / 2 + 0.1, depth / 2 - 0.1):
            parts.bar(foot, (-width / 2 + 0.02, 0.26, z), (width / 2 - 0.02, 0.26, z), bar)
        add_cushion(parts, body, (width - 0.1, thickness, depth - 0.1), (0, seat_top - thickness, 0.03), pitch=4)
        shape = cushion(width - 0.12, 0.14, height - 0.36, plump=0.2, radius=0.06, step=0.25, arcs=1)
        parts.add(shape, body, (0, (height + 0.4) / 2, -depth / 2 + 0.12), pitch=90 - 15)
        return parts.mesh()
    leg = uniform(rng, 0.06, 0.18)
    arm = uniform(rng, 0.09, 0.17)
    arm_top = uniform(rng, 0.54, 0.64)
    back = 0.17
    parts.slab(body, (width - 0.02, seat_top - thickness - leg + 0.02, depth - 0.05), (0, leg, 0), radius=0.03)
    parts.slab(body, (width - 0.01, height - leg, back), (0, leg, -depth / 2 + back / 2), radius=0.06, arcs=2)
    for x in (-1, 1):
        place = (x * (width - arm) / 2, leg, 0)
        parts.slab(body, (arm, arm_top - leg, depth), place, radius=min(0.05, arm * 0.4), arcs=2)
        if kind == 2:
            wing = (0.07, height - arm_top - 0.03, depth * 0.36)
            parts.slab(body, wing, (x * (width / 2 - 0.05), arm_top - 0.04, -depth * 0.31), radius=0.03, yaw=x * -14)
    add_cushion(
        parts,
        body,
        (width - 2 * arm - 0.01, thickness, depth - back - 0.01),
        (0, seat_top - thickness, back / 2),
        plump=0.15,
    )
    shape = cushion(width - 2 * arm - 0.02, 0.14, height - seat_top - 0.02, plump=0.3, step=0.25, arcs=1)
    parts.add(shape, body, (0, (height + seat_top) / 2, -depth / 2 + back), pitch=90 - 9)
    add_legs(parts, foot, (width - 0.14, depth - 0.14), leg + 0.02, thickness=0.022, splay=0.02)
    return parts.mesh()


def chair(rng: np.random.Generator) -> Draft:
    """Make a chair: wood with slats, ladder or spindles; a plastic shell; upholstered; bent metal."""
    width, depth = uniform(rng, 0.4, 0.54), uniform(rng, 0.44, 0.58)
    height = uniform(rng, 0.78, 1.02)
    return Draft("chair", (width, height, depth), partial(_chair, rng, width, height, depth))


def _chair(rng: np.random.Generator, width: Number, height: Number, depth: Number) -> Mesh:
    parts = Parts()
    kind = int(rng.integers(5))
    seat = uniform(rng, 0.44, 0.48)
    frame = palette.metal(rng) if kind == 4 else palette.wood_or_paint(rng, 0.75)
    lean = 0.06
    if kind == 2:
        shell = palette.plastic(rng) if rng.random() < 0.6 else palette.upholstery(rng)
        rows: list[np.ndarray] = []
        across = np.linspace(-1, 1, 7)
        profile = [
            (depth / 2, seat - 0.03),
            (depth * 0.3, seat),
            (-depth * 0.1, seat - 0.03),
            (-depth * 0.34, seat),
            (-depth * 0.42, seat + 0.1),
            (-depth * 0.46, (seat + height) / 2),
            (-depth / 2, height - 0.01),
        ]
        for k, (z, y) in enumerate(profile):
            half = width / 2 * (0.98 if k < 4 else 0.98 - 0.06 * (k - 3) ** 1.3)
            curl = 0.05 * across**2
            upright = np.clip((k - 2) / 3, 0, 1)
            rows.append(np.stack([half * across, y + curl * (1 - upright), z + curl * upright * 1.6], 1))
        parts.add(double_sided_sheet(np.array(rows, np.float32), thickness=uniform(rng, 0.012, 0.03)), shell)
        under = palette.wood(rng) if rng.random() < 0.5 else palette.metal(rng)
        add_legs(parts, under, (width * 0.4, depth * 0.35), seat - 0.02, thickness=0.014, splay=0.11)
        return parts.mesh()
    bar = uniform(rng, 0.013, 0.02)
    half_x, half_z = width / 2 - bar, depth / 2 - bar - 0.01
    square = rng.random() < 0.5 and kind != 4
    for x in (-1, 1):
        if square:
            parts.slab(frame, (2 * bar, seat, 2 * bar), (x * half_x, 0, half_z), radius=0)
        else:
            parts.bar(frame, (x * half_x, 0, half_z + 0.01), (x * half_x, seat, half_z), bar * 0.75, bar)
        parts.bar(frame, (x * half_x, 0, -half_z), (x * half_x, seat, -half_z + lean), bar * 0.8, bar)
        parts.bar(
            frame, (x * half_x, seat - 0.02, -half_z + lean), (x * half_x, height - 0.01, -half_z), bar, bar * 0.8
        )
        parts.bar(frame, (x * half_x, 0.2, half_z), (x * half_x, 0.2, -half_z + 0.02), bar * 0.6, segments=6)
    cover = palette.upholstery(rng)
    if kind == 3 or rng.random() < 0.35:
        parts.slab(frame, (width - 0.02, 0.05, depth - 0.07), (0, seat - 0.06, 0.03), radius=0)
        add_cushion(parts, cover, (width, 0.05, depth - 0.04), (0, seat - 0.015, 0.02), plump=0.25)
    else:
        parts.slab(frame, (width, 0.025, depth - 0.03), (0, seat - 0.01, 0.015), radius=0.01)
    low, span = seat + 0.12, height - seat - 0.12

    def at_height(y: Number) -> float:
        return -half_z + lean * (1 - (y - seat) / max(height - seat, 0.1))

    if kind == 0:
        for k in range(int(rng.integers(2, 5))):
            y = low + span * (k + 0.2) / 4.2
            parts.slab(frame, (width - 0.03, span * 0.14, 0.016), (0, y, at_height(y)), radius=0)
        parts.slab(frame, (width - 0.02, 0.06, 0.02), (0, height - 0.06, at_height(height)), radius=0.006)
    elif kind == 1:
        parts.slab(frame, (width - 0.02, 0.055, 0.022), (0, height - 0.055, at_height(height)), radius=0.008)
        for x in np.linspace(-0.75, 0.75, int(rng.integers(4, 8))) * half_x:
            parts.bar(frame, (x, seat, at_height(seat)), (x, height - 0.03, at_height(height)), 0.007, segments=6)
    elif kind == 3:
        shape = cushion(width - 0.01, 0.06, span + 0.08, plump=0.25, radius=0.025, step=0.2, arcs=1)
        parts.add(shape, cover, (0, low + span / 2 - 0.04, at_height(low) - 0.01), pitch=90 - 7)
    else:
        panel = palette.wood(rng) if rng.random() < 0.5 else frame
        parts.slab(
            panel, (width - 0.01, span * 0.55, 0.018), (0, height - span * 0.55, at_height(height)), radius=0.006
        )
    return parts.mesh()


def office_chair(rng: np.random.Generator) -> Draft:
    """Make an office chair: a star base with castors, a column, a padded seat and back, usually with arms."""
    width, height = uniform(rng, 0.6, 0.7), uniform(rng, 0.88, 1.22)
    depth = width * uniform(rng, 0.93, 0.99)

    def build() -> Mesh:
        parts = Parts()
        hard = palette.black(rng) if rng.random() < 0.7 else palette.chrome(rng)
        soft = palette.upholstery(rng)
        seat = uniform(rng, 0.45, 0.52)
        for x, z in circle_points(5, width / 2 - 0.03, 0.3):
            parts.bar(hard, (0, 0.11, 0), (x, 0.075, z), 0.024, 0.014)
            parts.slab(hard, (0.05, 0.06, 0.05), (x, 0, z), radius=0.02)
        parts.bar(hard, (0, 0.08, 0), (0, seat - 0.06, 0), 0.027)
        parts.slab(hard, (0.24, 0.04, 0.24), (0, seat - 0.1, 0), radius=0)
        add_cushion(parts, soft, (width * 0.78, 0.09, depth * 0.74), (0, seat - 0.08, 0.02), plump=0.2)
        height_m = height - seat - 0.08
        shape = cushion(width * 0.72, 0.08, height_m, plump=0.3, radius=0.04, step=0.22, arcs=1)
        parts.add(shape, soft, (0, seat + 0.08 + height_m / 2, -depth * 0.36), pitch=90 - 8)
        parts.slab(hard, (0.07, 0.3, 0.02), (0, seat - 0.08, -depth * 0.36), radius=0)
        if rng.random() < 0.75:
            for x in (-1, 1):
                edge = x * width * 0.43
                parts.bar(hard, (x * width * 0.3, seat - 0.07, 0), (edge, seat + 0.02, -0.02), 0.015)
                parts.bar(hard, (edge, seat, -0.02), (edge, seat + 0.2, -0.04), 0.016)
                parts.slab(hard, (0.07, 0.03, 0.26), (edge, seat + 0.2, 0), radius=0.012)
        return parts.mesh()

    return Draft("office chair", (width, height, depth), build)


def stool(rng: np.random.Generator) -> Draft:
    """Make a low stool, a bar stool, or a pouffe."""
    kind = int(rng.integers(4))
    across = uniform(rng, 0.3, 0.42)
    height = (uniform(rng, 0.42, 0.5), uniform(rng, 0.62, 0.78), uniform(rng, 0.36, 0.45), uniform(rng, 0.42, 0.8))[
        kind
    ]
    if kind == 2:
        across = uniform(rng, 0.42, 0.6)

    def build() -> Mesh:
        parts = Parts()
        if kind == 2:
            rise = [(across * (0.46 + 0.04 * np.sin(np.pi * t)), float(height * t)) for t in np.linspace(0, 1, 6)]
            lines = [[(1e-3, 0), rise[0]], rise, [rise[-1], (across * 0.3, height + 0.01), (1e-3, height + 0.012)]]
            parts.add(lathe(lines, segments=24), palette.upholstery(rng))
            return parts.mesh()
        frame = palette.wood(rng) if rng.random() < 0.6 else palette.metal(rng)
        top = palette.upholstery(rng) if rng.random() < 0.4 else frame
        if kind == 3:
            parts.bar(frame, (0, 0, 0), (0, 0.02, 0), across / 2, segments=20)
            parts.bar(frame, (0, 0.02, 0), (0, height - 0.04, 0), 0.025)
        else:
            spread = across * 0.32
            for x, z in circle_points(int(rng.choice([3, 4])), spread, 0.785):
                parts.bar(frame, (x * 1.45, 0, z * 1.45), (x, height - 0.03, z), 0.012, 0.016)
            ring = [(x, height * 0.32, z) for x, z in circle_points(16, spread * 1.28)]
            parts.add(tube([*ring, ring[0]], 0.008, segments=6), frame)
        if rng.random() < 0.6:
            half = across / 2
            parts.add(
                lathe(
                    [
                        [(1e-3, 0), (half * 0.94, 0)],
                        [(half * 0.94, 0), (half, 0.02), (half * 0.95, 0.045)],
                        [(half * 0.95, 0.045), (1e-3, 0.05)],
                    ],
                    segments=22,
                ),
                top,
                (0, height - 0.05, 0),
            )
        else:
            parts.slab(top, (across, 0.045, across), (0, height - 0.045, 0), radius=0.015)
        return parts.mesh()

    return Draft("stool", (across, height, across), build)


def bench(rng: np.random.Generator) -> Draft:
    """Make a bench of wood, padded, or with a shelf for shoes."""
    width, depth, height = uniform(rng, 0.8, 1.6), uniform(rng, 0.32, 0.45), uniform(rng, 0.42, 0.5)

    def build() -> Mesh:
        parts = Parts()
        frame = palette.wood_or_paint(rng, 0.7)
        padded_top = rng.random() < 0.5
        top = height - (0.07 if padded_top else 0.0)
        parts.slab(frame, (width, 0.035, depth), (0, top - 0.035, 0), radius=0.006)
        if padded_top:
            add_cushion(
                parts, palette.upholstery(rng), (width - 0.02, 0.08, depth - 0.02), (0, top - 0.01, 0), plump=0.15
            )
        if rng.random() < 0.5:
            metal = palette.metal(rng) if rng.random() < 0.5 else frame
            add_legs(parts, metal, (width - 0.14, depth - 0.1), top - 0.03, thickness=0.02, square=rng.random() < 0.5)
        else:
            for x in (-1, 1):
                parts.slab(frame, (0.03, top - 0.03, depth - 0.02), (x * (width / 2 - 0.03), 0, 0))
            parts.slab(frame, (width - 0.06, 0.02, depth - 0.04), (0, 0.14, 0), radius=0)
        return parts.mesh()

    return Draft("bench", (width, height, depth), build, top_m=height)
