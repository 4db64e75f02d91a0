"""Radiance of clipped pixels: the network's input, and what its estimate changes."""

from dataclasses import replace

import numpy as np
import pytest

from fixture_rooms import FOLDER, FRAMES
from part_models import write_part
from present import present
from roomlight.dataset.loader import Dataset
from roomlight.depth import complete_depth
from roomlight.engine.networks.clipping import (
    CHANNELS,
    SIDE,
    ClippingModel,
    Placement,
    clipping_planes,
    shipped_clipping,
    white_of,
)
from roomlight.engine.networks.graphs import load_part
from roomlight.frame import Frame
from rooms import BoxRoom, camera_at, pinhole, saturated


@pytest.fixture
def frame():
    """Looks down at 35 degrees: floor below, wall above."""
    return BoxRoom().frame(camera_at((0.0, 1.4, 1.5), pitch_degrees=-35))


# --- the network's input


WHITE = np.float32(0.5)


def clipped(frame):
    """The frame as a camera gives it that saturates at `WHITE`."""
    marked = saturated(frame, float(WHITE))
    assert 0.02 < marked.clipped.mean() < 0.9
    return marked


def inside(frame, planes):
    height, width = frame.clipped.shape
    return Placement.of(width, height).inside(np.moveaxis(planes, 0, -1))


@pytest.mark.parametrize(
    ("size", "place"),
    [
        ((320, 240), Placement(160, 120, 0, 20)),
        ((240, 320), Placement(120, 160, 20, 0)),
        ((320, 180), Placement(160, 90, 0, 34)),
        ((100, 100), Placement(160, 160, 0, 0)),
        ((4000, 3), Placement(160, 2, 0, 78)),
    ],
)
def test_frames_lie_centred_in_even_numbers(size, place):
    assert Placement.of(*size) == place
    square = np.zeros((SIDE, SIDE), np.float32)
    assert place.inside(square).shape == (place.height, place.width)
    assert place.inside(square[::2, ::2], halved=True).shape == (place.height // 2, place.width // 2)


@pytest.mark.parametrize("size", [(320, 240), (240, 320), (64, 48), (42, 320)])
def test_planes_are_empty_outside_the_frame(size):
    frame = clipped(BoxRoom().frame(camera_at((0, 1.4, 1.5)), width=size[0], height=size[1]))
    planes = clipping_planes(frame, frame.depth_m)
    assert planes.shape == (CHANNELS, SIDE, SIDE)
    assert planes.dtype == np.float32
    assert np.isfinite(planes).all()
    outside = planes[4] == 0
    assert (~outside).sum() == Placement.of(*size).width * Placement.of(*size).height
    assert (planes[:, outside] == 0).all()
    assert (inside(frame, planes)[..., 4] == 1).all()


def test_planes_show_image_clipping_and_depth(frame):
    marked = clipped(frame)
    depth = marked.depth_m.copy()
    depth[:30] = 0
    view = inside(marked, clipping_planes(replace(marked, depth_m=depth), marked.depth_m))
    assert view[..., :3] == pytest.approx(np.minimum(marked.image / WHITE, 1), abs=1e-5)
    assert (view[..., 3] == marked.clipped).all()
    assert (view[..., 5] == (depth > 0)).all()
    assert view[..., 6] == pytest.approx(np.log1p(marked.depth_m))


def test_normals_of_known_planes_in_the_heading_frame():
    for yaw in (0, 90, 180, 270):
        frame = BoxRoom(size_m=(6.0, 3.0, 6.0)).frame(camera_at((0, 1.4, 0.0), yaw_degrees=yaw, pitch_degrees=-20))
        normals = inside(frame, clipping_planes(frame, frame.depth_m))[..., 7:10]
        assert normals[30, 80] == pytest.approx([0, 0, 1], abs=1e-3)  # the wall ahead
        assert normals[-10, 80] == pytest.approx([0, 1, 0], abs=1e-3)  # the floor


def test_height_of_rays_is_the_sine_of_their_elevation():
    frame = BoxRoom().frame(camera_at((0, 1.4, 1.5), yaw_degrees=35, pitch_degrees=-30))
    view = inside(frame, clipping_planes(frame, frame.depth_m))
    assert view[59, 80, 10] == pytest.approx(np.sin(np.radians(-30)), abs=0.01)
    assert view[0, 80, 10] > view[-1, 80, 10]


@pytest.mark.slow
@pytest.mark.parametrize("pitch", [-90, 90])
def test_the_heading_is_continuous_straight_up_and_down(pitch):
    """A surface that slants against the image: its normal leans to or away from the heading."""
    depth = np.linspace(1.0, 2.0, 48)[:, None].repeat(64, 1).astype(np.float32)
    grey = np.full((48, 64, 3), np.float32(0.5))
    straight, almost = (
        Frame(0, grey, np.zeros((48, 64), bool), depth, pinhole(64, 48), camera_at((0, 1, 0), 30, pitch * share))
        for share in (1.0, 0.9999)
    )
    planes = clipping_planes(straight, depth)
    assert abs(planes[9]).max() > 0.3
    assert planes == pytest.approx(clipping_planes(almost, depth), abs=1e-3)


# --- the network


@pytest.fixture(scope="module")
def shipped():
    return shipped_clipping("cpu")


@pytest.fixture(scope="module")
def five_times_white(tmp_path_factory):
    folder = write_part(tmp_path_factory.mktemp("part") / "clipping", "clipping", constant=np.log(5.0))
    return ClippingModel(load_part(folder, "clipping", provider="cpu"))


def test_a_frame_without_clipped_pixels_is_not_estimated(frame, five_times_white):
    assert five_times_white.restore(frame, frame.depth_m) is frame


def test_the_network_changes_saturated_channels_alone(frame, shipped):
    marked = clipped(frame)
    result = shipped.restore(marked, frame.depth_m)
    saturated = marked.clipped[..., None] & (marked.image >= 0.95 * white_of(marked))
    assert 0 < saturated[marked.clipped].mean() < 1
    assert (result.image[~saturated] == marked.image[~saturated]).all()
    assert (result.image[saturated] > marked.image[saturated]).any()
    assert result.image.dtype == np.float32


def test_estimates_are_never_below_the_measured_value(frame, tmp_path):
    folder = write_part(tmp_path / "clipping", "clipping", constant=-1.5)  # the least that the network says
    dark = ClippingModel(load_part(folder, "clipping", provider="cpu"))
    marked = clipped(frame)
    assert (dark.restore(marked, frame.depth_m).image == marked.image).all()


def test_a_higher_bound_of_another_exposure_is_kept(frame, five_times_white):
    """Pixels that an earlier frame of shorter exposure clipped too are at least that frame's white."""
    marked = clipped(frame)
    image = marked.image.copy()
    row, column = np.argwhere(marked.clipped)[0]
    image[row, column] = 7.0
    result = five_times_white.restore(replace(marked, image=image), frame.depth_m)
    assert result.image[row, column] == pytest.approx(7.0)
    others = marked.clipped & (image.max(-1) < 1)
    assert result.image[others].max() == pytest.approx(5 * WHITE, rel=1e-5)
    image[marked.clipped] = 4 * marked.image[marked.clipped]  # an earlier frame clipped most of them at 4 x white
    image[row, column] = WHITE
    result = five_times_white.restore(replace(marked, image=image), frame.depth_m, own_white=float(WHITE))
    assert result.image[row, column] == pytest.approx(5 * WHITE)
    assert result.image[others].max() == pytest.approx(5 * 4 * WHITE, rel=1e-5)


def test_estimates_are_in_units_of_the_frames_white(frame, shipped):
    marked = clipped(frame)
    once = shipped.restore(marked, frame.depth_m).image
    brighter = shipped.restore(replace(marked, image=marked.image * 8), frame.depth_m).image
    assert brighter == pytest.approx(8 * once, rel=1e-3)


@pytest.mark.parametrize("size", [(320, 240), (240, 320), (100, 60)])
def test_estimates_return_to_their_pixels(size, tmp_path):
    """A graph that returns its own image: what comes back is the frame, smoothed."""
    folder = write_part(tmp_path / "clipping", "clipping", image=1.0)
    model = ClippingModel(load_part(folder, "clipping", provider="cpu"))
    frame = BoxRoom().frame(camera_at((0, 1.4, 1.5), pitch_degrees=-35), width=size[0], height=size[1])
    found = model.log_radiance(frame, frame.depth_m)
    assert found.shape == frame.image.shape
    difference = np.abs(found - np.minimum(frame.image, 1))
    assert np.median(difference) < 0.01  # smooth walls
    assert np.quantile(difference, 0.9) < 0.1  # edges between them
    assert np.median(np.abs(found[::-1] - np.minimum(frame.image, 1))) > 0.05  # a flipped image would show


def test_a_frame_that_is_clipped_everywhere_is_finite(frame, shipped):
    white = replace(frame, image=np.ones_like(frame.image), clipped=np.ones_like(frame.clipped))
    for depth in (frame.depth_m, np.zeros_like(frame.depth_m)):
        result = shipped.restore(replace(white, depth_m=depth), depth).image
        assert np.isfinite(result).all()
        assert result.min() >= 1


def test_clipped_light_of_rooms_is_nearer_to_the_truth_than_twice_white(shipped):
    """Frames of a generated room that no network was trained on."""
    dataset = Dataset(FOLDER, "test")
    for number in range(FRAMES):
        recording = dataset.read(1, frames=[number], clipped=True)
        frame = recording.frame(0, recording.depth_mm[0])
        depth_m, where = complete_depth(frame.depth_m), frame.clipped
        assert where.sum() > 1000
        truth = np.maximum(present(recording.clipped_radiance)[0].astype(np.float32), frame.image)[where]
        twice = np.maximum(frame.image, np.float32(2 * white_of(frame)))[where]
        constant, learned = (
            np.square(np.log1p(estimate) - np.log1p(truth)).mean()
            for estimate in (twice, shipped.restore(frame, depth_m).image[where])
        )
        assert learned < constant


def test_a_large_lamp_comes_out_brighter_than_a_spot(shipped):
    """Lamps of eight times white on a wall, with depth: small clipped spots are mostly highlights."""

    def estimated(radius_m):
        room = BoxRoom(lamp=((0.5, 2.2, -2.5), radius_m))
        marked = saturated(room.frame(camera_at((0, 1.4, 1.0), pitch_degrees=10)))
        return float(np.median(shipped.restore(marked, marked.depth_m).image[marked.clipped]))

    assert 1 <= estimated(0.15) < estimated(0.4) < estimated(0.7)
