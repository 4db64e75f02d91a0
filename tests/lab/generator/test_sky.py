"""Colours of black bodies and paints, and skies: energy, colour, position of the sun."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomlight.conventions import LUMINANCE, panorama_directions
from roomlight_generator.rooms.colour import blackbody_rgb, oklab_to_linear, paint
from roomlight_generator.rooms.scene import Sky, Sun
from roomlight_generator.rooms.sky import HEIGHT, SKY_KINDS, horizontal_irradiance, make_sky, vertical_irradiance

RGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)

# Horizontal illuminance in klx, sun included: CIE and IES daylight tables, and moonless town nights.
RANGES = {
    "clear": (15, 120),
    "partly_cloudy": (12, 115),
    "overcast": (4.5, 21),
    "golden": (3, 22),
    "dusk": (0.003, 0.6),
    "night": (1e-4, 0.3),
}


def chromaticity(rgb):
    x, y, z = RGB_TO_XYZ @ np.array(rgb)
    return x / (x + y + z), y / (x + y + z)


# Planckian chromaticities of the CIE 1931 observer; 2,856 K is illuminant A. The observer is an analytic fit: 0.004.
@pytest.mark.parametrize(
    ("kelvin", "x", "y"),
    [
        (2000, 0.5267, 0.4133),
        (2856, 0.4476, 0.4074),
        (4000, 0.3805, 0.3768),
        (6500, 0.3135, 0.3237),
        (10000, 0.2807, 0.2884),
    ],
)
def test_black_bodies_have_their_chromaticity(kelvin, x, y):
    np.testing.assert_allclose(chromaticity(blackbody_rgb(kelvin)), (x, y), atol=0.004)


def test_black_bodies_have_luminance_one_and_grow_bluer():
    ratios = []
    for kelvin in (1000, 1800, 2700, 4000, 6500, 9000, 20000):
        rgb = blackbody_rgb(kelvin)
        assert LUMINANCE @ np.array(rgb) == pytest.approx(1)
        assert min(rgb) >= 0
        ratios.append(rgb[2] / rgb[0])
    assert ratios == sorted(ratios)
    # D65 lies 0.003 off the Planckian locus: white at 6,500 K within a few percent.
    np.testing.assert_allclose(blackbody_rgb(6500), 1, atol=0.08)


@pytest.mark.parametrize("kelvin", [0, 799, -5, 1e6, float("nan")])
def test_impossible_temperatures_are_refused(kelvin):
    with pytest.raises(ValueError, match="between 800 and 100,000"):
        blackbody_rgb(kelvin)


@given(st.floats(0.015, 0.92), st.floats(0, 0.2), st.floats(0, 360))
@settings(max_examples=60)
def test_paint_has_the_requested_reflectance(level, chroma, hue):
    colour = paint(level, chroma, hue)
    assert LUMINANCE @ np.array(colour) == pytest.approx(level, rel=1e-6)
    assert all(0.0119 <= channel <= 0.931 for channel in colour)


def test_paints_have_their_hue():
    red, green, blue = paint(0.2, 0.1, 25), paint(0.3, 0.1, 145), paint(0.15, 0.1, 255)
    assert np.argmax(red) == 0
    assert np.argmax(green) == 1
    assert np.argmax(blue) == 2
    np.testing.assert_allclose(oklab_to_linear(np.array([1.0, 0.0, 0.0])), 1, atol=1e-3)


@pytest.mark.parametrize("kind", SKY_KINDS)
def test_skies_have_the_illuminance_of_their_kind(kind):
    low, high = RANGES[kind]
    for seed in range(6):
        sky = make_sky(kind, np.random.default_rng(seed))
        assert sky.panorama.shape == (HEIGHT, 2 * HEIGHT, 3)
        assert sky.panorama.dtype == np.float32
        assert np.isfinite(sky.panorama).all()
        assert sky.panorama.min() >= 0
        level = float(LUMINANCE @ horizontal_irradiance(sky))
        assert low <= level <= high
        assert 0 < float(LUMINANCE @ vertical_irradiance(sky, np.array([0.0, 0.0, 1.0]))) < 120
        # The sky is nowhere black, and nothing except the sun is brighter than 40 kcd/m2.
        brightness = sky.panorama @ LUMINANCE
        assert brightness[0].min() > 0
        assert brightness.max() < 40


@pytest.mark.parametrize("kind", ["clear", "golden", "partly_cloudy"])
def test_the_sun_is_near_toward_and_above_the_skyline(kind):
    toward = np.array([0.3, 0.0, -0.8])
    seen = 0
    for seed in range(8):
        sky = make_sky(kind, np.random.default_rng(seed), toward=toward, spread_degrees=20)
        if sky.sun is None:
            assert kind == "partly_cloudy"
            continue
        seen += 1
        sun = sky.sun
        assert np.linalg.norm(sun.direction) == pytest.approx(1)
        flat = sun.direction[[0, 2]] / np.linalg.norm(sun.direction[[0, 2]])
        assert float(flat @ toward[[0, 2]] / np.linalg.norm(toward)) >= np.cos(np.radians(20)) - 1e-6
        assert 7.9 <= np.degrees(np.arcsin(sun.direction[1])) <= 60
        assert 19 <= float(LUMINANCE @ np.array(sun.irradiance)) <= 101
        assert sun.irradiance[0] > sun.irradiance[2]
        # The sun's position shows sky, not a house: it is brighter than the mean of its row.
        row, column = np.unravel_index(np.argmax(panorama_directions(HEIGHT) @ sun.direction), (HEIGHT, 2 * HEIGHT))
        brightness = sky.panorama @ LUMINANCE
        assert brightness[row, column] > brightness[row].mean()
    assert seen >= 3


@pytest.mark.parametrize("kind", ["overcast", "dusk", "night"])
def test_overcast_dusk_and_night_skies_have_no_sun(kind):
    assert all(make_sky(kind, np.random.default_rng(seed)).sun is None for seed in range(4))


def test_unknown_skies_are_refused():
    with pytest.raises(ValueError, match="unknown sky 'sleet'"):
        make_sky("sleet", np.random.default_rng(0))


def test_a_uniform_surround_gives_pi_times_its_radiance():
    sky = Sky(np.full((HEIGHT, 2 * HEIGHT, 3), 2.0, np.float32))
    # 64 rows of pixel centres integrate the cosine to 0.1 %.
    np.testing.assert_allclose(horizontal_irradiance(sky), 2 * np.pi, rtol=1e-3)
    np.testing.assert_allclose(vertical_irradiance(sky, np.array([0.6, 5.0, 0.8])), 2 * np.pi, rtol=1e-3)


def test_sun_irradiance_scales_with_cosine_and_share():
    dark = np.zeros((HEIGHT, 2 * HEIGHT, 3), np.float32)
    sky = Sky(dark, Sun(np.array([0.6, 0.8, 0.0]), (10.0, 9.0, 8.0)))
    np.testing.assert_allclose(horizontal_irradiance(sky), [8, 7.2, 6.4])
    facing, away = np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    np.testing.assert_allclose(vertical_irradiance(sky, facing), [3, 2.7, 2.4])
    np.testing.assert_allclose(vertical_irradiance(sky, facing, sun_share=1), [6, 5.4, 4.8])
    np.testing.assert_allclose(vertical_irradiance(sky, away), 0)
