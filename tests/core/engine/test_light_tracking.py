"""The lights of a tracked probe from frame to frame."""

import itertools

import numpy as np
import pytest
from light_rooms import angle_deg, lit, unit

from roomlight.engine.panorama.light_tracking import (
    CHALLENGE_FRAMES,
    DROP_FRAMES,
    MAX_TURN_DEG,
    SETTLE_FRAMES,
    LightTracker,
)
from roomlight.light.main_light import NO_SOURCE, MainLight, TrackedLights, find_lights, no_light

LEFT, RIGHT, BEHIND = unit(-1, 0.4, 0.2), unit(1, 0.4, 0.2), unit(0.1, 0.5, 1)


def lamp(direction, strength=1.0):
    return MainLight(np.asarray(direction, np.float64), strength * np.ones(3), 5.0, 0.5, 1.0)


def given(*lights):
    """The lights of a panorama, the strongest of them as its main light."""
    return TrackedLights(max(lights, key=lambda light: light.weight, default=no_light()), lights)


def found(**lamps):
    """Panorama with lamps at LEFT, RIGHT, BEHIND of the radiance given; what is found in it."""
    places = {"left": LEFT, "right": RIGHT, "behind": BEHIND}
    return find_lights(lit(60, [(places[name], 6, radiance) for name, radiance in lamps.items()], level=0.3))


def run(tracker, frames):
    lights = []
    for one in frames:
        tracker.update(given(*one))
        lights.append(tracker.lights)
    return lights


def settled(*lights):
    tracker = LightTracker()
    run(tracker, [lights] * (SETTLE_FRAMES + 1))
    return tracker


def steps_deg(lights):
    return [angle_deg(a.main.direction, b.main.direction) for a, b in itertools.pairwise(lights)]


def test_first_frames_follow_the_estimate_at_once() -> None:
    tracker = LightTracker()
    for number in range(SETTLE_FRAMES):
        one = lamp(LEFT if number % 2 else RIGHT, 1.0 + number)
        tracker.update(given(one))
        np.testing.assert_array_equal(tracker.lights.main.direction, one.direction)
        np.testing.assert_array_equal(tracker.lights.main.intensity, one.intensity)
        assert len(tracker.lights.sources) == 1


def test_unchanged_lights_stay_as_they_are() -> None:
    lights = found(left=20.0, right=30.0, behind=10.0)
    tracker = LightTracker()
    for state in run(tracker, [lights] * 12):
        np.testing.assert_allclose(state.main.direction, lights[0].direction, atol=1e-12)
        np.testing.assert_allclose(state.main.intensity, lights[0].intensity)
        assert [one.number for one in state.sources] == [0, 1, 2]
        assert state.main.number == 0


def test_two_equal_lamps_that_flicker_do_not_move_it() -> None:
    """Each is stronger by 10 % at every other frame: the estimate of one panorama jumps by 136 degrees."""
    frames = [found(left=20.0, right=22.0), found(left=22.0, right=20.0)] * 12
    raw = [angle_deg(a[0].direction, b[0].direction) for a, b in itertools.pairwise(frames)]
    assert min(raw) > 90
    lights = run(LightTracker(), frames)[SETTLE_FRAMES - 1 :]
    assert max(steps_deg(lights)) < 1
    assert len({one.main.number for one in lights}) == 1


def test_a_stronger_challenger_wins_after_its_frames() -> None:
    tracker = settled(lamp(LEFT), lamp(RIGHT, 0.9))
    lights = run(tracker, [(lamp(LEFT), lamp(RIGHT, 1.1))] * CHALLENGE_FRAMES)
    assert [angle_deg(one.main.direction, LEFT) > 1 for one in lights] == [False] * (CHALLENGE_FRAMES - 1) + [True]
    assert lights[0].main.intensity[0] == 1


def test_an_interrupted_challenge_starts_anew() -> None:
    tracker = settled(lamp(LEFT), lamp(RIGHT, 0.9))
    strong, even = (lamp(LEFT), lamp(RIGHT, 1.9)), (lamp(LEFT), lamp(RIGHT, 0.6))
    lights = run(tracker, ([strong] * (CHALLENGE_FRAMES - 1) + [even] * 2) * 6)
    assert angle_deg(lights[-1].main.direction, LEFT) < 1e-6


def test_a_handover_turns_at_most_the_stated_rate_and_dims_between_two_lamps() -> None:
    tracker = settled(lamp(LEFT))
    lights = run(tracker, [(lamp(LEFT, 0.2), lamp(RIGHT, 5.0))] * 40)
    assert max(steps_deg(lights)) <= MAX_TURN_DEG + 1e-6
    assert angle_deg(lights[-1].main.direction, RIGHT) < 1e-3
    np.testing.assert_allclose(lights[-1].main.intensity, 5.0, rtol=1e-3)
    between = [
        one.main
        for one in lights
        if min(angle_deg(one.main.direction, LEFT), angle_deg(one.main.direction, RIGHT)) > 50
    ]
    assert between
    assert max(light.intensity.max() for light in between) < 1.0
    assert max(light.shadow_strength for light in between) < 0.5


@pytest.mark.parametrize("other", ["right", "behind"])
def test_a_lamp_switched_off_hands_over_in_stated_frames(other: str) -> None:
    """After the frames of a challenge it turns; then it is at the other lamp, at 99 % of its light."""
    both, one = found(left=30.0, **{other: 20.0}), found(**{other: 20.0})
    tracker = LightTracker()
    run(tracker, [both] * 10)
    assert angle_deg(tracker.lights.main.direction, LEFT) < 1
    turn_frames = int(np.ceil(angle_deg(LEFT, one[0].direction) / MAX_TURN_DEG))
    lights = run(tracker, [one] * (DROP_FRAMES + turn_frames + 8))
    assert angle_deg(lights[CHALLENGE_FRAMES + turn_frames].main.direction, one[0].direction) < 5
    assert angle_deg(lights[-1].main.direction, one[0].direction) < 0.1
    np.testing.assert_allclose(lights[-1].main.intensity, one[0].intensity, rtol=0.01)
    assert [len(state.sources) for state in lights[DROP_FRAMES:]] == [1] * (turn_frames + 8)
    assert max(steps_deg(lights)) <= MAX_TURN_DEG + 1e-6


def test_a_lamp_fades_in_by_halves_and_out_until_it_is_dropped() -> None:
    tracker = settled(lamp(LEFT))
    lights = run(tracker, [(lamp(LEFT), lamp(RIGHT, 0.8))] * 4)
    strengths = [next(one for one in state.sources if one.number == 1).intensity[0] for state in lights]
    np.testing.assert_allclose(strengths, [0.4, 0.6, 0.7, 0.75])
    tracker = settled(lamp(LEFT), lamp(RIGHT, 0.8))
    lights = run(tracker, [(lamp(LEFT),)] * (DROP_FRAMES - 1))
    assert [len(state.sources) for state in lights] == [2] * (DROP_FRAMES - 1)
    fading = [state.sources[1].intensity[0] for state in lights]
    np.testing.assert_allclose(fading, [0.8 * 0.5**n for n in range(1, DROP_FRAMES)])
    lights = run(tracker, [(lamp(LEFT), lamp(RIGHT, 0.8))] * 12)  # found again in time, it keeps its number
    assert [one.number for one in lights[-1].sources] == [0, 1]
    np.testing.assert_allclose(lights[-1].sources[1].intensity, 0.8, rtol=1e-3)
    assert len(run(tracker, [(lamp(LEFT),)] * DROP_FRAMES)[-1].sources) == 1


def test_a_light_that_moves_is_followed_with_its_number() -> None:
    tracker = settled(lamp(unit(1, 0.5, 0)))
    for degrees in range(0, 90, 3):
        swing = np.radians(degrees)
        direction = unit(np.cos(swing), 0.5, np.sin(swing))
        tracker.update(given(lamp(direction)))
        assert angle_deg(tracker.lights.main.direction, direction) < 4
        assert tracker.lights.main.number == 0


def test_a_main_light_apart_from_all_lights_has_no_number() -> None:
    tracker = settled(lamp(LEFT))
    assert tracker.lights.main.number == 0
    for _ in range(30):
        tracker.update(TrackedLights(lamp(RIGHT), (lamp(LEFT),)))
    np.testing.assert_allclose(tracker.lights.main.direction, RIGHT, atol=1e-3)
    assert (tracker.lights.main.number, [one.number for one in tracker.lights.sources]) == (NO_SOURCE, [0])


def test_darkness_leaves_the_direction_and_no_intensity() -> None:
    tracker = settled(lamp(LEFT))
    lights = run(tracker, [()] * 30)
    assert max(steps_deg(lights)) < 1e-6
    assert lights[-1].main.intensity.max() < 1e-6
    assert lights[-1].sources == ()
    (dark,) = run(LightTracker(), [()])
    assert isinstance(dark, TrackedLights)
    assert (dark.main.direction.tolist(), dark.main.intensity.tolist()) == ([0, 1, 0], [0, 0, 0])  # from above


def test_opposite_lamps_hand_over_through_the_zenith() -> None:
    tracker = settled(lamp([1.0, 0.0, 0.0]))
    lights = run(tracker, [(lamp([-1.0, 0.0, 0.0], 5.0),)] * 40)
    assert max(one.main.direction[1] for one in lights) > 0.9
    assert min(one.main.direction[1] for one in lights) > -1e-6
    assert lights[-1].main.direction[0] == pytest.approx(-1)
    for one in lights:
        assert np.linalg.norm(one.main.direction) == pytest.approx(1)


def test_more_lights_than_three_are_cut_to_the_strongest() -> None:
    tracker = settled(lamp(LEFT), lamp(RIGHT, 0.9), lamp(BEHIND, 0.8))
    tracker.update(given(lamp(unit(0, 0.2, -1), 8.0), lamp(LEFT), lamp(RIGHT, 0.9)))
    assert len(tracker.lights.sources) == 3
    weights = [one.weight for one in tracker.lights.sources]
    assert weights == sorted(weights, reverse=True)
