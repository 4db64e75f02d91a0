"""Colour schemes and recolouring: plausible, in the documented proportions, light sources and mirrors unchanged."""

from dataclasses import fields
from functools import cache

import numpy as np
import pytest

from roomlight.conventions import srgb8_to_linear
from roomlight_generator.rooms.colour import linear_to_oklab, luminance
from roomlight_generator.rooms.finishes import recolour, recoloured, shell_finishes
from roomlight_generator.rooms.finishes.palettes import (
    beige,
    dark_wall,
    glaze,
    grey,
    neutral_wall,
    off_white,
    wall_colour,
)
from roomlight_generator.rooms.finishes.palettes import white as white_paint
from roomlight_generator.rooms.finishes.schemes import room_kind
from roomlight_generator.rooms.finishes.wood import wood_colour
from roomlight_generator.rooms.scene import Material, Texture
from roomlight_generator.rooms.shell_finishes import RoomFinishes

TYPES = ("living_room", "bedroom", "kitchen", "bathroom", "office")


def mean(material):
    colour = np.array(material.albedo)
    if material.texture is not None:
        colour = colour * srgb8_to_linear(material.texture.image).mean((0, 1))
    return colour


def materials(finishes):
    for field in fields(finishes):
        value = getattr(finishes, field.name)
        if isinstance(value, RoomFinishes):
            yield from materials(value)
        elif value is not None:
            yield field.name, value


@cache
def finished(count):
    """Draw the finishes of `count` rooms of each type."""
    return [(kind, shell_finishes(kind, "train", np.random.default_rng(k))) for k, kind in enumerate(TYPES * count)]


@pytest.fixture(params=[1, pytest.param(5, marks=pytest.mark.slow)])
def rooms(request):
    return finished(request.param)


def test_surface_albedos_and_roughness_are_in_range(rooms):
    for _, finishes in rooms:
        for name, material in materials(finishes):
            assert all(0 < channel <= 0.95 for channel in material.albedo), name
            assert 0.01 < float(mean(material).min()) <= float(mean(material).max()) < 0.95, name
            assert material.roughness is None or 0.03 <= material.roughness <= 0.6, name
            assert not material.emits
            assert material.mirror == 0


@pytest.mark.slow
@pytest.mark.statistical
def test_ceilings_are_mostly_white_and_many_floors_coated():
    rooms = finished(5)
    ceilings = [mean(finishes.room.ceiling).min() for _, finishes in rooms]
    assert np.mean(np.array(ceilings) > 0.6) > 0.7
    assert 0.25 < np.mean([finishes.room.floor.roughness is not None for _, finishes in rooms]) < 0.8
    dull = [finishes for _, finishes in rooms if finishes.room.wall.roughness is None]
    assert len(dull) > 0.6 * len(rooms)


def test_kitchens_and_bathrooms_have_tiles(rooms):
    for kind, finishes in rooms:
        if kind in ("kitchen", "bathroom"):
            assert finishes.room.lower_wall is not None
            assert finishes.room.lower_wall.texture is not None


@pytest.fixture
def one(monkeypatch):
    """Replace every texture that takes long to draw by one constant texture."""
    one = Texture(np.full((4, 4, 3), 128, np.uint8))
    monkeypatch.setattr("roomlight_generator.rooms.finishes.schemes.make_texture", lambda *_, **__: one)
    monkeypatch.setattr("roomlight_generator.rooms.finishes.schemes.fabric_texture", lambda *_, **__: one)
    for maker in ("board", "panelling"):
        monkeypatch.setattr(f"roomlight_generator.rooms.finishes.wood.{maker}", lambda *_, **__: one)
    return one


@pytest.mark.parametrize(
    ("count", "textured_tolerance", "strong_tolerance"),
    [(15, 0.28, 0.4), pytest.param(300, 0.065, 0.12, marks=[pytest.mark.slow, pytest.mark.statistical])],
)
def test_walls_have_the_documented_proportions(one, count, textured_tolerance, strong_tolerance):
    strong = textured = 0
    for seed in range(count):
        wall = shell_finishes("living_room", "train", np.random.default_rng(seed)).room.wall
        if wall.texture is one:
            textured += 1
            continue
        lab = linear_to_oklab(mean(wall))
        strong += int(np.hypot(lab[1], lab[2]) > 0.04 or lab[0] < 0.55)
    # Three binomial standard deviations, and more for strong: a few beiges count and a few pale colours do not.
    assert textured / count == pytest.approx(0.13, abs=textured_tolerance)
    assert strong / count == pytest.approx(0.25, abs=strong_tolerance)


@pytest.mark.parametrize(
    ("count", "tolerance"), [(24, 0.3), pytest.param(150, 0.12, marks=[pytest.mark.slow, pytest.mark.statistical])]
)
def test_extra_textures_are_on_a_third_of_the_floors(one, count, tolerance):
    mine = (Texture(np.full((8, 8, 3), 90, np.uint8)),)
    assert mine[0] is not one
    found = sum(
        shell_finishes("bedroom", "train", np.random.default_rng(k), floor_textures=mine).room.floor.texture is mine[0]
        for k in range(count)
    )
    assert found / count == pytest.approx(0.35, abs=tolerance)


def test_finishes_depend_only_on_state_and_split():
    def digest(split):
        finishes = shell_finishes("kitchen", split, np.random.default_rng(9))
        return [
            (name, m.name, m.albedo, m.roughness, None if m.texture is None else m.texture.image.tobytes())
            for name, m in materials(finishes)
        ]

    assert digest("train") == digest("train")
    assert digest("train") != digest("test")


@pytest.mark.parametrize(
    ("room_type", "kind"),
    [("Child's bedroom", "bed"), ("bathroom", "bath"), ("open_kitchen", "kitchen"), ("home_office", "work"),
     ("hallway", "living"), ("laundry", "utility"), ("dining_room", "living")],
)  # fmt: skip
def test_room_kinds_follow_from_type_names(room_type, kind):
    assert room_kind(room_type) == kind


@pytest.mark.parametrize(
    ("draw", "low", "high"),
    [(white_paint, 0.61, 0.85), (off_white, 0.49, 0.75), (beige, 0.34, 0.63), (grey, 0.2, 0.7), (dark_wall, 0.04, 0.15),
     (neutral_wall, 0.2, 0.89), (wall_colour, 0.04, 0.73), (glaze, 0.015, 0.86), (wood_colour, 0.03, 0.67)],
)  # fmt: skip
def test_palettes_stay_in_their_reflectance_range(draw, low, high):
    rng = np.random.default_rng(0)
    levels = [luminance(draw(rng)) for _ in range(80)]
    assert low <= min(levels) <= max(levels) <= high


@pytest.mark.parametrize(
    "kept",
    [Material("wood", mirror=0.9), Material("pane", glass=True), Material("screen0"), Material("shade_outer"),
     Material("cloth", emission=(1.0, 1.0, 1.0)), Material("Chrome leg"), Material("gap", albedo=(0.01, 0.01, 0.01))],
)  # fmt: skip
def test_characteristic_materials_keep_their_colour(kept):
    for seed in range(10):
        assert recolour(kept, np.random.default_rng(seed)) is kept


def test_recolouring_keeps_textures_and_stays_plausible():
    figure = Texture(np.full((4, 4, 3), 200, np.uint8))
    colours = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        cloth = recolour(Material("cloth", (0.9, 0.9, 0.9), texture=figure, roughness=0.2), rng)
        assert cloth.texture is figure
        assert cloth.roughness == 0.2
        assert luminance(cloth.albedo) > 0.25
        paint = recolour(Material("front", (0.2, 0.4, 0.5)), rng)
        assert all(0.01 <= channel <= 0.95 for channel in (*cloth.albedo, *paint.albedo))
        colours.append(paint.albedo)
    assert len({tuple(np.round(colour, 2)) for colour in colours}) > 40


def test_recoloured_wood_keeps_its_hue_order():
    for seed in range(40):
        changed = recolour(Material("leg", (0.25, 0.15, 0.07)), np.random.default_rng(seed))
        assert changed.albedo[0] > changed.albedo[1] > changed.albedo[2]


def test_all_parts_of_a_piece_change_colour_together():
    parts = [Material("seat", (0.2, 0.3, 0.5)), Material("back", (0.2, 0.3, 0.5)), Material("mirror", mirror=0.8)]
    seat, back, mirror = recoloured(parts, np.random.default_rng(4))
    assert seat.albedo == back.albedo
    assert mirror is parts[2]
