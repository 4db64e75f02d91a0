"""The main light of a panorama of which a part was inferred."""

import numpy as np
import pytest
from light_rooms import angle_deg, lit, unit

from roomlight.conventions import panorama_directions
from roomlight.engine.panorama.likely_light import likely_lights
from roomlight.light.main_light import NO_SOURCE, find_lights

WALL, LAMP = unit(1, 0.1, 0), unit(-0.5, 0.8, 0.3)


def glow(height, direction, strength, *, width=6.0):
    """Smooth light about a direction, as an estimate infers it."""
    return strength * np.exp(width * (panorama_directions(height) @ direction - 1))[..., None] * np.ones(3)


def half_seen(height, toward):
    return (panorama_directions(height) @ toward > 0).astype(np.float32)


@pytest.mark.parametrize("height", [16, 60, 120])
def test_in_a_panorama_that_was_seen_whole_the_strongest_light_is_the_main_light(height: int) -> None:
    panorama = lit(height, [(LAMP, 8, 40.0), (WALL, 8, 15.0)], level=0.3)
    lights = likely_lights(panorama, np.ones(panorama.shape[:2], np.float32))
    (first, *_) = find_lights(panorama)
    np.testing.assert_array_equal(lights.main.direction, first.direction)
    np.testing.assert_array_equal(lights.main.intensity, first.intensity)
    assert lights.main.number == 0
    assert len(lights.sources) == len(find_lights(panorama))


def test_light_that_was_inferred_outweighs_a_bright_wall() -> None:
    panorama = (lit(60, [(WALL, 15, 2.2)], level=0.3) + glow(60, LAMP, 1.2)).astype(np.float32)
    seen = half_seen(60, WALL)
    assert angle_deg(find_lights(panorama)[0].direction, WALL) < 5
    lights = likely_lights(panorama, seen)
    assert angle_deg(lights.main.direction, LAMP) < 20
    assert lights.main.number == NO_SOURCE
    assert angle_deg(lights.sources[0].direction, WALL) < 5
    assert 0 < lights.main.shadow_strength < 1
    assert lights.main.intensity.min() > 0


def test_a_lamp_that_was_seen_stays_the_main_light() -> None:
    panorama = (lit(60, [(WALL, 8, 60.0)], level=0.3) + glow(60, LAMP, 1.2)).astype(np.float32)
    lights = likely_lights(panorama, half_seen(60, WALL))
    assert angle_deg(lights.main.direction, WALL) < 2
    assert lights.main.number == 0


def test_broad_inferred_light_does_not_outweigh_a_lamp_that_is_much_stronger() -> None:
    panorama = (lit(60, [(WALL, 10, 15.0)], level=0.3) + glow(60, LAMP, 1.0, width=1.0)).astype(np.float32)
    lights = likely_lights(panorama, half_seen(60, WALL))
    assert angle_deg(lights.main.direction, WALL) < 2
    assert lights.main.intensity == pytest.approx(find_lights(panorama)[0].intensity)


def test_inferred_light_below_does_not_count() -> None:
    panorama = (0.3 + glow(60, unit(0.2, -1, 0), 3.0) + glow(60, LAMP, 1.0)).astype(np.float32)
    lights = likely_lights(panorama, np.zeros((60, 120), np.float32))
    assert angle_deg(lights.main.direction, LAMP) < 25


@pytest.mark.parametrize("seen", [0.0, 1.0])
@pytest.mark.parametrize("level", [0.0, 0.7])
def test_even_or_no_light_has_no_main_light(seen: float, level: float) -> None:
    panorama = np.full((60, 120, 3), level, np.float32)
    lights = likely_lights(panorama, np.full((60, 120), seen, np.float32))
    assert lights.sources == ()
    assert lights.main.direction[1] > 0.99
    assert lights.main.intensity.max() == 0
