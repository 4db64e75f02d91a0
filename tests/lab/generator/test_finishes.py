"""Colours of the shell: plausible, in the documented proportions."""

from dataclasses import fields
from functools import cache

import numpy as np
import pytest

from roomlight.conventions import LUMINANCE
from roomlight_generator.rooms.finishes import RoomFinishes, room_kind, shell_finishes

TYPES = ("living_room", "bedroom", "kitchen", "bathroom", "office")


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
    return [(kind, shell_finishes(kind, np.random.default_rng(k))) for k, kind in enumerate(TYPES * count)]


def test_surface_albedos_and_roughness_are_in_range():
    for _, finishes in finished(5):
        for name, material in materials(finishes):
            assert all(0 < channel <= 0.95 for channel in material.albedo), name
            assert min(material.albedo) > 0.005, name
            assert material.roughness is None or 0.03 <= material.roughness <= 0.6, name
            assert not any(material.emission)
            assert material.mirror == 0


@pytest.mark.slow
@pytest.mark.statistical
def test_ceilings_are_brighter_than_floors_and_many_floors_coated():
    rooms = finished(20)
    ceilings, floors = (
        [float(LUMINANCE @ np.array(getattr(finishes.room, name).albedo)) for _, finishes in rooms]
        for name in ("ceiling", "floor")
    )
    assert 0.4 < np.median(ceilings) < 0.6
    assert 0.1 < np.median(floors) < 0.3
    assert 0.25 < np.mean([finishes.room.floor.roughness is not None for _, finishes in rooms]) < 0.8
    dull = [finishes for _, finishes in rooms if finishes.room.wall.roughness is None]
    assert len(dull) > 0.6 * len(rooms)


@pytest.mark.parametrize(
    ("room_type", "kind"),
    [("Child's bedroom", "bed"), ("bathroom", "bath"), ("open_kitchen", "kitchen"), ("home_office", "work"),
     ("hallway", "living"), ("laundry", "utility"), ("dining_room", "living")],
)  # fmt: skip
def test_room_kinds_follow_from_type_names(room_type, kind):
    assert room_kind(room_type) == kind
