import numpy as np
import pytest

from roomlight.camera import Intrinsics
from roomlight.errors import ProbeError
from roomlight.frame import Frame
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from rooms import WALLS, BoxRoom, camera_at

ROOM = BoxRoom(size_m=(6.0, 3.0, 4.0), pattern=0.0)


def frame_at(position: tuple[float, float, float], yaw_deg: float, *, index: int = 0, depth_step: int = 1) -> Frame:
    size = (120 // depth_step, 90 // depth_step)
    pose = camera_at(position, yaw_deg)
    return ROOM.frame(pose, index=index, width=120, height=90, depth_size=size, fov_degrees=90.0)


def interior(panorama: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours are on the same wall: where walls meet, a pixel is a mixture."""
    same = np.ones(panorama.shape[:2], bool)
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        same &= (np.roll(panorama, step, axis=axis) == panorama).all(axis=-1)
    return same


@pytest.mark.parametrize("position", [(0.0, 1.5, 0.0), (0.7, 1.1, -1.1)])
@pytest.mark.parametrize("depth_step", [1, 3])
def test_warping_recovers_what_the_camera_sees(position: tuple[float, float, float], depth_step: int) -> None:
    method = WarpAndFill(height=30)
    method.push(frame_at((0.5, 1.7, 1.0), 20.0, depth_step=depth_step))
    panorama, mask = method.warped(position)
    expected, _ = ROOM.panorama(position, height=30)
    seen = (mask == 1) & interior(expected)
    assert seen.mean() > 0.1
    # a third of the depth resolution puts pixels next to a corner onto the wrong wall, nothing else
    wrong = np.abs(panorama - expected).max(axis=-1)[seen] > 1e-3
    assert wrong.mean() < (0.02 if depth_step == 1 else 0.1)


def test_a_full_pan_gives_the_room_and_gaps_are_filled() -> None:
    method = WarpAndFill(height=30)
    shares = []
    for index in range(4):
        method.push(frame_at((0.0, 1.5, 0.0), 90.0 * index, index=index))
        shares.append(method.warped((0.2, 1.6, 0.3))[1].mean())
        filled = method.light_at((0.2, 1.6, 0.3))
        assert np.isfinite(filled).all()
        assert filled.min() >= WALLS.min() - 1e-5
        assert filled.max() <= WALLS.max() + 1e-5
    assert shares == sorted(shares)
    # four frames of 90 x 74 degrees miss what is above and below them, 56 degrees or more on each side
    assert shares[-1] > 0.35


def test_the_nearest_point_is_kept_and_of_equals_the_newest() -> None:
    intrinsics = Intrinsics(20.0, 20.0, 20.0, 15.0, 40, 30)

    def wall(index: int, colour: float, depth_m: float) -> Frame:
        image = np.full((30, 40, 3), colour, np.float32)
        depth = np.full((30, 40), depth_m, np.float32)
        return Frame(index, image, np.zeros((30, 40), bool), depth, intrinsics, np.eye(4))

    method = WarpAndFill(height=16)
    ahead = (8, 8)  # v = 0.5, u = 0.25: along -z
    expected = []
    for index, (colour, depth_m) in enumerate([(0.2, 2.0), (0.4, 3.0), (0.6, 1.0), (0.8, 1.0)]):
        method.push(wall(index, colour, depth_m))
        expected.append(float(method.light_at((0.0, 0.0, 0.0))[ahead][0]))
    assert expected == pytest.approx([0.2, 0.2, 0.6, 0.8])


def test_large_frames_are_kept_at_the_size_of_the_engine() -> None:
    method = WarpAndFill()
    method.push(BoxRoom().frame(camera_at((0.0, 1.5, 0.0), 0.0), width=640, height=480))
    assert len(method._frames[0][0]) == 320 * 240


def test_pixels_without_depth_are_not_warped() -> None:
    frame = frame_at((0.0, 1.5, 0.0), 0.0)
    depth = np.zeros_like(frame.depth_m)
    blind = Frame(0, frame.image, frame.clipped, depth, frame.intrinsics, frame.camera_to_world)
    method = WarpAndFill(height=10)
    method.push(blind)
    np.testing.assert_array_equal(method.light_at((0.0, 0.0, 0.0)), np.zeros((10, 20, 3)))


def test_mean_colour_is_the_mean_of_all_pixels_so_far_everywhere() -> None:
    method = MeanColour(height=8)
    np.testing.assert_array_equal(method.light_at((0.0, 0.0, 0.0)), np.zeros((8, 16, 3)))
    frames = [frame_at((0.0, 1.5, 0.0), yaw) for yaw in (0.0, 77.0)]
    for frame in frames:
        method.push(frame)
    panorama = method.light_at((1.0, 0.0, 0.0))
    expected = np.mean([frame.image.mean(axis=(0, 1), dtype=np.float64) for frame in frames], axis=0)
    np.testing.assert_allclose(panorama, np.broadcast_to(expected, panorama.shape), rtol=1e-5)


@pytest.mark.parametrize("method", [MeanColour(4), WarpAndFill(4)])
def test_an_invalid_position_is_refused(method: MeanColour | WarpAndFill) -> None:
    with pytest.raises(ProbeError, match="three finite numbers"):
        method.light_at((0.0, float("nan"), 0.0))
