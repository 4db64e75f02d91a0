"""Which sources shine, how bright and in which colour: the day outside, the lamps inside, screens, lit curtains.

Photometry: luminous flux in kilolumen, illuminance in kilolux, luminance in kcd/m2, so that flux = pi x area x
luminance for a Lambertian surface. Colours come from `blackbody_rgb`, normalised to luminance 1.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.colour import blackbody_rgb
from roomlight_generator.rooms.finishes import screen_picture
from roomlight_generator.rooms.plan import Placement, Shell
from roomlight_generator.rooms.scene import Item, Material, Mesh, Rgb, Sky
from roomlight_generator.rooms.shapes import box, clad, sphere
from roomlight_generator.rooms.sky import make_sky, vertical_irradiance

Scenario = Literal["sunny", "bright", "overcast", "golden", "dusk", "night"]

_SKIES: Final[dict[Scenario, tuple[str, ...]]] = {
    "sunny": ("clear",),
    "bright": ("partly_cloudy", "clear"),
    "overcast": ("overcast",),
    "golden": ("golden",),
    "dusk": ("dusk",),
    "night": ("night",),
}
_SCENARIOS: Final[tuple[Scenario, ...]] = ("sunny", "bright", "overcast", "golden", "dusk", "night")
_WITH_WINDOWS: Final = (0.24, 0.16, 0.16, 0.09, 0.12, 0.23)
"""How often each is met: half the rooms by day, a quarter by night."""

_LAMPS_ON: Final[dict[Scenario, float]] = {
    "sunny": 0.2,
    "bright": 0.35,
    "overcast": 0.6,
    "golden": 0.6,
    "dusk": 0.95,
    "night": 1.0,
}
"""The chance that any lamp is on."""

_FLUX_SHARE: Final[dict[str, float]] = {"ceiling_lamp": 3.0, "ceiling_fan": 1.5, "floor_lamp": 1.3, "table_lamp": 0.6}
"""A lamp's weight in the room's total flux (wall lamps and the rest: 0.5)."""

_CAST: Final = 96
"""Rays from a bulb that find out what hides it."""


@dataclass(frozen=True, eq=False)
class Lighting:
    """The things of a room with their light on, the sky, and what is to be reported of it."""

    items: tuple[Item, ...]
    sky: Sky
    facts: dict[str, Any]


def light_room(
    shell: Shell,
    placements: Sequence[Placement],
    items: Sequence[Item],
    rng: np.random.Generator,
    *,
    split: Split,
) -> Lighting:
    """Choose a time of day and switch the lamps; `items` are the placements' things in the same order.

    A room is never without light: where nothing else would shine, its lamps are on, and a room without lamps gets a
    ceiling panel. Lamps together give a mean illuminance between 12 and 900 lux (log-uniform, dimmer at night).
    """
    windows = _has_windows(shell)
    scenario = _SCENARIOS[int(rng.choice(len(_SCENARIOS), p=_WITH_WINDOWS))] if windows else "night"
    sky = make_sky(str(rng.choice(_SKIES[scenario])), rng, toward=_outward(shell, rng))
    lamps = [i for i, placement in enumerate(placements) if _is_lamp(placement)]
    lit = set(_switched_on(placements, lamps, rng)) if rng.random() < _LAMPS_ON[scenario] else set[int]()
    extra: list[Item] = []
    if not lit and (scenario in ("dusk", "night")):
        if lamps:
            lit = set(_switched_on(placements, lamps, rng)) or set(lamps)
        else:
            extra.append(_panel(shell, rng))
    kelvin = _room_kelvin(rng)
    out, sources = list(items), list[dict[str, Any]]()
    flux_klm = _total_flux(shell, rng, evening=windows and scenario == "night")
    weights = {i: _FLUX_SHARE.get(placements[i].model.role, 0.5) * float(rng.uniform(0.6, 1.6)) for i in lit}
    total = sum(weights.values()) + len(extra)
    bulbs = {role: kelvin if rng.random() > 0.3 else _room_kelvin(rng) for role in sorted({*_roles(placements, lit)})}
    for i in sorted(lit):
        own = bulbs[placements[i].model.role] * float(np.exp(rng.normal(0, 0.015)))
        flux = flux_klm * weights[i] / total
        item = switch_on(items[i], placements[i], flux_klm=flux, colour=blackbody_rgb(own))
        out[i] = item
        sources.append({"kind": placements[i].model.role, "flux_lm": round(1000 * flux, 1), "kelvin": round(own)})
    for panel in extra:
        out.append(_emitting(panel, flux_klm / total, blackbody_rgb(kelvin)))
        sources.append({"kind": "panel", "flux_lm": round(1000 * flux_klm / total, 1), "kelvin": round(kelvin)})
    for item, kind in _extras(shell, placements, rng, night=scenario in ("dusk", "night")):
        own = _room_kelvin(rng)
        flux = float(rng.uniform(0.1, 0.8))
        out.append(_emitting(item, flux, blackbody_rgb(own)))
        sources.append({"kind": kind, "flux_lm": round(1000 * flux, 1), "kelvin": round(own)})
    out = [_screens(item, rng, split, sources) for item in out]
    shell_items = [_daylit(item, sky, shell, rng, sources) for item in shell.items]
    if shell.openings:
        sources.append({"kind": "window", "count": len(shell.openings), "sun": sky.sun is not None})
    facts = {"scenario": scenario, "lamps": len(lamps), "lamps_on": len(lit), "sources": sources}
    return Lighting(items=(*shell_items, *out), sky=sky, facts=facts)


def switch_on(item: Item, placement: Placement, *, flux_klm: float, colour: Rgb) -> Item:
    """A lamp with its light on: bulbs at its light sources, and the parts that hide them glowing.

    Rays cast from each bulb tell what share of its light gets out unhindered: the bulb emits that share, and the
    materials called `shade...` that rays meet (or, where none is called so and the bulb is shut in, the one met most)
    emit the rest. A lamp without a known bulb glows by its shade, or by a small bulb below it where it has none.
    """
    mesh = item.mesh
    shades = [k for k, material in enumerate(mesh.materials) if material.name.startswith("shade")]
    bulbs = placement.light_positions()
    escaped, met = _cast_from_bulbs(mesh, bulbs)
    if len(bulbs) and not shades and escaped < 0.1 and met:
        shades = [max(met, key=lambda k: met[k])]
    parts = [mesh]
    share = 0.0
    if shades:
        share = 1.0 if not len(bulbs) or escaped < 0.05 else 1 - 0.7 * escaped
        area = _area_m2(mesh, np.isin(mesh.face_materials, shades))
        glow = share * flux_klm / (np.pi * max(area, 1e-4))
        materials = [
            replace(material, emission=_times(colour, glow)) if k in shades else material
            for k, material in enumerate(mesh.materials)
        ]
        parts = [replace(mesh, materials=tuple(materials))]
    if not len(bulbs) and not shades:
        low, high = mesh.bounds()
        bulbs = np.array([[(low[0] + high[0]) / 2, low[1] - 0.04, (low[2] + high[2]) / 2]])
    if share < 1 and len(bulbs):
        lights = placement.model.lights
        for k, position in enumerate(bulbs):
            radius = float(np.clip(lights[k].diameter_m / 2, 0.012, 0.1)) if k < len(lights) else 0.03
            luminance = (1 - share) * flux_klm / len(bulbs) / (np.pi * 4 * np.pi * radius**2)
            bulb = sphere(radius, rings=6, segments=12)
            glass = Material(name="bulb", albedo=(0.8, 0.8, 0.8), emission=_times(colour, luminance))
            parts.append(clad(bulb, glass).placed(*(float(x) for x in position)))
    return replace(item, mesh=Mesh.joined(parts))


def _has_windows(shell: Shell) -> bool:
    """Whether daylight could come in; windows that are wholly covered have no opening but cloth that glows."""
    cloths = (material for item in shell.items for material in item.mesh.materials)
    return bool(shell.openings) or any(material.name.startswith("daylit") for material in cloths)


def _roles(placements: Sequence[Placement], chosen: Iterable[int]) -> list[str]:
    return [placements[i].model.role for i in chosen]


def _is_lamp(placement: Placement) -> bool:
    model = placement.model
    return bool(model.lights) or model.role in ("ceiling_lamp", "floor_lamp", "table_lamp", "wall_lamp")


def _switched_on(placements: Sequence[Placement], lamps: Sequence[int], rng: np.random.Generator) -> list[int]:
    """All lamps of one role share a switch; at times a single lamp is the only one on."""
    if not lamps:
        return []
    if rng.random() < 0.25:
        return [int(rng.choice(lamps))]
    roles = sorted({placements[i].model.role for i in lamps})
    on = {role for role in roles if rng.random() < (0.75 if role == "ceiling_lamp" else 0.55)}
    return [i for i in lamps if placements[i].model.role in on] or [int(rng.choice(lamps))]


def _room_kelvin(rng: np.random.Generator) -> float:
    low, high = ((2200, 3100), (3100, 4500), (4500, 8000))[int(rng.choice(3, p=(0.58, 0.24, 0.18)))]
    return float(rng.uniform(low, high))


def _total_flux(shell: Shell, rng: np.random.Generator, *, evening: bool) -> float:
    """Flux for a mean illuminance; about half of a lamp's light reaches what one looks at."""
    x, z = shell.polygon.T
    area = 0.5 * abs(float(x @ np.roll(z, -1) - z @ np.roll(x, -1)))
    low, high = (12, 350) if evening else (60, 900)
    lux = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return lux / 1000 * max(area, 2.0) / 0.5


def _outward(shell: Shell, rng: np.random.Generator) -> Float[np.ndarray, "3"] | None:
    """Out of the largest openings, one of them at random by area."""
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


def _cast_from_bulbs(mesh: Mesh, bulbs: Float[np.ndarray, "n 3"]) -> tuple[float, dict[int, int]]:
    """The share of rays from the bulbs that leave the lamp, and which materials met how many of the rest."""
    if not len(bulbs):
        return 1.0, {}
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(mesh.vertices, np.float32), np.ascontiguousarray(mesh.faces, np.int32))
    step = np.arange(_CAST) + 0.5
    up = 1 - 2 * step / _CAST
    turn = np.pi * (1 + np.sqrt(5)) * step
    ring = np.sqrt(1 - up**2)
    directions = np.stack([ring * np.cos(turn), up, ring * np.sin(turn)], 1).astype(np.float32)
    origins = np.repeat(bulbs.astype(np.float32), _CAST, axis=0)
    found = np.asarray(scene.run(origins, np.tile(directions, (len(bulbs), 1)), query="INTERSECT"))
    met, counts = np.unique(mesh.face_materials[found[found >= 0]], return_counts=True)
    return float((found < 0).mean()), {int(k): int(count) for k, count in zip(met, counts, strict=True)}


def _area_m2(mesh: Mesh, chosen: Bool[np.ndarray, " f"]) -> float:
    a, b, c = (mesh.vertices[mesh.faces[chosen, k]].astype(np.float64) for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _times(colour: Rgb, factor: float) -> Rgb:
    return (colour[0] * factor, colour[1] * factor, colour[2] * factor)


def _emitting(item: Item, flux_klm: float, colour: Rgb) -> Item:
    """The same thing with every surface glowing, together giving the flux."""
    area = _area_m2(item.mesh, np.ones(len(item.mesh.faces), bool))
    emission = _times(colour, flux_klm / (np.pi * max(area, 1e-4)))
    materials = tuple(replace(material, emission=emission) for material in item.mesh.materials)
    return replace(item, mesh=replace(item.mesh, materials=materials))


def _panel(shell: Shell, rng: np.random.Generator) -> Item:
    """A flat panel below the ceiling's middle."""
    x, z = shell.polygon.mean(0)
    for _ in range(50):
        if shell.contains(float(x), float(z), 0.4):
            break
        x, z = rng.uniform(shell.polygon.min(0), shell.polygon.max(0))
    side = float(rng.uniform(0.25, 0.7))
    mesh = clad(box(side, 0.03, side), Material(name="shade", albedo=(0.8, 0.8, 0.8)))
    top = shell.ceiling_at(float(x), float(z))
    return Item("ceiling panel", "ceiling_lamp", mesh.placed(float(x), top - 0.05, float(z)))


def _extras(
    shell: Shell, placements: Sequence[Placement], rng: np.random.Generator, *, night: bool
) -> list[tuple[Item, str]]:
    """Strips below wall units, and light in the second room."""
    found: list[tuple[Item, str]] = []
    units = [placement for placement in placements if placement.model.role == "wall_unit"]
    if units and rng.random() < (0.5 if night else 0.2):
        for placement in units:
            strip = clad(
                box(0.85 * placement.model.width_m, 0.012, 0.03), Material(name="strip", albedo=(0.8, 0.8, 0.8))
            )
            placed = strip.placed(placement.x, placement.y - 0.016, placement.z, degrees=placement.degrees)
            found.append((Item("light strip", "wall_lamp", placed), "strip"))
    if shell.spots and rng.random() < (0.65 if night else 0.35):
        x, z, _ = shell.spots[0]
        globe = clad(sphere(0.12, rings=8, segments=16), Material(name="globe", albedo=(0.8, 0.8, 0.8)))
        height = min(2.0, shell.height_m - 0.3)
        found.append((Item("globe", "ceiling_lamp", globe.placed(x, height, z)), "second room"))
    return found


def _screens(item: Item, rng: np.random.Generator, split: Split, sources: list[dict[str, Any]]) -> Item:
    """Televisions and computers that are on show a picture of 100 to 400 cd/m2 at its white."""
    mesh = item.mesh
    screens = [k for k, material in enumerate(mesh.materials) if material.name.startswith("screen")]
    if not screens or rng.random() > 0.55:
        return item
    white = float(rng.uniform(0.1, 0.4))
    picture = screen_picture(split, rng)
    materials, uvs = list(mesh.materials), mesh.uvs.copy()
    for k in screens:
        faces = mesh.face_materials == k
        corners = np.unique(mesh.faces[faces])
        if not len(corners):
            continue
        uvs[corners] = _across(mesh.vertices[corners])
        materials[k] = replace(
            materials[k], texture=picture, emission=_times(blackbody_rgb(6800), white), textured_emission=True
        )
    sources.append({"kind": "screen", "cd_m2": round(1000 * white)})
    return replace(item, mesh=replace(mesh, materials=tuple(materials), uvs=uvs))


def _across(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Picture coordinates over a screen, v down: by its longest horizontal extent and its height."""
    plan = points[:, [0, 2]] - points[:, [0, 2]].mean(0)
    axis = np.linalg.svd(plan, full_matrices=False)[2][0] if len(points) > 2 else np.array([1.0, 0.0])
    along, up = plan @ axis, points[:, 1]
    u = (along - along.min()) / max(float(np.ptp(along)), 1e-6)
    v = (up.max() - up) / max(float(np.ptp(up)), 1e-6)
    return np.stack([0.01 + 0.98 * u, 0.01 + 0.98 * v], 1).astype(np.float32)


def _daylit(item: Item, sky: Sky, shell: Shell, rng: np.random.Generator, sources: list[dict[str, Any]]) -> Item:
    """Sheer curtains and blinds before a window glow by the daylight they let through: T x illuminance / pi.

    Nothing in the transport passes light diffusely, so the cloth is a source of its own, as bright as the sky (and
    half of the sun: the reveal shades the rest) makes it.
    """
    names = [material.name for material in item.mesh.materials]
    if not any(name.startswith("daylit") for name in names):
        return item
    normal = item.mesh.normals.astype(np.float64).copy()
    normal[:, 1] = 0
    axis = np.linalg.svd(normal[:: max(1, len(normal) // 512)], full_matrices=False)[2][0]
    centre = item.mesh.bounds().mean(0)[[0, 2]]
    away = centre - shell.polygon.mean(0)
    outward = axis if axis[0] * away[0] + axis[2] * away[1] > 0 else -axis
    light = vertical_irradiance(sky, outward)
    transmittance = float(rng.uniform(0.12, 0.45))
    emission = tuple(transmittance * float(value) / np.pi for value in light)
    materials = tuple(
        replace(material, emission=(emission[0], emission[1], emission[2]))
        if material.name.startswith("daylit")
        else material
        for material in item.mesh.materials
    )
    sources.append({"kind": "daylit", "transmittance": round(transmittance, 2)})
    return replace(item, mesh=replace(item.mesh, materials=materials))
