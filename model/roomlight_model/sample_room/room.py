"""The sample room: a living room of 5 x 4 x 2.7 m, furnished and lit.

Frames: world, y up, metres, the floor's middle at the origin; the window looks north (-z), the sofa stands
against the petrol wall in the west (-x), shelf and television in the east (+x), the door is in the south (+z).
Levels: radiance relative to the frames' white. The sky is 5 to 10 (hills, trees and lawn outside 0.2 to 1), the
globe 27, the lampshade's side 2.5 and its open ends 10, the lit screen up to 1.5.
"""

import numpy as np

from roomlight_model.sample_room import furniture, textures
from roomlight_model.sample_room.light import DiscLight, GlobeLight, ShadeLight, Sky, SunLight, WindowLight
from roomlight_model.sample_room.scene import Material, Scene
from roomlight_model.sample_room.shapes import Mesh, box, lathe, moved, rectangle, rod, sphere
from roomlight_model.sample_room.textures import srgb

HALF_X_M, HALF_Z_M, HEIGHT_M = 2.5, 2.0, 2.7
WINDOW_X_M, WINDOW_Y_M = (-0.40, 1.20), (0.84, 2.22)
REVEAL_M = 0.22
GLOBE = (-0.30, 1.98, -0.40)
GLOBE_RADIUS_M = 0.15
LAMP = (1.90, -1.47)
SHADE_RADIUS_M, SHADE_HEIGHT_M, SHADE_BOTTOM_M = 0.19, 0.25, 1.36

GLOBE_RADIANCE = (30.0, 26.8, 22.0)
SHADE_RADIANCE = (3.4, 2.4, 1.4)
SHADE_END_RADIANCE = (13.0, 9.4, 5.8)
SUN_IRRADIANCE = (15.0, 13.2, 10.2)
SUN_DIRECTION = (0.30, 0.66, -0.69)


def build_room(*, seed: int = 7, detail_m: float = 0.085) -> Scene:
    """The furnished room; `detail_m` is the step of the light cache on walls and floor."""
    rng = np.random.default_rng([seed, 0])
    sun = np.array(SUN_DIRECTION) / np.linalg.norm(SUN_DIRECTION)
    sky = Sky(sun_direction=(float(sun[0]), float(sun[1]), float(sun[2])), sun_irradiance=SUN_IRRADIANCE)
    shade_middle = SHADE_BOTTOM_M + SHADE_HEIGHT_M / 2
    lights = (
        WindowLight(sky, WINDOW_X_M, WINDOW_Y_M, -HALF_Z_M - REVEAL_M, samples=6),
        SunLight(sky, samples=1),
        GlobeLight(GLOBE, GLOBE_RADIUS_M, GLOBE_RADIANCE, samples=2),
        ShadeLight((LAMP[0], shade_middle, LAMP[1]), SHADE_RADIUS_M, SHADE_HEIGHT_M, SHADE_RADIANCE, samples=2),
        DiscLight((LAMP[0], SHADE_BOTTOM_M, LAMP[1]), SHADE_RADIUS_M, SHADE_END_RADIANCE, up=False, samples=2),
        DiscLight(
            (LAMP[0], SHADE_BOTTOM_M + SHADE_HEIGHT_M, LAMP[1]), SHADE_RADIUS_M, SHADE_END_RADIANCE, up=True, samples=2
        ),
    )
    meshes = [*_shell(detail_m), *_window(rng), *_furnish(rng), *_lamps()]
    return Scene.build(meshes, _materials(rng), lights=lights, sky=sky)


def _materials(rng: np.random.Generator) -> dict[str, Material]:
    white = (1.0, 1.0, 1.0)
    return {
        "wall": Material(srgb(237, 231, 219)),
        "accent": Material(srgb(66, 121, 128)),
        "ceiling": Material(srgb(244, 243, 238)),
        "floor": Material(white, textures.planks(rng, height=1344, width=1680), (5.0, 4.0), gloss=0.9, roughness=0.03),
        "trim": Material(srgb(224, 220, 211)),
        "oak": Material(white, textures.wood(rng, srgb(188, 144, 98)), (1.1, 0.3)),
        "table": Material(white, textures.wood(rng, srgb(166, 112, 68)), (1.2, 0.35), gloss=0.9, roughness=0.03),
        "walnut": Material(white, textures.wood(rng, srgb(118, 78, 52)), (1.1, 0.3)),
        "cloth": Material(white, textures.cloth(rng), (0.32, 0.32)),
        "stripes": Material(white, textures.stripes(rng), (0.4, 0.4)),
        "linen": Material(srgb(226, 220, 208), textures.cloth(rng, contrast=0.1), (0.3, 0.3)),
        "rug": Material(white, textures.rug(rng)),
        "paint": Material(white),
        "paper": Material(srgb(236, 230, 214)),
        "ceramic": Material(white, gloss=1.0, roughness=0.05),
        "leaf": Material(white),
        "brass": Material(srgb(176, 134, 72), gloss=3.0, roughness=0.15),
        "black": Material(srgb(30, 30, 32), gloss=0.8, roughness=0.06),
        "hills": Material(white, textures.print_hills(rng)),
        "shapes": Material(white, textures.print_shapes(rng)),
        "branch": Material(white, textures.print_leaf(rng)),
        "screen": Material((0.02, 0.02, 0.02), textures.screen(rng), emission=(1.5, 1.5, 1.6), textured_emission=True),
        "globe": Material((0.7, 0.7, 0.7), emission=GLOBE_RADIANCE, found_by_samples=True),
        "shade-side": Material((0.5, 0.45, 0.38), emission=SHADE_RADIANCE, found_by_samples=True),
        "shade-end": Material((0.5, 0.45, 0.38), emission=SHADE_END_RADIANCE, found_by_samples=True),
    }


def _shell(step: float) -> list[Mesh]:
    """Floor, ceiling, four walls (the north one with its opening and reveal), skirting and cornice."""
    x, z, h = HALF_X_M, HALF_Z_M, HEIGHT_M
    x0, x1 = WINDOW_X_M
    y0, y1 = WINDOW_Y_M
    opening = (x0 + x, x1 + x, y0, y1)
    back = -z - REVEAL_M
    parts = [
        rectangle((-x, 0, z), (2 * x, 0, 0), (0, 0, -2 * z), step=step).of("floor"),
        rectangle((-x, h, -z), (2 * x, 0, 0), (0, 0, 2 * z), step=step).of("ceiling"),
        rectangle((-x, 0, -z), (2 * x, 0, 0), (0, h, 0), step=step, hole=opening).of("wall"),
        rectangle((x, 0, z), (-2 * x, 0, 0), (0, h, 0), step=step).of("wall"),
        rectangle((-x, 0, z), (0, 0, -2 * z), (0, h, 0), step=step).of("accent"),
        rectangle((x, 0, -z), (0, 0, 2 * z), (0, h, 0), step=step).of("wall"),
        rectangle((x0, y0, -z), (x1 - x0, 0, 0), (0, 0, back + z), step=step).of("trim"),
        rectangle((x0, y1, back), (x1 - x0, 0, 0), (0, 0, -z - back), step=step).of("trim"),
        rectangle((x0, y0, -z), (0, 0, back + z), (0, y1 - y0, 0), step=step).of("trim"),
        rectangle((x1, y0, back), (0, 0, -z - back), (0, y1 - y0, 0), step=step).of("trim"),
    ]
    for turn, half, reach in ((0, x, z), (180, x, z), (90, z, x), (270, z, x)):
        skirting = box(2 * half, 0.085, 0.016, radius=0.005).moved(0, 0, -reach + 0.007)
        cornice = box(2 * half, 0.05, 0.05, radius=0.012).moved(0, h - 0.047, -reach + 0.022)
        parts += [skirting.turned(turn).of("trim"), cornice.turned(turn).of("ceiling")]
    return parts


def _window(rng: np.random.Generator) -> list[Mesh]:
    """Frame, mullion and transom, sill, rail and curtains."""
    x0, x1 = WINDOW_X_M
    y0, y1 = WINDOW_Y_M
    width, height, middle = x1 - x0, y1 - y0, (x0 + x1) / 2
    z = -HALF_Z_M - 0.13
    bar, deep = 0.06, 0.06
    parts = [
        box(width, bar, deep).moved(middle, y0, z),
        box(width, bar, deep).moved(middle, y1 - bar, z),
        box(bar, height, deep).moved(x0 + bar / 2, y0, z),
        box(bar, height, deep).moved(x1 - bar / 2, y0, z),
        box(0.07, height, deep + 0.01).moved(middle, y0, z),
        box(width, 0.04, deep - 0.01).moved(middle, y0 + height * 0.7, z),
        box(width + 0.16, 0.03, 0.2, radius=0.008).moved(middle, y0 - 0.03, -HALF_Z_M + 0.06),
    ]
    parts = [part.of("trim") for part in parts]
    rail = rod((x0 - 0.62, 2.40, -HALF_Z_M + 0.10), (x1 + 0.56, 2.40, -HALF_Z_M + 0.10), 0.012).of("brass")
    left = moved(furniture.curtain(rng, width=0.56, height=2.39), x0 - 0.24, 0, -HALF_Z_M + 0.11)
    right = moved(furniture.curtain(rng, width=0.46, height=2.39, folds=6), x1 + 0.22, 0, -HALF_Z_M + 0.11)
    pot = lathe([[(1e-4, 0), (0.045, 0)], [(0.045, 0), (0.06, 0.1)], [(0.06, 0.1), (1e-4, 0.095)]])
    herbs = [
        sphere(0.035, rings=6, segments=8).moved(*(rng.normal(0, 0.03, 3) * (1, 0.7, 1) + (0, 0.15, 0)))
        for _ in range(16)
    ]
    sill = [pot.of("ceramic", srgb(188, 96, 62)), *(ball.of("leaf", srgb(92, 130, 66)) for ball in herbs)]
    return [*parts, rail, *left, *right, *moved(sill, x0 + 0.28, y0, -HALF_Z_M + 0.04)]


def _furnish(rng: np.random.Generator) -> list[Mesh]:
    mustard, rust, petrol = srgb(206, 152, 58), srgb(172, 80, 52), srgb(52, 94, 106)
    accents = [("cloth", mustard), ("stripes", (1.0, 1.0, 1.0)), ("cloth", rust)]
    rug_half_x, rug_half_z = 1.2, 0.82
    edge_x, edge_z = (2 * rug_half_x, 0, 0), (0, 0, -2 * rug_half_z)
    weave = rectangle((-rug_half_x, 0.0125, rug_half_z), edge_x, edge_z, step=0.085, unit_uv=True)
    rug = [weave.of("rug"), box(2 * rug_half_x, 0.012, 2 * rug_half_z, radius=0.005).of("cloth", srgb(231, 220, 199))]
    west, east, south = -HALF_X_M, HALF_X_M, HALF_Z_M
    return [
        *moved(rug, -0.32, 0, 0.12),
        *moved(furniture.sofa(srgb(206, 194, 174), accents), west + 0.52, 0, 0.18, degrees=90),
        *moved(furniture.coffee_table(rng), -0.42, 0.0125, 0.12, degrees=90),
        *moved(furniture.armchair(srgb(164, 78, 52), ("cloth", petrol)), 1.42, 0, -1.22, degrees=-38),
        *moved(furniture.bookshelf(rng), east - 0.16, 0, -0.32, degrees=-90),
        *moved(furniture.cabinet(), east - 0.24, 0, 1.10, degrees=-90),
        *moved(furniture.television(), east - 0.24, 0.5, 1.10, degrees=-90),
        *moved(furniture.plant(rng), west + 0.42, 0, -1.52),
        *moved(furniture.picture("hills", width=0.5, height=0.68), west, 1.55, 0.56, degrees=90),
        *moved(furniture.picture("shapes", width=0.5, height=0.68), west, 1.55, -0.10, degrees=90),
        *moved(furniture.picture("branch", width=0.62, height=0.46), east, 1.72, 1.10, degrees=-90),
        *moved(furniture.door(), -1.55, 0, south, degrees=180),
        *moved(furniture.cabinet(width=1.3, height=0.78, depth=0.36, doors=2), 0.7, 0, south - 0.2, degrees=180),
        *moved(furniture.vase(0.34, srgb(60, 104, 112)), 0.35, 0.78, south - 0.2),
        *moved(furniture.vase(0.2, srgb(214, 160, 84)), 0.62, 0.78, south - 0.22),
        *moved(furniture.picture("hills", width=0.52, height=0.7), 0.75, 1.6, south, degrees=180),
    ]


def _lamps() -> list[Mesh]:
    globe_top = GLOBE[1] + GLOBE_RADIUS_M
    cap = lathe([[(0.05, 0.0), (0.045, 0.04), (0.01, 0.06)]]).moved(GLOBE[0], globe_top - 0.012, GLOBE[2])
    lamp = furniture.floor_lamp(radius=SHADE_RADIUS_M, height=SHADE_HEIGHT_M, bottom=SHADE_BOTTOM_M)
    return [
        sphere(GLOBE_RADIUS_M, rings=32, segments=64).moved(*GLOBE).of("globe"),
        cap.of("brass"),
        rod((GLOBE[0], globe_top + 0.03, GLOBE[2]), (GLOBE[0], HEIGHT_M, GLOBE[2]), 0.005).of("black"),
        lathe([[(0.06, -0.03), (0.06, 0.0)], [(1e-4, -0.03), (0.06, -0.03)]])
        .moved(GLOBE[0], HEIGHT_M, GLOBE[2])
        .of("brass"),
        *moved(lamp, LAMP[0], 0, LAMP[1]),
    ]
