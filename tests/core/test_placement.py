"""Points to light by a pixel: above the surface that the pixel shows, or an error that says what to do."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from roomlight.errors import OptionError, ProbeError
from roomlight.placement import ABOVE_M, point_at_pixel, point_in_view
from rooms import BoxRoom, camera_at, pixel_of

ROOM = BoxRoom(size_m=(6.0, 3.0, 5.0))
EYE = (0.5, 1.5, 0.3)


@pytest.fixture(scope="module")
def frame():
    """A level view along -z: the wall at z = -2.5, floor and ceiling, 160 x 120 pixels."""
    return ROOM.frame(camera_at(EYE))


@pytest.mark.parametrize(
    ("pitch_degrees", "on_surface", "normal"),
    [(0.0, (0.2, 1.4, -2.5), (0, 0, 1)), (-35.0, (0.4, 0.0, -1.9), (0, 1, 0)), (35.0, (0.8, 3.0, -2.0), (0, -1, 0))],
)
@pytest.mark.parametrize("above_m", [0.0, 0.1, 0.5])
def test_point_is_above_the_surface(pitch_degrees, on_surface, normal, above_m):
    frame = ROOM.frame(camera_at(EYE, pitch_degrees=pitch_degrees))
    u, v = pixel_of(frame, on_surface)
    point = point_at_pixel(frame, u, v, above_m=above_m)
    # depth is that of the nearest depth pixel: half a pixel of a slanted floor is 2 cm here
    assert point == pytest.approx(np.asarray(on_surface) + above_m * np.asarray(normal), abs=0.025)


def test_coarser_depth_gives_the_same_point(frame):
    coarse = ROOM.frame(camera_at(EYE), depth_size=(40, 30))
    fine = point_at_pixel(frame, 80.0, 60.0)
    assert point_at_pixel(coarse, 80.0, 60.0) == pytest.approx(fine, abs=0.02)


def test_noise_of_depth_hardly_tilts_the_normal(frame):
    noise = np.random.default_rng(1).normal(0, 0.005, frame.depth_m.shape).astype(np.float32)
    noisy = replace(frame, depth_m=frame.depth_m + noise)
    u, v = pixel_of(frame, (0.2, 1.4, -2.5))
    assert point_at_pixel(noisy, u, v, above_m=1.0) == pytest.approx((0.2, 1.4, -1.5), abs=0.15)


def test_a_lone_depth_pixel_is_lifted_toward_the_camera(frame):
    depth = np.zeros_like(frame.depth_m)
    depth[30, 40] = 2.0
    point = np.array(point_at_pixel(replace(frame, depth_m=depth), 40.0, 30.0, above_m=0.5))
    surface = np.array(point_at_pixel(replace(frame, depth_m=depth), 40.0, 30.0, above_m=0.0))
    line = np.asarray(EYE) - surface
    assert point == pytest.approx(surface + 0.5 * line / np.linalg.norm(line), abs=0.002)


def test_a_pixel_outside_the_image_and_a_bad_distance_are_refused(frame):
    for u, v in ((-1.0, 5.0), (160.0, 5.0), (5.0, 120.0), (float("nan"), 5.0)):
        with pytest.raises(OptionError, match="image is 160 x 120 pixels: columns are 0 to 159, rows 0 to 119"):
            point_at_pixel(frame, u, v)
    for above_m in (-0.1, float("nan"), float("inf")):
        with pytest.raises(OptionError, match="above_m"):
            point_at_pixel(frame, 5.0, 5.0, above_m=above_m)


def test_what_is_no_frame_is_refused():
    for function, pixel in ((point_in_view, ()), (point_at_pixel, (1.0, 2.0))):
        with pytest.raises(OptionError, match="frame is of the type str; it must be Frame"):
            inspect.unwrap(function)("frame", *pixel)


def test_a_pixel_without_depth_names_the_nearest_with_depth(frame):
    depth = frame.depth_m.copy()
    depth[:, 40:80] = 0
    with pytest.raises(ProbeError, match=r"no depth at pixel 42,50 .* nearest pixel with depth is 39,50"):
        point_at_pixel(replace(frame, depth_m=depth), 42.0, 50.0)
    with pytest.raises(ProbeError, match="nor anywhere else"):
        point_at_pixel(replace(frame, depth_m=np.zeros_like(depth)), 42.0, 50.0)


def test_the_default_point_is_on_the_camera_axis(frame):
    point = point_in_view(frame)
    assert point[:2] == pytest.approx(EYE[:2])
    assert -2.5 < point[2] < EYE[2]
    assert ABOVE_M > 0
