"""Set a room's light sources, their brightness and colour: daylight, lamps, screens, daylit curtains.

Photometry: luminous flux in kilolumen, illuminance in kilolux, luminance in kcd/m2, so that flux = pi x area x
luminance for a Lambertian surface. Colours come from `blackbody_rgb`, normalised to luminance 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Bool, Float

from roomlight.compositing.objects.polygons import face_normals
from roomlight.rays import RayTree
from roomlight_generator.rooms.colour import blackbody_rgb
from roomlight_generator.rooms.plan import Placement, Shell
from roomlight_generator.rooms.roles import LAMP_ROLES
from roomlight_generator.rooms.scene import Item, Material, Mesh, Rgb, Sky
from roomlight_generator.rooms.shapes import block, sphere, sphere_directions, with_material
from roomlight_generator.rooms.sky import make_sky, vertical_irradiance

Scenario = Literal["sunny", "bright", "overcast", "golden", "dusk", "night"]

LightKind = Literal["mixed", "windows alone", "sunbeams", "open to bright", "bare bulbs", "spots"]
"""Kinds of light in a room.

mixed: daylight, lamps or both, as `_LAMPS_ON_PROBABILITY` says; windows alone: daylight without lamps; sunbeams: the
same with the sun before a window; open to bright: no light of its own, only that of a second room; bare bulbs: at dusk
or at night, lamps without shades; spots: rows of small bright lamps in the ceiling, by day beside the windows' light.
"""
LIGHT_KINDS: Final[dict[LightKind, float]] = {
    "mixed": 0.32, "windows alone": 0.2, "sunbeams": 0.22, "open to bright": 0.08, "bare bulbs": 0.05, "spots": 0.13,
}  # fmt: skip
"""Share of the rooms for which each kind is wanted; a room without a place for it is mixed."""

_KIND_SCENARIOS: Final[dict[LightKind, tuple[float, ...]]] = {
    "mixed": (0.24, 0.28, 0.26, 0.1, 0.05, 0.07),
    "windows alone": (0.25, 0.35, 0.3, 0.1, 0, 0),
    "sunbeams": (0.75, 0, 0, 0.25, 0, 0),
    "open to bright": (0.3, 0.3, 0.3, 0.1, 0, 0),
    "bare bulbs": (0, 0, 0, 0, 0.3, 0.7),
    "spots": (0.25, 0.2, 0.35, 0.05, 0.05, 0.1),
}
"""Probability of each of `_SCENARIOS` in a room with windows."""

_BULB_M: Final = (0.02, 0.035)
"""Radius of a bare bulb."""

_SPOT_M: Final = (0.05, 0.11)
"""Side of a spot in the ceiling."""
_SPOT_SPACING_M: Final = (1.0, 2.0)
"""Distance between the spots of a row."""
_MOST_SPOTS: Final = 24

_SKIES: Final[dict[Scenario, tuple[str, ...]]] = {
    "sunny": ("clear",),
    "bright": ("partly_cloudy", "clear"),
    "overcast": ("overcast",),
    "golden": ("golden",),
    "dusk": ("dusk",),
    "night": ("night",),
}
_SCENARIOS: Final[tuple[Scenario, ...]] = ("sunny", "bright", "overcast", "golden", "dusk", "night")
_LAMPS_ON_PROBABILITY: Final[dict[Scenario, float]] = {
    "sunny": 0.15,
    "bright": 0.25,
    "overcast": 0.35,
    "golden": 0.35,
    "dusk": 1.0,
    "night": 1.0,
}
"""Probability that at least one lamp is on."""

_FLUX_WEIGHTS: Final[dict[str, float]] = {"ceiling_lamp": 2.0, "ceiling_fan": 1.5, "floor_lamp": 1.3, "table_lamp": 0.8}
"""A lamp's weight in the room's total flux (wall lamps and the rest: 0.5)."""

_BRIGHT_SECOND_ROOM: Final = 0.4
"""Probability that a lit second room is bright: 300 to 3,000 lux on about 8 m2, half of it lost."""
_SECOND_ROOM_KLM: Final = ((0.1, 0.8), (5.0, 50.0))
"""Flux of the lamp in a dim and in a bright second room."""

_SUNBEAM_SPREAD_DEGREES: Final = 30.0
"""Largest angle in plan between the sun and the normal of a window, in a room with sunbeams.

In other rooms the sun has any azimuth: it lights what is before the windows more often than the floor behind them."""

_RAYS_PER_BULB: Final = 96
"""Rays cast from each bulb to find the parts that occlude it."""


@dataclass(frozen=True, eq=False)
class Lighting:
    """A room's items with their emission set, the sky, and the facts to report."""

    items: tuple[Item, ...]
    sky: Sky
    facts: dict[str, Any]


def light_room(
    shell: Shell,
    placements: Sequence[Placement],
    items: Sequence[Item],
    rng: np.random.Generator,
    *,
    wanted: LightKind = "mixed",
) -> Lighting:
    """Choose a time of day and switch lamps on.

    Every room has light: at dusk and at night at least one lamp is on, and a room without lamps gets a ceiling panel.
    Lamps together give a mean illuminance between 30 and 900 lux (log-uniform, dimmer at night).

    `items` are those of the placements, in the same order. The kind of light is the `wanted` one if the room has a
    place for it; `facts` names the kind that the room has.
    """
    kind = _possible_kind(wanted, shell)
    # Daylight also comes through translucent cloth over a fully covered window.
    windows = bool(shell.openings) or any(_named(item.mesh, "daylit") for item in shell.items)
    scenario = _SCENARIOS[int(rng.choice(len(_SCENARIOS), p=_KIND_SCENARIOS[kind]))] if windows else "night"
    toward = _choose_outward_normal(shell, rng) if kind == "sunbeams" else None
    sky = make_sky(str(rng.choice(_SKIES[scenario])), rng, toward=toward, spread_degrees=_SUNBEAM_SPREAD_DEGREES)
    models = [placement.model for placement in placements]
    lamps = [i for i, model in enumerate(models) if len(model.lights) or model.role in LAMP_ROLES]
    lit = set[int]()
    fixtures: list[Item] = []
    if kind in ("mixed", "bare bulbs") and rng.random() < _LAMPS_ON_PROBABILITY[scenario]:
        lit = set(_choose_lamps(placements, lamps, rng))
        if not lit and scenario in ("dusk", "night"):
            fixtures.append(_ceiling_fixture(shell, rng, bulb=kind == "bare bulbs"))
    if kind == "spots":
        fixtures += _ceiling_spots(shell, rng)
    kelvin = _choose_kelvin(rng)
    out, sources = list(items), list[dict[str, Any]]()
    flux_klm = _choose_total_flux(shell, rng, evening=windows and scenario == "night")
    weights = {i: _FLUX_WEIGHTS.get(placements[i].model.role, 0.5) * float(rng.uniform(0.6, 1.6)) for i in lit}
    total = sum(weights.values()) + len(fixtures)
    bulbs = {
        role: kelvin if rng.random() > 0.3 else _choose_kelvin(rng)
        for role in sorted({placements[i].model.role for i in lit})
    }
    for i in sorted(lit):
        own = bulbs[placements[i].model.role] * float(np.exp(rng.normal(0, 0.015)))
        flux = flux_klm * weights[i] / total
        item = items[i]
        if kind == "bare bulbs":
            item = _without_shade(item, placements[i])
        out[i] = switch_on(item, placements[i], flux_klm=flux, colour=blackbody_rgb(own))
        sources.append({"kind": placements[i].model.role, "flux_lm": round(1000 * flux, 1), "kelvin": round(own)})
    for fixture in fixtures:
        out.append(_with_uniform_emission(fixture, flux_klm / total, blackbody_rgb(kelvin)))
        sources.append({"kind": fixture.name, "flux_lm": round(1000 * flux_klm / total, 1), "kelvin": round(kelvin)})
    night = scenario in ("dusk", "night")
    only_second = kind == "open to bright" and not shell.openings
    for item, source, (least, most) in _accessory_lamps(shell, placements, rng, night=night, only_second=only_second):
        own = _choose_kelvin(rng)
        flux = float(np.exp(rng.uniform(np.log(least), np.log(most))))
        out.append(_with_uniform_emission(item, flux, blackbody_rgb(own)))
        sources.append({"kind": source, "flux_lm": round(1000 * flux, 1), "kelvin": round(own)})
    out = [_with_screens_on(item, rng, sources) for item in out]
    shell_items = [_with_daylit_cloth(item, sky, shell, rng, sources) for item in shell.items]
    if shell.openings:
        sources.append({"kind": "window", "count": len(shell.openings), "sun": sky.sun is not None})
    facts = {"kind": kind, "scenario": scenario, "lamps": len(lamps), "lamps_on": len(lit), "sources": sources}
    return Lighting(items=(*shell_items, *out), sky=sky, facts=facts)


def switch_on(item: Item, placement: Placement, *, flux_klm: float, colour: Rgb) -> Item:
    """Return a lamp switched on: a bulb at each light source, and emissive shades where they occlude the bulbs.

    Rays cast from each bulb measure the share of its light that leaves unoccluded. The bulb emits that share. The
    materials named `shade...` that rays hit emit the rest; if none has such a name and the bulb is enclosed, the
    material hit most often does. A lamp without a known bulb emits from its shade, or from a small bulb below it if it
    has none.
    """
    mesh = item.mesh
    shades = _named(mesh, "shade")
    bulbs = placement.light_positions()
    escaped, met = _trace_bulb_occlusion(mesh, bulbs)
    if len(bulbs) and not shades and escaped < 0.1 and met:
        shades = [max(met, key=lambda k: met[k])]
    parts = [mesh]
    share = 0.0
    if shades:
        share = 1.0 if not len(bulbs) or escaped < 0.05 else 1 - 0.7 * escaped
        area = _area_m2(mesh, np.isin(mesh.face_materials, shades))
        parts = [_glowing(mesh, shades, _scaled(colour, share * flux_klm / (np.pi * max(area, 1e-4))))]
    if not len(bulbs) and not shades:
        low, high = mesh.bounds()
        bulbs = np.array([[(low[0] + high[0]) / 2, low[1] - 0.04, (low[2] + high[2]) / 2]])
    if share < 1 and len(bulbs):
        lights = placement.model.lights
        for k, position in enumerate(bulbs):
            radius = float(np.clip(lights[k].diameter_m / 2, 0.012, 0.1)) if k < len(lights) else 0.03
            luminance = (1 - share) * flux_klm / len(bulbs) / (np.pi * 4 * np.pi * radius**2)
            bulb = sphere(radius, rings=6, segments=12)
            glass = Material(name="bulb", albedo=(0.8, 0.8, 0.8), emission=_scaled(colour, luminance))
            parts.append(with_material(bulb, glass).placed(*(float(x) for x in position)))
    return replace(item, mesh=Mesh.joined(parts))


def _possible_kind(wanted: LightKind, shell: Shell) -> LightKind:
    """Return the kind of light that is wanted if the room has a place for it, otherwise mixed."""
    if wanted in ("windows alone", "sunbeams") and not shell.openings:
        return "mixed"
    if wanted == "open to bright" and not (shell.openings or shell.spots):
        return "mixed"
    return wanted


def _without_shade(item: Item, placement: Placement) -> Item:
    """Return a lamp without the parts that `switch_on` would let glow, if it has a bulb behind them."""
    mesh = item.mesh
    shade = np.isin(mesh.face_materials, _named(mesh, "shade"))
    if not shade.any() or shade.all() or not len(placement.model.lights):
        return item
    return replace(item, mesh=replace(mesh, faces=mesh.faces[~shade], face_materials=mesh.face_materials[~shade]))


def _choose_lamps(placements: Sequence[Placement], lamps: Sequence[int], rng: np.random.Generator) -> list[int]:
    """Choose the lamps that are on: those of one role share a switch; sometimes a single lamp is on."""
    if not lamps:
        return []
    if rng.random() < 0.12:
        return [int(rng.choice(lamps))]
    roles = sorted({placements[i].model.role for i in lamps})
    on = {role for role in roles if rng.random() < (0.45 if role == "ceiling_lamp" else 0.7)}
    return [i for i in lamps if placements[i].model.role in on] or [int(rng.choice(lamps))]


def _choose_kelvin(rng: np.random.Generator) -> float:
    low, high = ((2200, 3100), (3100, 4500), (4500, 8000))[int(rng.choice(3, p=(0.58, 0.24, 0.18)))]
    return float(rng.uniform(low, high))


def _choose_total_flux(shell: Shell, rng: np.random.Generator, *, evening: bool) -> float:
    """Draw the total flux for a mean illuminance, assuming that half of a lamp's light reaches the visible surfaces."""
    x, z = shell.polygon.T
    area = 0.5 * abs(float(x @ np.roll(z, -1) - z @ np.roll(x, -1)))
    low, high = (30, 350) if evening else (60, 900)
    lux = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return lux / 1000 * max(area, 2.0) / 0.5


def _choose_outward_normal(shell: Shell, rng: np.random.Generator) -> Float[np.ndarray, "3"] | None:
    """Return the outward normal of one opening, drawn with its area as weight."""
    if not shell.openings:
        return None
    areas = np.array([opening.area_m2() for opening in shell.openings])
    opening = shell.openings[int(rng.choice(len(areas), p=areas / areas.sum()))]
    centre = opening.corner + (opening.edge_u + opening.edge_v) / 2
    normal = np.cross(opening.edge_u, opening.edge_v)
    normal /= np.linalg.norm(normal)
    middle = np.array([*shell.polygon.mean(0)])
    away = np.array([centre[0] - middle[0], 0.5, centre[2] - middle[1]])
    return normal if float(normal @ away) > 0 else -normal


def _trace_bulb_occlusion(mesh: Mesh, bulbs: Float[np.ndarray, "n 3"]) -> tuple[float, dict[int, int]]:
    """Return the share of rays from the bulbs that leave the lamp, and the number of hits for each material."""
    if not len(bulbs):
        return 1.0, {}
    directions = np.tile(sphere_directions(_RAYS_PER_BULB), (len(bulbs), 1))
    origins = np.repeat(bulbs.astype(np.float32), _RAYS_PER_BULB, axis=0)
    face = RayTree(mesh.vertices, mesh.faces).trace(origins, directions).face
    met, counts = np.unique(mesh.face_materials[face[face >= 0]], return_counts=True)
    return float((face < 0).mean()), dict(zip(met.tolist(), counts.tolist(), strict=True))


def _area_m2(mesh: Mesh, chosen: Bool[np.ndarray, " f"]) -> float:
    return 0.5 * float(np.linalg.norm(face_normals(mesh.vertices, mesh.faces[chosen]), axis=1).sum())


def _named(mesh: Mesh, prefix: str) -> list[int]:
    """Return the indices of the materials whose names begin so."""
    return [k for k, material in enumerate(mesh.materials) if material.name.startswith(prefix)]


def _glowing(mesh: Mesh, chosen: Sequence[int], emission: Rgb) -> Mesh:
    materials = (replace(m, emission=emission) if k in chosen else m for k, m in enumerate(mesh.materials))
    return replace(mesh, materials=tuple(materials))


def _scaled(colour: Rgb, factor: float) -> Rgb:
    return (colour[0] * factor, colour[1] * factor, colour[2] * factor)


def _with_uniform_emission(item: Item, flux_klm: float, colour: Rgb) -> Item:
    """Make every surface of an item emit, with the given total flux."""
    mesh = item.mesh
    area = _area_m2(mesh, np.ones(len(mesh.faces), bool))
    emission = _scaled(colour, flux_klm / (np.pi * max(area, 1e-4)))
    return replace(item, mesh=_glowing(mesh, range(len(mesh.materials)), emission))


def _ceiling_fixture(shell: Shell, rng: np.random.Generator, *, bulb: bool) -> Item:
    """Make a flat panel below the middle of the ceiling, or a bare bulb there."""
    x, z = shell.polygon.mean(0)
    for _ in range(50):
        if shell.contains(float(x), float(z), 0.4):
            break
        x, z = rng.uniform(shell.polygon.min(0), shell.polygon.max(0))
    top = shell.ceiling_at(float(x), float(z))
    material = Material(name="shade", albedo=(0.8, 0.8, 0.8))
    if bulb:
        mesh = with_material(sphere(float(rng.uniform(*_BULB_M)), rings=6, segments=12), material)
        return Item("bulb", "ceiling_lamp", mesh.placed(float(x), top - 0.1, float(z)))
    side = float(rng.uniform(0.25, 0.7))
    mesh = with_material(block(side, 0.03, side), material)
    return Item("panel", "ceiling_lamp", mesh.placed(float(x), top - 0.05, float(z)))


def _ceiling_spots(shell: Shell, rng: np.random.Generator) -> list[Item]:
    """Make small square lamps below the ceiling on a grid, at most `_MOST_SPOTS` of them."""
    side, spacing = float(rng.uniform(*_SPOT_M)), float(rng.uniform(*_SPOT_SPACING_M))
    (west, north), (east, south) = shell.polygon.min(0), shell.polygon.max(0)
    columns = np.arange(west + spacing / 2, east, spacing)
    rows = np.arange(north + spacing / 2, south, spacing)
    places = [(float(x), float(z)) for z in rows for x in columns if shell.contains(float(x), float(z), 0.3)]
    if not places:
        return [_ceiling_fixture(shell, rng, bulb=True)]
    chosen = np.linspace(0, len(places) - 1, min(len(places), _MOST_SPOTS)).round().astype(int)
    mesh = with_material(block(side, 0.01, side), Material(name="shade", albedo=(0.8, 0.8, 0.8)))
    return [
        Item("spot", "ceiling_lamp", mesh.placed(x, shell.ceiling_at(x, z) - 0.02, z))
        for x, z in (places[int(number)] for number in chosen)
    ]


def _accessory_lamps(
    shell: Shell, placements: Sequence[Placement], rng: np.random.Generator, *, night: bool, only_second: bool
) -> list[tuple[Item, str, tuple[float, float]]]:
    """Return light strips below wall units and a lamp in the second room, with the range of each lamp's flux in klm.

    A bright second room has a panel below its ceiling instead of a globe: from a dim room it looks like a lit hall or a
    conservatory. Strips are more frequent at night. `only_second`: the second room has the only light.
    """
    lamps: list[tuple[Item, str, tuple[float, float]]] = []
    units = [placement for placement in placements if placement.model.role == "wall_unit"]
    if units and rng.random() < (0.5 if night else 0.2):
        for placement in units:
            strip = with_material(
                block(0.85 * placement.model.width_m, 0.012, 0.03), Material(name="strip", albedo=(0.8, 0.8, 0.8))
            )
            placed = strip.placed(placement.x, placement.y - 0.016, placement.z, degrees=placement.degrees)
            lamps.append((Item("light strip", "wall_lamp", placed), "strip", (0.1, 0.8)))
    if shell.spots and (only_second or rng.random() < 0.65):
        x, z, _ = shell.spots[0]
        bright = only_second or rng.random() < _BRIGHT_SECOND_ROOM
        shape = block(0.6, 0.04, 0.6) if bright else sphere(0.12, rings=8, segments=16)
        lamp = with_material(shape, Material(name="globe", albedo=(0.8, 0.8, 0.8)))
        height = 2.2 if bright else min(2.0, shell.height_m - 0.3)
        item = Item("globe", "ceiling_lamp", lamp.placed(x, height, z))
        lamps.append((item, "bright second room" if bright else "second room", _SECOND_ROOM_KLM[int(bright)]))
    return lamps


def _with_screens_on(item: Item, rng: np.random.Generator, sources: list[dict[str, Any]]) -> Item:
    """Switch some screens on: white of 100 to 400 cd/m2, of which a picture has a fifth to two thirds in the mean."""
    screens = _named(item.mesh, "screen")
    if not screens or rng.random() > 0.55:
        return item
    level = float(rng.uniform(0.1, 0.4)) * float(rng.uniform(0.2, 0.67))
    sources.append({"kind": "screen", "cd_m2": round(1000 * level)})
    return replace(item, mesh=_glowing(item.mesh, screens, _scaled(blackbody_rgb(6800), level)))


def _with_daylit_cloth(
    item: Item, sky: Sky, shell: Shell, rng: np.random.Generator, sources: list[dict[str, Any]]
) -> Item:
    """Make translucent curtains and blinds emit the daylight that they transmit: T x illuminance / pi.

    The transport has no diffuse transmission, so the cloth is a light source of its own, as bright as the sky and half
    of the sun (the reveal shades the rest) make it.
    """
    cloth = _named(item.mesh, "daylit")
    if not cloth:
        return item
    normal = item.mesh.normals.astype(np.float64).copy()
    normal[:, 1] = 0
    axis = np.linalg.svd(normal[:: max(1, len(normal) // 512)], full_matrices=False)[2][0]
    centre = item.mesh.bounds().mean(0)[[0, 2]]
    away = centre - shell.polygon.mean(0)
    outward = axis if axis[0] * away[0] + axis[2] * away[1] > 0 else -axis
    transmittance = float(rng.uniform(0.12, 0.45))
    red, green, blue = (transmittance * float(value) / np.pi for value in vertical_irradiance(sky, outward))
    sources.append({"kind": "daylit", "transmittance": round(transmittance, 2)})
    return replace(item, mesh=_glowing(item.mesh, cloth, (red, green, blue)))
