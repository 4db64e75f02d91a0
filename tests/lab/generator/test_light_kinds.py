"""What lights a room: windows alone, sunbeams, a bright second room, bulbs, spots; their share and brightness."""

from collections import Counter
from functools import cache

import numpy as np
import pytest

from fixture_rooms import plain_catalogue
from roomlight.conventions import LUMINANCE
from roomlight_generator.rooms.build import build_room
from roomlight_generator.rooms.lights import LIGHT_KINDS
from roomlight_generator.rooms.planner import free_floor
from roomlight_generator.sequences.exposure import BRIGHT_LEVEL, PERCENTILE
from roomlight_generator.sequences.render import LitRoom, plan_camera_path
from roomlight_generator.sequences.walk import FreeSpace
from roomlight_generator.transport import RoomLight, Tracer
from roomlight_generator.transport.lights.sun_spots import sun_spots

SEED = 6


@cache
def room(index):
    return build_room(index, seed=SEED, split="train", catalogue=plain_catalogue())


@cache
def first(kind):
    """Return the first room whose main room is lit in this way; one of 60 is, or the share is not what it should be."""
    for index in range(60):
        light = room(index).facts["light"]
        if light["kind"] == kind and (kind != "open to bright" or room(index).shell.openings):
            return room(index)
    raise AssertionError(f"none of 60 rooms is lit by {kind}")


def lit(built):
    """Return a room with its light solved."""
    tracer = Tracer(built.scene)
    floor = free_floor(built.shell, built.placements, radius_m=0.25)
    free = FreeSpace(floor.free, floor.origin, floor.cell_m, tracer.distances)
    return LitRoom(built, RoomLight.solve(tracer, 0), free)


def first_views(lit_room, views=6):
    """Return white (kcd/m2) of frames from this many walks, and the luminance around their first probes."""
    measured = []
    for number in range(views):
        path = plan_camera_path(lit_room, np.random.default_rng(number), frames=1)
        frame = lit_room.light.frame(path.intrinsics.resized(48, 36), path.poses[0], seed=0).radiance @ LUMINANCE
        around = lit_room.light.panorama(path.probes[0], height=48, seed=0) @ LUMINANCE
        measured.append((float(np.percentile(frame, PERCENTILE)) / BRIGHT_LEVEL, around))
    return measured


@pytest.mark.slow
@pytest.mark.statistical
def test_each_kind_has_about_its_share():
    """A kind that a room has no place for becomes mixed: the others have half of their share at least."""
    rooms = 100
    counts = Counter(room(index).facts["light"]["kind"] for index in range(rooms))
    for kind, share in LIGHT_KINDS.items():
        noise = 2.6 * np.sqrt(share * (1 - share) / rooms)
        least, most = (share - noise, 1) if kind == "mixed" else (0.5 * share - noise, share + noise)
        assert least <= counts[kind] / rooms <= most, kind


@pytest.mark.slow
def test_rooms_lit_by_windows_have_no_lamp_on():
    for kind in ("windows alone", "sunbeams"):
        facts = first(kind).facts["light"]
        assert facts["lamps_on"] == 0
        assert facts["scenario"] not in ("dusk", "night")
        assert "window" in [source["kind"] for source in facts["sources"]]


@pytest.mark.slow
@pytest.mark.usefixtures("few_rays")
def test_windows_are_5_to_100_times_white():
    """The brightest thousandth of the directions, in most views: windows, since no lamp is on."""
    high = [np.percentile(around, 99.5) / white for white, around in first_views(lit(first("windows alone")))]
    assert 5 < np.median(high) < 100


@pytest.mark.slow
@pytest.mark.usefixtures("few_rays")
def test_sunbeams_reach_into_the_room():
    """A patch is far brighter than the room; above white only in views that it does not fill, as a phone meters."""
    lit_room = lit(first("sunbeams"))
    spots = sun_spots(lit_room.light.tracer, lit_room.light.light.outdoors)
    inside = np.array([lit_room.room.shell.contains(float(x), float(z)) for x, _, z in spots.position])
    assert spots.area[inside].sum() > 0.1  # square metres in the room, not in a reveal
    typical = np.median([np.median(around) for _, around in first_views(lit_room, views=3)])
    assert np.median(spots.radiance[inside] @ LUMINANCE) > 10 * typical


@pytest.mark.slow
def test_bare_bulbs_have_no_shade_and_are_glaring():
    """Of the bulbs of such a room, half are brighter than 2 kcd/m2; frosted bulbs of 60 W have 30 to 50."""
    bulb_rooms = [first("bare bulbs")]
    glare = [
        float(np.dot(material.emission, LUMINANCE))
        for built in bulb_rooms
        for item in built.scene.items
        for material in item.mesh.materials
        if material.name in ("bulb", "shade")
    ]
    assert len(glare) >= len(bulb_rooms) > 0
    assert np.median([value for value in glare if value > 0]) > 2


def test_spots_are_small_and_bright_in_rows():
    """Of the spots of such a room, half are brighter than 10 kcd/m2; there are at most 24 in a room."""
    spot_rooms = [first("spots")]
    glare = []
    for built in spot_rooms:
        spots = [item for item in built.scene.items if item.name == "spot"]
        assert 1 <= len(spots) <= 24  # a single one in a very small room
        for spot in spots:
            low, high = spot.mesh.bounds()
            x, _, z = (low + high) / 2
            assert max(high[0] - low[0], high[2] - low[2]) < 0.12
            assert 0 < built.shell.ceiling_at(float(x), float(z)) - high[1] < 0.03
            glare.append(float(np.dot(spot.mesh.materials[0].emission, LUMINANCE)))
    assert np.median(glare) > 10
