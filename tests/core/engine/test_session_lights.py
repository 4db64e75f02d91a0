"""The main light and lights of a session's probes: tracked ones have memory, others are found in one panorama."""

import numpy as np
import pytest

from roomlight.engine.panorama.light_tracking import SETTLE_FRAMES
from roomlight.engine.panorama.likely_light import likely_lights
from roomlight.light.main_light import find_lights
from rooms import BoxRoom, pan
from sessions import session_of

ROOM = BoxRoom(lamp=((0.3, 1.6, -2.5), 0.35))
POSITION = (0.3, 1.2, 0.2)


@pytest.fixture(scope="module")
def lights():
    """A session after a pan, and of a tracked probe the light and the model's own estimate after each frame."""
    session, tracked, estimates = session_of(probes=[POSITION], height=32), [], []
    for frame in pan(ROOM, 10, start_degrees=-90, step_degrees=15):
        session.push(frame)
        tracked.append(session.light(0))
        estimates.append(session.light(0).used_for("reflection"))
    return session, tracked, estimates


def test_first_frames_main_light_is_where_the_estimate_has_it(lights) -> None:
    _, tracked, estimates = lights
    for light, own in zip(tracked[:SETTLE_FRAMES], estimates, strict=False):
        np.testing.assert_array_equal(
            light.main_light.direction, likely_lights(own.panorama, own.observed).main.direction
        )


def test_ambient_and_tracked_main_light_make_the_total(lights) -> None:
    light = lights[1][-1]
    rest = light.harmonics.without(light.main_light)
    np.testing.assert_allclose(light.ambient.coefficients, rest.coefficients, atol=1e-9)


def test_an_untracked_point_has_the_lights_that_were_seen(lights) -> None:
    session, _, _ = lights
    light = session.light_at(POSITION)
    handle = session.track(POSITION)
    late, own = session.light(handle), find_lights(session.light(handle).reflection)
    session.untrack(handle)
    np.testing.assert_array_equal(late.main_light.direction, light.main_light.direction)
    assert len(light.lights) == len(own)
    for lamp, seen in zip(light.lights, own, strict=True):
        np.testing.assert_array_equal(lamp.direction, seen.direction)
    main = likely_lights(light.reflection, light.observed).main
    np.testing.assert_array_equal(light.main_light.direction, main.direction)
