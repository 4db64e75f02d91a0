"""The probes of a scene: what lights objects, what casts their shadows, and how both follow the session."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from roomlight.compositing.light.probes import ObjectProbes
from roomlight.compositing.light.temporal import LIGHT_S
from rooms import BoxRoom, camera_at
from sessions import session_of

PLACES = np.array([[0.3, 0.4, -1.0], [-0.5, 0.4, -0.6]])


ROOM = BoxRoom(size_m=(5.0, 2.6, 4.5), lamp=((0.5, 2.6, 0.3), 0.3))
DOWN, UP = (ROOM.frame(camera_at((0.2, 1.4, 1.2), pitch_degrees=pitch), width=64, height=48) for pitch in (-35.0, 25.0))


@pytest.fixture
def session():
    return session_of([DOWN], model="auto", height=32)


def position(place):
    x, y, z = place.tolist()
    return x, y, z


def test_objects_and_their_shadows_have_a_light_each(session):
    probes = ObjectProbes(session)
    probes.add(PLACES[:1])
    at = position(PLACES[0])
    light = session.light(session.track(at))
    shown, casting = probes.lighting.at(at).panorama, probes.reflection.at(at).panorama
    assert_array_equal(casting, light.reflection)
    assert_array_equal(shown, light.panorama)
    assert shown.mean() > 1.1 * casting.mean()  # the floor is seen, and the lamp is not


def test_mirrors_show_the_light_that_casts_shadows(session):
    probes = ObjectProbes(session)
    probes.add(PLACES)
    first = probes.lights()
    assert probes.lights() is first
    session.push(UP)
    probes.advance(20 * LIGHT_S)
    for lights in (first, probes.lights()):
        environment = lights.environment
        assert (environment.radiance != environment.mirrored).any()
    assert_array_equal(environment.mirrored[0], probes.reflection.at(position(PLACES[0])).panorama)
    assert_array_equal(environment.radiance[0], probes.lighting.at(position(PLACES[0])).panorama)


def test_both_follow_the_session(session):
    probes = ObjectProbes(session)
    probes.add(PLACES)
    handles = [session.track(position(place)) for place in PLACES]
    session.push(UP)
    probes.add(np.array([[0.0, 0.2, 0.0]]))  # of an object that is placed later
    probes.advance(20 * LIGHT_S)
    for place, handle in zip(PLACES, handles, strict=True):
        at, light = position(place), session.light(handle)
        assert_allclose(probes.reflection.at(at).panorama, light.reflection, rtol=1e-3, atol=1e-3)
        assert_allclose(probes.lighting.at(at).panorama, light.panorama, rtol=1e-3, atol=1e-3)
    before = probes.lights()
    probes.advance(20 * LIGHT_S)
    assert probes.lights() is before


def test_light_that_is_given_lights_objects_and_casts_their_shadows(session):
    given = np.full((16, 32, 3), 0.7, np.float32)
    probes = ObjectProbes(session, lambda _: given)
    probes.add(PLACES[:1])
    at = position(PLACES[0])
    assert probes.lighting.at(at) is probes.reflection.at(at)
    assert_array_equal(probes.lighting.at(at).panorama, given)
    assert_array_equal(probes.lights().environment.mirrored[0], given)
    probes.close()
    probes.add(PLACES[:1])
    assert probes.lighting.at(at) is probes.reflection.at(at)
