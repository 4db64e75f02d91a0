"""Roles from keywords and sizes, and conversion of materials."""

import numpy as np
import pytest

from present import present
from roomlight_generator.rooms.furniture.classify import elevation_m, has_surface, role_of
from roomlight_generator.rooms.furniture.exceptions import EXCLUDED, KIND_OF, ROLE_OF
from roomlight_generator.rooms.furniture.files.materials import make_material
from roomlight_generator.rooms.furniture.files.obj import MtlMaterial
from roomlight_generator.rooms.furniture.files.sh3f import LibraryEntry
from roomlight_generator.rooms.roles import ROLES
from roomlight_generator.rooms.scene import Texture


def entry(name, size=(0.6, 0.6, 0.8), *, tags=(), category="Living room", identity="x#y", **more):
    width, depth, height = map(float, size)
    return LibraryEntry(identity, name, tuple(tags), category, "a.obj", width, depth, height, **more)


@pytest.mark.parametrize(
    ("library_entry", "role"),
    [
        (entry("Sofa 2 seats", (1.8, 0.9, 0.8)), "sofa"),
        (entry("Bar stool"), "stool"),
        (entry("Office chair"), "office_chair"),
        (entry("Round table", (1.2, 1.2, 0.75)), "dining_table"),
        (entry("Round table", (0.9, 0.9, 0.4)), "coffee_table"),
        (entry("Table", (0.4, 0.4, 0.5)), "side_table"),
        (entry("Bedside table", (0.4, 0.4, 0.5)), "nightstand"),
        (entry("Lamp", (0.3, 0.3, 0.5)), "table_lamp"),
        (entry("Lamp", (0.4, 0.4, 1.6)), "floor_lamp"),
        (entry("Lamp", (0.4, 0.4, 0.5), elevation_m=2.0), "ceiling_lamp"),
        (entry("Hanging light", (0.4, 0.4, 0.5)), "ceiling_lamp"),
        (entry("Dryer machine", category="Kitchen"), "washing_machine"),
        (entry("Plant", (0.2, 0.2, 0.3)), "small_plant"),
        (entry("Plant", (0.5, 0.5, 1.2)), "plant"),
        (entry("Anna", (0.5, 0.4, 1.7), tags=["Human", "Woman"]), "person"),
        (entry("Garfield", (0.3, 0.5, 0.4), tags=["Cat"]), "pet"),
        (entry("Horse", (0.6, 2.4, 2.0), tags=["Animal"]), None),
        (entry("Family car", (2, 4, 1.5), category="Vehicles"), None),
        (entry("Garden chair", category="Exterior"), None),
        (entry("Swimming pool", (8, 4, 1.5), category="Exterior"), None),
        (entry("Wall flat TV", (1, 0.1, 0.6)), "wall_television"),
        (entry("Front door", (0.9, 0.2, 2.1), opening=True), "door"),
        (entry("Window", (1.2, 0.2, 1.3), opening=True, elevation_m=0.9), "window"),
        (entry("Garage door", (4, 0.2, 2.1), opening=True), None),
        (entry("Sofa of a giant", (9, 4, 3)), None),
        (entry("Whatsit"), None),
    ],
)
def test_keywords_and_sizes_determine_the_role(library_entry, role):
    assert role_of(library_entry) == role


def test_exceptions_come_first_and_name_known_roles():
    assert set(ROLE_OF.values()) <= set(ROLES)
    assert not EXCLUDED & set(ROLE_OF)
    assert not EXCLUDED & set(KIND_OF)
    identity, role = next(iter(ROLE_OF.items()))
    assert role_of(entry("Truck", (3, 9, 4), category="Vehicles", identity=identity)) == role
    assert role_of(entry("Chair", identity=min(EXCLUDED))) is None


def test_elevation_is_the_catalogues_or_the_roles_default():
    assert elevation_m("wall_lamp", entry("Wall lamp", elevation_m=1.8)) == 1.8
    assert elevation_m("wall_lamp", entry("Wall lamp")) == 1.65
    assert elevation_m("sofa", entry("Sofa", elevation_m=0.3)) == 0.0
    assert elevation_m("washbasin", entry("Washbasin", elevation_m=0.4)) == 0.4


def test_seats_and_sinks_support_no_objects():
    assert has_surface("desk", entry("Desk"))
    assert not has_surface("sofa", entry("Sofa"))
    assert not has_surface("kitchen_unit", entry("Sink cabinet"))


def material(name, *, role="chair", texture=None, kind=None, **mtl):
    return make_material(MtlMaterial(name, **mtl), texture, role=role, identity="x#y", kind=kind)


PICTURE = Texture(np.full((2, 2, 3), 90, np.uint8))


def test_colours_are_decoded_and_clamped_to_real_albedos():
    red = material("paint", diffuse=(0.6, 0.1, 0.0)).albedo
    assert 0.25 < red[0] < 0.4  # 0.6 as displayed, lit as the viewer lights it
    assert red[1] == red[2] == pytest.approx(0.03)
    assert material("x", diffuse=(1.0, 1.0, 1.0)).albedo == pytest.approx((0.88,) * 3)
    grey, dark = material("x", diffuse=(0.8, 0.8, 0.8)).albedo[0], material("x", diffuse=(0.3, 0.3, 0.3)).albedo[0]
    assert 0.7 < grey < 0.8
    assert 0.04 < dark < 0.12


def test_glass_mirrors_chrome_screens_and_shades():
    assert material("pane", opacity=0.2).glass
    assert not material("pane", opacity=0.9).glass
    assert not material("cup", role="tableware", opacity=0.2).glass
    assert material("espejo").mirror == pytest.approx(0.88)
    chrome = material("Chrome", specular=(1.0, 1.0, 1.0), diffuse=(0.8, 0.8, 0.8))
    assert 0.4 < chrome.mirror <= 0.6
    screen = material("Screen", role="television")
    assert screen.name == "screen Screen"
    assert max(screen.albedo) < 0.05
    assert material("Screen", role="wardrobe").name == "Screen"
    shade = material("cloth", role="floor_lamp", kind="shade", texture=PICTURE)
    assert shade.name == "shade cloth"
    assert shade.texture is PICTURE
    assert shade.roughness is None


def test_soft_materials_are_matte_and_hard_ones_may_be_coated():
    assert material("cushion", role="sofa", specular=(0.5, 0.5, 0.5), shininess=96.0).roughness is None
    for name in ("white ceramic", "steel", "black plastic"):
        roughness = present(material(name).roughness)
        assert 0.03 <= roughness <= 0.6
    assert material("tub", role="bathtub").roughness is not None
