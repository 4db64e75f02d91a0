import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from light_rooms import cap_solid_angle, lit, mean_light, room, rotate_directions_90, rotate_panorama_90, unit

from roomlight.conventions import LUMINANCE, panorama_directions
from roomlight.light.main_light import main_light


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(np.dot(a, b), -1, 1)))


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
    # Within a pixel of its true centre: it is drawn by whole pixels.
    assert angle_deg(light.direction, unit(*direction)) < 180 / height
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


def test_the_lobe_with_most_light_is_chosen_not_the_brightest() -> None:
    window, glint = (0, 0.2, 1), (0, 0.2, -1)
    light = main_light(lit(120, [(window, 20, 4.0), (glint, 1.5, 60.0)], level=0.3))
    assert 4 * cap_solid_angle(20) > 60 * cap_solid_angle(1.5)
    assert angle_deg(light.direction, unit(*window)) < 1.5
    stronger = main_light(lit(120, [(window, 20, 4.0), (glint, 6, 60.0)], level=0.3))
    assert angle_deg(stronger.direction, unit(*glint)) < 1.5


@pytest.mark.parametrize("apart_deg", [15, 25, 40, 90, 170])
def test_of_two_lamps_the_stronger_is_the_main_light(apart_deg: float) -> None:
    apart = np.radians(apart_deg)
    strong, weak = (1, 0, 0), (np.cos(apart), 0, np.sin(apart))
    light = main_light(lit(120, [(strong, 4, 30.0), (weak, 4, 20.0)], level=0.2))
    assert angle_deg(light.direction, unit(*strong)) < 2.5


@pytest.mark.parametrize("radius_deg", [30, 50])
def test_a_window_wider_than_a_lobe_counts_in_part(radius_deg: float) -> None:
    panorama = lit(120, [((0, 0, -1), radius_deg, 5.0)], level=0.5)
    light = main_light(panorama)
    assert angle_deg(light.direction, unit(0, 0, -1)) < radius_deg / 2
    assert 0.5 * 5 * cap_solid_angle(25) < light.intensity[0] < 1.2 * 5 * cap_solid_angle(25)


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


def test_colour_is_the_lamps() -> None:
    light = main_light(lit(120, [((1, 1, 0), 5, [9.0, 6.0, 3.0])]))
    np.testing.assert_allclose(light.intensity / light.intensity[2], [3, 2, 1], rtol=1e-5)


@given(scale=st.floats(1e-3, 1e3))
@settings(max_examples=10, deadline=None)
def test_scales_with_the_light(scale: float) -> None:
    one, scaled = main_light(room(40)), main_light(room(40) * np.float32(scale))
    np.testing.assert_allclose(scaled.direction, one.direction, atol=1e-5)
    np.testing.assert_allclose(scaled.intensity, one.intensity * scale, rtol=1e-4)


def test_turns_with_the_room() -> None:
    before, after = main_light(room(120)), main_light(rotate_panorama_90(room(120)))
    np.testing.assert_allclose(after.direction, rotate_directions_90(before.direction), atol=1e-5)
    np.testing.assert_allclose(after.intensity, before.intensity, rtol=1e-4)


def test_moves_smoothly_with_a_moving_lamp() -> None:
    found = []
    for degrees in np.arange(0, 12, 0.5):
        swing = np.radians(degrees)
        lobe = np.exp(200 * (panorama_directions(60) @ unit(np.cos(swing), 0.3, np.sin(swing)) - 1))
        found.append(main_light((0.3 + 20 * lobe[..., None] * np.ones(3)).astype(np.float32)))
    steps = [angle_deg(a.direction, b.direction) for a, b in itertools.pairwise(found)]
    assert min(steps) > 0.3
    assert max(steps) < 0.7
    intensities = np.array([light.intensity[0] for light in found])
    assert np.ptp(intensities) < 0.02 * intensities.mean()


def test_negative_radiance_counts_as_black() -> None:
    panorama = lit(40, [((0, 0, 1), 10, 5.0)])
    below = np.where(panorama > 0, panorama, np.float32(-3))
    np.testing.assert_array_equal(main_light(below).intensity, main_light(panorama).intensity)


def test_refuses_an_invalid_panorama() -> None:
    with pytest.raises(ValueError, match="twice as wide as high, this is 30 x 16"):
        main_light(np.zeros((16, 30, 3), np.float32))
    with pytest.raises(ValueError, match="finite numbers only"):
        main_light(np.full((16, 32, 3), np.nan, np.float32))
