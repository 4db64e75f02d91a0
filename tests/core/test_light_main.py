from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from light_rooms import angle_deg, cap_solid_angle, lit, mean_light, room, unit

from roomlight.conventions import LUMINANCE, panorama_directions
from roomlight.light.main_light import MAX_LIGHTS, TrackedLights, find_lights, main_light, relit


@given(
    direction=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1),
    radius_deg=st.floats(2, 12),
    level=st.floats(0, 2),
    height=st.sampled_from([60, 120]),
)
@settings(max_examples=40, deadline=None)
def test_points_at_the_only_lamp_wherever_it_is(direction, radius_deg: float, level: float, height: int) -> None:
    panorama = lit(height, [(direction, radius_deg, [30.0, 24.0, 18.0])], level=level)
    if panorama.max() < 18:  # the lamp fell between pixel centres
        return
    light = main_light(panorama)
    assert np.linalg.norm(light.direction) == pytest.approx(1)
    # Within a pixel of its true centre: it is drawn by whole pixels. Below the horizon its upper part counts more.
    is_above = unit(*direction)[1] > np.sin(np.radians(radius_deg))
    assert angle_deg(light.direction, unit(*direction)) < 180 / height + (0 if is_above else radius_deg)
    above = 4 * np.pi * (mean_light(panorama) - level)
    np.testing.assert_allclose(light.intensity, above, rtol=0.02, atol=0.02 * level)


@pytest.mark.parametrize("height", [8, 16, 33, 120, 256])
def test_direction_is_the_peaks(height: int) -> None:
    """A smooth lobe: the brightest pixel is its centre, at every size of panorama."""
    centre = unit(0.4, 0.5, -0.7)
    panorama = 0.2 + 5 * np.exp(30 * (panorama_directions(height) @ centre - 1))[..., None] * np.ones(3)
    light = main_light(panorama.astype(np.float32))
    row, column = np.unravel_index(np.argmax(panorama[..., 0]), panorama.shape[:2])
    pixel_deg = 180 / height
    assert angle_deg(light.direction, centre) < 0.5 * pixel_deg
    assert angle_deg(light.direction, panorama_directions(height)[row, column]) < 1.5 * pixel_deg


@pytest.mark.parametrize("apart_deg", [15, 25, 40, 90, 170])
def test_of_two_lamps_the_stronger_is_the_main_light(apart_deg: float) -> None:
    apart = np.radians(apart_deg)
    strong, weak = (1, 0, 0), (np.cos(apart), 0, np.sin(apart))
    light = main_light(lit(120, [(strong, 4, 30.0), (weak, 4, 20.0)], level=0.2))
    assert angle_deg(light.direction, unit(*strong)) < 2.5


@pytest.mark.parametrize("height", [4, 16, 120])
@pytest.mark.parametrize("level", [0.0, 1e-6, 0.7, 6e4])
def test_even_or_no_light_has_no_main_light(height: int, level: float) -> None:
    light = main_light(lit(height, [], level=level))
    assert light.direction.tolist() == [0, 1, 0]
    assert light.intensity.tolist() == [0, 0, 0]


def test_a_gradient_points_uphill() -> None:
    slope = unit(0.2, 0.9, 0.3)
    panorama = (1 + 0.5 * panorama_directions(60) @ slope)[..., None] * np.ones(3)
    light = main_light(panorama.astype(np.float32))
    assert angle_deg(light.direction, slope) < 5
    assert 0 < light.intensity @ LUMINANCE < 0.1 * 4 * np.pi


@given(scale=st.floats(1e-3, 1e3))
@settings(max_examples=10, deadline=None)
def test_scales_with_the_light(scale: float) -> None:
    one, scaled = main_light(room(40)), main_light(room(40) * np.float32(scale))
    np.testing.assert_allclose(scaled.direction, one.direction, atol=1e-5)
    np.testing.assert_allclose(scaled.intensity, one.intensity * scale, rtol=1e-4)


def test_negative_radiance_counts_as_black() -> None:
    panorama = lit(40, [((0, 0, 1), 10, 5.0)])
    below = np.where(panorama > 0, panorama, np.float32(-3))
    np.testing.assert_array_equal(main_light(below).intensity, main_light(panorama).intensity)


def test_three_lamps_are_found_in_order_of_their_light() -> None:
    lamps = [((1, 0.3, 0), 4, 30.0), ((-0.4, 0.5, 0.7), 6, 40.0), ((0, 0.6, -1), 8, 6.0)]
    lights = find_lights(lit(120, lamps, level=0.1))
    assert [light.number for light in lights] == [0, 1, 2]
    for light, (direction, radius_deg, radiance) in zip(lights, [lamps[1], lamps[0], lamps[2]], strict=True):
        assert angle_deg(light.direction, unit(*direction)) < 1.5
        # Drawn by whole pixels of 1.5 degrees: the smallest has 22 of them.
        assert light.radius_deg == pytest.approx(radius_deg, abs=0.5)
        np.testing.assert_allclose(light.intensity, radiance * cap_solid_angle(radius_deg), rtol=0.1)
        assert light.emitted == pytest.approx(1)


def test_no_more_than_three_lights_the_strongest() -> None:
    lamps = [(unit(np.cos(a), 0.4, np.sin(a)), 5, 20.0 + 5 * n) for n, a in enumerate(np.arange(5) * 2 * np.pi / 5)]
    lights = find_lights(lit(60, lamps, level=0.1))
    assert len(lights) == MAX_LIGHTS
    for light, (direction, _, _) in zip(lights, lamps[:1:-1], strict=True):
        assert angle_deg(light.direction, direction) < 3


def test_shadow_strength_is_the_share_of_irradiance() -> None:
    """Level 0.5 gives pi x 0.5 to a facing surface; the lamp its radiance x solid angle."""
    lights = find_lights(lit(120, [((0.2, 1, 0.3), 5, 40.0)], level=0.5))
    lamp = 40 * cap_solid_angle(5)
    assert lights[0].shadow_strength == pytest.approx(lamp / (lamp + np.pi * 0.5), rel=0.03)
    alone = find_lights(lit(120, [((0.2, 1, 0.3), 5, 40.0)]))
    assert alone[0].shadow_strength == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    ("lights", "level", "main"),
    [
        # the lobe with most light, not the brightest, until the glint has more
        ([((0, 0.2, 1), 20, 4.0), ((0, 0.2, -1), 1.5, 60.0)], 0.3, 0),
        ([((0, 0.2, 1), 20, 4.0), ((0, 0.2, -1), 6, 60.0)], 0.3, 1),
        # a window against a bright table, which in the last case sends more light
        *(([((1, 0.3, 0), 10, 4.0), ((-0.7, -0.7, 0), 22, glare)], 0.2, 0) for glare in (0.5, 1.0, 2.0)),
        # a floor lamp under the position: far brighter than a surface in this room can be
        ([((1, 0.3, 0), 10, 1.0), ((-0.7, -0.7, 0), 5, 60.0)], 0.2, 1),
        # a lamp against a bright wall of more light
        ([((-1, 0, 0), 40, 0.5), ((0.7, 0.6, 0), 4, 40.0)], 0.2, 1),
    ],
)
def test_the_main_light_is_the_strongest_light_that_is_no_surface(lights, level: float, main: int) -> None:
    light = main_light(lit(120, lights, level=level))
    assert angle_deg(light.direction, unit(*lights[main][0])) < 1.5


def test_a_bright_table_alone_is_no_light() -> None:
    assert find_lights(lit(120, [((-0.7, -0.7, 0), 22, 1.0)], level=0.2)) == ()


@pytest.mark.parametrize("radius_deg", [30, 50])
def test_a_window_wider_than_a_lobe_counts_in_part(radius_deg: float) -> None:
    light = main_light(lit(120, [((0, 0, -1), radius_deg, 5.0)], level=0.5))
    assert angle_deg(light.direction, unit(0, 0, -1)) < radius_deg / 2
    assert 0.5 * 5 * cap_solid_angle(25) < light.intensity[0] < 1.2 * 5 * cap_solid_angle(25)


def test_a_light_is_saved_with_all_its_values() -> None:
    values = main_light(room(40)).to_json()
    assert set(values) == {"direction", "intensity", "radius_deg", "shadow_strength", "emitted", "number"}
    assert values["number"] == 0
    assert 0 < values["shadow_strength"] < 1


def test_lights_are_as_strong_as_in_the_light_that_they_are_measured_in():
    before = room(48)
    lights = find_lights(before)
    tracked = TrackedLights(replace(lights[0], intensity=0.5 * lights[0].intensity), lights)
    brighter = relit(tracked, before=before, after=2 * before)
    for light, stronger in zip(lights, brighter.sources, strict=True):
        assert stronger.intensity == pytest.approx(2 * light.intensity, rel=0.05)
        assert stronger.shadow_strength == pytest.approx(light.shadow_strength, abs=0.03)
        assert (stronger.direction == light.direction).all()
        assert stronger.number == light.number
    assert brighter.main.intensity == pytest.approx(lights[0].intensity, rel=0.05)  # half faded in, twice as bright
    near_second = panorama_directions(48) @ lights[1].direction[:, None] > 0.9
    swapped = relit(tracked, before=before, after=np.where(near_second, 10 * before, before))
    assert [light.number for light in swapped.sources] == [1, 0]
    dark = relit(tracked, before=before, after=np.full_like(before, 0.1))
    assert all(light.intensity.max() < 1e-3 for light in (dark.main, *dark.sources))
