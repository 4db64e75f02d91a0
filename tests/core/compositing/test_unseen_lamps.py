"""Lamps that no frame has shown: found by the shadow of a block on the floor, and by nothing else."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import nnls

from present import present
from roomlight.compositing.compositor import Compositor
from roomlight.compositing.light.lighting import LightSampler
from roomlight.compositing.objects.materials import diffuse
from roomlight.compositing.objects.primitives import cube
from roomlight.compositing.placement.places import Plane
from roomlight.compositing.placement.room_geometry import RoomGeometry
from roomlight.compositing.placement.scene import AtPosition, SceneObject
from roomlight.compositing.rendering import unseen_lamps as module
from roomlight.compositing.rendering.unseen_lamps import ShadowLights, non_negative_factors, unseen_lamps
from roomlight.conventions import panorama_directions
from rooms import BoxRoom, camera_at
from sessions import session_of

ROOM = BoxRoom(block=((-0.9, 0.0, -1.2), (-0.3, 0.6, -0.6)))
CENTRE = np.array([0.3, 0.12, -0.4])
LAMP = np.array([-1.5, 2.2, -1.6])
TOWARD = (LAMP - CENTRE) / np.linalg.norm(LAMP - CENTRE)
FLOOR = Plane(np.array([0.3, 0.0, -0.4]), np.array([0.0, 1.0, 0.0]))
EVEN = np.full((60, 120, 3), 0.3, np.float32)
OBSERVED = (panorama_directions(60)[..., 1] < 0.2).astype(np.float32)  # no frame has looked up


@cache
def views():
    """Frames of the room, where they show the floor, and how much of the upper half the block leaves open there."""
    places = [((0.9, 1.6, 0.9), 25), ((0.3, 1.6, 1.4), 5), ((-0.6, 1.7, 1.2), -20), ((1.4, 1.6, 0.2), 50)]
    rng, made = np.random.default_rng(0), []
    radius, turn = np.sqrt(rng.random(64)), 2 * np.pi * rng.random(64)
    upward = np.stack([radius * np.cos(turn), np.sqrt(1 - radius**2), radius * np.sin(turn)], axis=-1)
    for index, (eye, yaw) in enumerate(places):
        frame = ROOM.frame(camera_at(eye, yaw, -40), index=index)
        points = frame.intrinsics.rays() * frame.depth_m[..., None]
        points = points @ frame.camera_to_world[:3, :3].T + frame.camera_to_world[:3, 3]
        floor, open_share = points[..., 1] < 0.01, np.zeros(points.shape[:2])
        start = points[floor][:, None] + 1e-3 * upward
        end = start + ROOM.cast(start, upward)[1][..., None] * upward
        open_share[floor] = (np.abs(end[..., [0, 2]]) > 2.4).any(-1).mean(-1) + (end[..., 1] > 2.9).mean(-1)
        made.append((frame, points, floor, np.minimum(open_share, 1)))
    return made


def frames(lamp=2.0, pattern=0.0):
    """The room's frames with a grey floor under even light and the lamp, whose light the block hides from a part."""
    for index, (frame, points, floor, open_share) in enumerate(views()):
        toward = LAMP - points
        far = np.linalg.norm(toward, axis=-1)
        toward /= far[..., None]
        lit = ROOM.cast(points + 1e-3 * toward, toward)[1] > far - 1e-2
        falloff = (np.linalg.norm(LAMP - CENTRE) / far) ** 2 * np.maximum(toward[..., 1], 0)
        light = 0.3 * open_share + lamp * lit * falloff / np.pi
        light = 0.5 * light * (1 + pattern * np.sign(np.sin(6 * points[..., 0])))
        noise = np.random.default_rng(index).normal(1, 0.02, light.shape)
        yield replace(
            frame, image=np.where(floor[..., None], (light * noise)[..., None], frame.image).astype(np.float32)
        )


def shown(**light):
    session, room = session_of(frames(**light), height=32), RoomGeometry()
    room.update(session)
    return session, room


@pytest.fixture(scope="module")
def lit():
    return shown()


def lamps(session, room, surface=FLOOR):
    return unseen_lamps(surface, CENTRE, room, [mesh for _, mesh in session.meshes], EVEN, OBSERVED)


@pytest.mark.slow
def test_a_lamp_is_found_by_the_shadow_of_a_block(lit):
    made = present(lamps(*lit))
    mean = made.energy @ made.directions
    assert np.degrees(np.arccos(mean @ TOWARD / np.linalg.norm(mean))) < 15
    onto_floor = float(made.energy @ made.directions[:, 1])
    assert onto_floor / (np.pi * 0.3) == pytest.approx(2.0 * TOWARD[1] / (np.pi * 0.3), rel=0.5)
    panorama = made.added_to(EVEN)
    assert (panorama >= EVEN - 1e-6).all()
    brightest = panorama_directions(60).reshape(-1, 3)[panorama[..., 0].argmax()]
    assert np.degrees(np.arccos(brightest @ TOWARD)) < 25


@pytest.mark.slow
def test_no_lamp_is_found_without_a_shadow_or_by_a_pattern():
    for light in ({"lamp": 0.0}, {"lamp": 0.0, "pattern": 0.4}):
        assert lamps(*shown(**light)) is None


def test_walls_and_floors_that_no_frame_shows_have_no_lamps(lit):
    session, room = lit
    assert lamps(session, room, Plane(np.array([0.0, 1.0, -2.5]), np.array([0.0, 0.0, 1.0]))) is None
    assert lamps(session, room, replace(FLOOR, point=np.array([0.0, 1.0, 0.0]))) is None


def test_lamps_are_looked_for_once_for_a_place_until_the_room_has_grown(lit, monkeypatch):
    session, room = lit
    calls = []
    monkeypatch.setattr(module, "unseen_lamps", lambda *values: calls.append(values) or unseen_lamps(*values))
    lights, x = ShadowLights(), float(CENTRE[0])
    known = LightSampler(EVEN, (x, 0.12, -0.4))
    first = lights.light(known, lambda: OBSERVED, FLOOR, room, session)
    assert first.panorama.max() > 2 * known.panorama.max()
    assert lights.light(known, lambda: OBSERVED, FLOOR, room, session) is first
    beside = LightSampler(EVEN, (x + 0.1, 0.12, -0.4))
    assert lights.light(beside, lambda: OBSERVED, FLOOR, room, session).position == beside.position
    assert len(calls) == 1
    monkeypatch.setattr(room, "version", 2 * room.version)
    lights.light(known, lambda: OBSERVED, FLOOR, room, session)
    assert len(calls) == 2


@pytest.mark.parametrize(("quality", "deep"), [("good", True), ("preview", False)])
def test_an_object_has_the_shadow_of_a_lamp_that_no_frame_has_shown(lit, quality, deep):
    session, _ = lit
    view = list(frames())[1]
    thing = SceneObject("cube", cube(0.24, diffuse((0.2, 0.2, 0.2))), AtPosition((0.3, 0.0, -0.4)))
    made = Compositor(session, [thing], quality=quality)
    picture = made.composite(view)
    made.close()
    behind = np.array([0.3, 0.0, -0.4]) - 0.22 * np.array([TOWARD[0], 0, TOWARD[2]]) / np.hypot(TOWARD[0], TOWARD[2])
    inverse = np.linalg.inv(view.camera_to_world)
    ((column, row),), _ = view.intrinsics.project((inverse[:3, :3] @ behind + inverse[:3, 3])[None])
    assert bool(picture.shadow[int(row), int(column)].mean() < 0.7) is deep


def test_factors_are_those_of_scipy():
    rng = np.random.default_rng(4)
    for rows, columns in ((40, 8), (300, 90), (30, 60)):
        matrix = np.abs(rng.normal(size=(rows, columns)))
        matrix[:, 1] = 0
        wanted = matrix @ np.maximum(rng.normal(size=columns), 0) + rng.normal(0, 0.3, rows)
        damped = np.concatenate([matrix, 0.1 * np.eye(columns)])
        theirs, _ = nnls(damped, np.concatenate([wanted, np.zeros(columns)]))
        ours = non_negative_factors(damped, np.concatenate([wanted, np.zeros(columns)]))
        assert ours == pytest.approx(theirs, abs=1e-6)
