"""The main light and lights of a session's probes: tracked ones have memory, others are found in one panorama."""

import itertools

import numpy as np
import pytest

from roomlight.engine.panorama.light_tracking import MAX_TURN_DEG, SETTLE_FRAMES
from roomlight.engine.session import Session, SessionOptions
from roomlight.light.main_light import find_lights, main_light
from rooms import BoxRoom, pan

ROOM = BoxRoom(lamp=((0.3, 1.6, -2.5), 0.35))
POSITION = (0.3, 1.2, 0.2)


@pytest.fixture(scope="module")
def lights():
    """The light of a tracked probe after each frame of a pan, and the session."""
    session = Session(SessionOptions(model="classical", height=32))
    handle = session.track(POSITION)
    found = []
    for frame in pan(ROOM, 10, start_degrees=-90, step_degrees=15):
        session.push(frame)
        found.append(session.light(handle))
    return session, found


def test_first_frames_main_light_is_the_panoramas(lights) -> None:
    _, found = lights
    for light in found[:SETTLE_FRAMES]:
        np.testing.assert_array_equal(light.main_light.direction, main_light(light.panorama).direction)


def test_a_tracked_main_light_turns_at_a_bounded_rate(lights) -> None:
    _, found = lights
    later = [light.main_light.direction for light in found[SETTLE_FRAMES - 1 :]]
    for before, after in itertools.pairwise(later):
        assert before @ after >= np.cos(np.radians(MAX_TURN_DEG)) - 1e-9


def test_ambient_and_tracked_main_light_make_the_total(lights) -> None:
    light = lights[1][-1]
    rest = light.harmonics.without(light.main_light)
    np.testing.assert_allclose(light.ambient.coefficients, rest.coefficients, atol=1e-9)


def test_an_untracked_point_has_the_lights_of_its_panorama(lights) -> None:
    light = lights[0].light_at(POSITION)
    assert light.tracked_lights is None
    expected = find_lights(light.panorama)
    assert [one.to_json() for one in light.lights] == [one.to_json() for one in expected]
    np.testing.assert_array_equal(light.main_light.direction, main_light(light.panorama).direction)


def test_a_probe_tracked_late_has_lights_at_once(lights) -> None:
    session, _ = lights
    handle = session.track(POSITION)
    light = session.light(handle)
    session.untrack(handle)
    np.testing.assert_array_equal(light.main_light.direction, main_light(light.panorama).direction)


def test_lights_are_of_their_frame(lights) -> None:
    """A light that was handed out does not change with later frames."""
    _, found = lights
    assert found[0].tracked_lights is not found[-1].tracked_lights
    np.testing.assert_array_equal(found[0].main_light.direction, main_light(found[0].panorama).direction)


def test_lights_are_saved_beside_the_main_light(lights) -> None:
    values = lights[1][-1].to_json()
    assert values["main_light"].keys() == {
        "direction",
        "intensity",
        "radius_deg",
        "shadow_strength",
        "emitted",
        "number",
    }
    assert len(values["lights"]) == len(lights[1][-1].lights)
