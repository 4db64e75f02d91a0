"""Which walks are rendered: the first with places for its probes, and of as many frames as requested."""

import numpy as np
import pytest

from roomlight.dataset import sequence_files
from roomlight_generator.room_request import RoomRequest
from roomlight_generator.sequences import render as room_sequences
from roomlight_generator.sequences.exposure import expose
from roomlight_generator.sequences.render import CameraPath, plan_camera_path, record, render_walks
from roomlight_generator.sequences.walk import phone_intrinsics
from roomlight_generator.transport import FrameView


def drawn(monkeypatch, paths):
    """Let the walks that are tried be these, one after the other."""
    tried = iter(paths)
    monkeypatch.setattr(room_sequences, "draw_camera_path", lambda *_, **__: next(tried))


@pytest.mark.slow
def test_walks_without_places_for_probes_are_drawn_again(coarse_room, monkeypatch):
    path, later = (plan_camera_path(coarse_room, np.random.default_rng(number), frames=1) for number in range(2))
    drawn(monkeypatch, [None, None, path, later])
    assert plan_camera_path(coarse_room, np.random.default_rng(0), frames=1) is path


@pytest.mark.slow
def test_a_room_without_any_walk_is_named(coarse_room, monkeypatch):
    drawn(monkeypatch, [None] * 12)
    with pytest.raises(ValueError, match=f"{coarse_room.room.name}: 12 walks .* no place for 3 probes"):
        plan_camera_path(coarse_room, np.random.default_rng(0), frames=1)


@pytest.mark.slow
@pytest.mark.usefixtures("small_views")
def test_a_single_view_is_a_sequence_of_one_frame(coarse_room):
    views = list(render_walks(coarse_room, RoomRequest(1, 21, "train", count=2, frames=1)))
    for view in views:
        assert view.colour.shape == (1, 48, 64, 3)
        assert view.depth_mm.shape == view.surface.shape == (1, 48, 64)
        assert view.probe_panoramas.shape == (3, 16, 32, 3)
        assert view.exposure.tolist() == [1.0]
    assert (views[0].camera_to_world != views[1].camera_to_world).any()


@pytest.mark.usefixtures("small_views")
def test_the_sun_in_a_probe_keeps_its_light_and_hue():
    sun_kcd_m2 = np.float32([1e6, 8e5, 5e5])

    class Sunny:
        def frame(self, intrinsics, camera_to_world, *, seed):
            del intrinsics, camera_to_world, seed
            grey = np.full((48, 64, 3), np.float32(0.4))
            return FrameView(grey, grey[..., 0], np.zeros((48, 64), np.uint8))

        def panorama(self, position, height=120, *, seed):
            del position, seed
            return np.tile(sun_kcd_m2, (height, 2 * height, 1))

        depth = frame

    rng = np.random.default_rng(0)
    path = CameraPath(phone_intrinsics(rng, 64, 48), np.eye(4)[None], np.zeros((1, 3)))
    made = record(Sunny(), path, rng, name="sunny", facts={}, expose=expose)
    stored = sequence_files.decode(sequence_files.encode(made), "here").probe_panoramas
    expected = sun_kcd_m2 * made.facts["white_balance"] / made.facts["white_kcd_m2"]
    np.testing.assert_allclose(stored, np.broadcast_to(expected, stored.shape), rtol=1e-3)
