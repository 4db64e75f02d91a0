"""Exposure and white balance that drift, in a room whose light is known exactly."""

from dataclasses import replace

import numpy as np
import pytest

from roomlight.captures import open_capture
from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight.engine.state.kept_frames import base_of_frame
from roomlight.metrics import log_l2
from roomlight.sample import sample_capture
from rooms import BoxRoom, camera_at
from sessions import session_from, session_of, state_of

LAMP = ((0.3, 1.6, -2.5), 0.35)
ROOM = BoxRoom(block=((-0.6, 0.0, -1.6), (0.5, 1.3, -1.0)), lamp=LAMP)
HEIGHT = 48
PROBES = ((0.3, 1.0, -0.5), (-0.8, 0.8, 0.8))


def _exposed(frame, gain=(1.0, 1.0, 1.0)):
    """The frame as a phone's 8-bit picture with these gains; `auto_exposed`."""
    image = srgb8_to_linear(linear_to_srgb8(np.minimum(frame.image * np.float32(gain), 1)))
    return replace(frame, image=image, clipped=image.max(-1) >= 1, auto_exposed=True)


def _look(yaw, index=0, room=ROOM):
    return room.frame(camera_at((0.3, 1.4, 0.2), yaw, -5), index=index)


FRAMES = [_look(9 * i, i) for i in range(16)]
_PHASE = np.arange(16)[:, None] / 3
GAINS = np.exp(-0.6 * np.sin(_PHASE) + 0.12 * (np.sin(_PHASE * [1.0, 1.3, 1.7] + [0, 2, 4]) - np.sin([0, 2, 4])))
"""Over 1.6 stops, and 10 % between colours; the first is 1."""


def _run(frames):
    session, scores = session_of(probes=PROBES, height=HEIGHT), []
    for frame in frames:
        session.push(frame)
        lights = [session.light(handle).reflection for handle in session.handles]
        truth = [ROOM.panorama(probe, HEIGHT)[0] for probe in PROBES]
        scores.append(np.mean([log_l2(light, true) for light, true in zip(lights, truth, strict=True)]))
    return session, float(np.mean(scores))


def _gain(*frames):
    """The gain that a session gives to the last of these frames."""
    session, _ = _run(frames)
    return session.snapshot().drift.gain


@pytest.mark.slow
def test_light_is_as_without_drift():
    steady, error = _run([_exposed(frame) for frame in FRAMES])
    drifting = [_exposed(frame, gain) for frame, gain in zip(FRAMES, GAINS, strict=True)]
    followed, with_drift = _run(drifting)
    _, ignored = _run([replace(frame, auto_exposed=False) for frame in drifting])
    assert steady.snapshot().drift.gain is None
    assert with_drift <= 1.05 * error
    assert ignored > 1.1 * error
    assert followed.snapshot().drift.gain == pytest.approx(tuple(1 / GAINS[-1]), rel=0.03)


@pytest.mark.slow
def test_the_gain_of_a_room_full_of_things_is_right_in_every_frame():
    """A walk through the sample's furnished room, two stops of drift: an eighth of an image has sharp edges there."""
    session = session_of(height=16)
    for frame, gain in zip(open_capture(sample_capture()), np.exp(0.7 * np.sin(np.arange(31) / 5)), strict=False):
        drifting = replace(frame, image=frame.image * np.float32(gain), auto_exposed=True)
        assert np.log(np.array(session.push(drifting).gain) * gain) == pytest.approx(np.zeros(3), abs=0.05)


@pytest.mark.parametrize("unknown", [0.0, 0.6])
def test_slow_drift_of_a_pan_is_followed(unknown):
    """2 % a frame: what it was before the frame is noticed stays, at most 8 %; a part of the depth is unknown."""
    drift, session = np.exp(-0.02 * np.arange(24)), session_of(height=16, unknown_depth="drop")
    for number, gain in enumerate(drift):
        frame = _exposed(_look(3 * number, number), np.full(3, gain))
        frame.depth_m[np.random.default_rng(number).random(frame.depth_m.shape) < unknown] = 0
        assert session.push(frame).gain[1] * gain == pytest.approx(1, abs=0.09)


def test_a_lens_that_darkens_its_corners_is_no_drift():
    """What is in the middle of the first picture is far from it in the second, and 40 % darker in the corners."""
    x, y = np.meshgrid(*(np.linspace(-1, 1, size) for size in FRAMES[0].image.shape[1::-1]))
    vignette = 1 - 0.2 * (x**2 + y**2)[..., None].astype(np.float32)
    walk = [ROOM.frame(camera_at((0.3, 1.4, z), 0, -5), index=number) for number, z in enumerate([0.2, -1.3])]
    assert _gain(*[_exposed(frame, vignette) for frame in walk]) is None


def test_without_drift_every_bit_stays():
    stated, _ = _run([replace(_exposed(frame), auto_exposed=False) for frame in FRAMES[:6]])
    unstated, _ = _run([_exposed(frame) for frame in FRAMES[:6]])
    assert state_of(stated) == state_of(unstated)


def test_of_stated_exposure_only_the_balance_is_corrected():
    first, second = _exposed(_look(0)), _look(9, 1)
    gain = _gain(first, replace(_exposed(second, (0.9, 0.6, 0.6)), auto_exposed=False))
    assert gain is not None
    red, green, blue = gain
    assert green == pytest.approx(1)
    assert (red, blue) == pytest.approx((2 / 3, 1), rel=0.03)


def test_light_that_is_switched_is_no_drift():
    """A little more than half of the view gets half as bright: no factor fits the surfaces."""
    first, second = _look(0), _look(0, 1)
    dimmed = second.image * np.where(np.arange(second.image.shape[1]) < 72, 1.0, 0.5)[:, None].astype(np.float32)
    assert _gain(_exposed(first), _exposed(replace(second, image=dimmed))) is None
    assert _gain(_exposed(first), _exposed(second, (0.5, 0.5, 0.5))) == pytest.approx((2.0,) * 3, rel=0.03)


def test_a_view_that_shares_nothing_keeps_the_last_gain():
    dark = (0.5, 0.5, 0.5)
    known = _gain(_exposed(_look(0)), _exposed(_look(9, 1), dark))
    assert _gain(_exposed(_look(0)), _exposed(_look(9, 1), dark), _exposed(_look(180, 2), dark)) == known


def test_a_gain_has_limits():
    """Colours stay within e^0.5 of their mean, the mean within e^3: gains of 4 and of 100 are not believed."""
    first = _look(0)
    gain = _gain(_exposed(first), _exposed(_look(0, 1), (1.0, 0.25, 1.0)))
    assert gain is not None
    assert gain[1] == pytest.approx(4 ** (1 / 3) * np.exp(0.5), rel=0.03)
    bright = replace(_exposed(_look(0)), image=100 * first.image)
    assert _gain(bright, _exposed(_look(0, 1))) == pytest.approx((np.exp(3.0),) * 3, rel=0.03)


def test_a_saved_session_goes_on_with_the_same_bits():
    frames = [_exposed(frame, gain) for frame, gain in zip(FRAMES, GAINS, strict=True)]
    whole, _ = _run(frames[:9])
    kept = [frame.index for frame in whole.snapshot().kept]
    bases = {index: base_of_frame(frames[index], whole.options) for index in kept}
    loaded = session_from(state_of(whole, kept), bases), session_from(state_of(whole))
    for session in (whole, *loaded):
        for frame in frames[9:13]:
            session.push(frame)
    assert state_of(whole) == state_of(loaded[0]) == state_of(loaded[1])
