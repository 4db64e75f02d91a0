"""Which walks are rendered: with first views of the lit side, and of as many frames as requested."""

import numpy as np
import pytest

from fixture_rooms import lit_room
from roomlight.conventions import panorama_solid_angles
from roomlight_generator.sequences import render as room_sequences
from roomlight_generator.sequences.render import plan_camera_path, render_walks
from roomlight_generator.sequences.walk import phone_intrinsics
from roomlight_generator.transport import patches


@pytest.fixture(scope="module")
def room():
    """A room as in a dataset."""
    return lit_room(0)


@pytest.fixture(scope="module")
def coarse_room():
    """A room whose light is solved with few rays."""
    with pytest.MonkeyPatch.context() as patch:
        for name, rays in (("GATHER_RAYS", 4), ("FIRST_RAYS", 4), ("SEED_RAYS", 2048)):
            patch.setattr(patches, name, rays)
        return lit_room(1)


@pytest.fixture
def small_views(monkeypatch):
    """Frames of 64 x 48 pixels and panoramas of 16 rows."""
    monkeypatch.setattr(room_sequences, "PROBE_HEIGHT", 16)
    monkeypatch.setattr(room_sequences, "phone_intrinsics", lambda rng: phone_intrinsics(rng, 64, 48))


def first_views(room, count):
    """Brightness of so many walks' first views over the mean of the panoramas at their probes."""
    paths = [plan_camera_path(room, np.random.default_rng(number), frames=1) for number in range(count)]
    brightness = []
    for path in paths:
        view = room.light.frame(path.intrinsics.resized(40, 30), path.poses[0], seed=0)
        panoramas = [room.light.panorama(place, height=32, seed=1) for place in path.probes]
        around = np.sqrt(panoramas).mean(axis=(0, 3))
        weight = np.broadcast_to(panorama_solid_angles(32), around.shape)
        brightness.append(np.sqrt(view.radiance).mean() / np.average(around, weights=weight))
    return np.array(brightness)


@pytest.mark.slow
@pytest.mark.statistical
@pytest.mark.parametrize(("of", "views"), [(4, 12), (12, 5)])
def test_most_walks_begin_with_a_view_of_the_lit_side(room, monkeypatch, of, views):
    monkeypatch.setattr(room_sequences, "_COMPARED_WALKS", (1, 1, 1))
    anywhere = first_views(room, views)
    monkeypatch.setattr(room_sequences, "_COMPARED_WALKS", (of, of, of))
    chosen = first_views(room, views)
    assert chosen.mean() > 1.1 * anywhere.mean()  # walls are bright all around: 1.13 for twelve walks
    assert (chosen > anywhere - 0.1).all()  # the walks compared include the former one


def test_of_the_compared_walks_the_brightest_is_taken(coarse_room, monkeypatch):
    compared = []

    def brightness(_, path):
        compared.append(path)
        return path.poses[0, 0, 3]  # as good as any, and quicker

    monkeypatch.setattr(room_sequences, "_COMPARED_WALKS", (3, 3, 3))
    monkeypatch.setattr(room_sequences, "_relative_brightness", brightness)
    taken = plan_camera_path(coarse_room, np.random.default_rng(0), frames=1)
    assert len(compared) == 3
    assert taken.poses[0, 0, 3] == max(path.poses[0, 0, 3] for path in compared)


@pytest.mark.usefixtures("small_views")
def test_a_single_view_is_a_sequence_of_one_frame(coarse_room, monkeypatch):
    monkeypatch.setattr(room_sequences, "_COMPARED_WALKS", (1, 1, 2))
    views = list(render_walks(coarse_room, 1, seed=21, split="train", count=2, frames=1))
    for view in views:
        assert view.colour.shape == (1, 48, 64, 3)
        assert view.depth_mm.shape == view.surface.shape == (1, 48, 64)
        assert view.probe_panoramas.shape == (3, 16, 32, 3)
        assert view.exposure.tolist() == [1.0]
    assert (views[0].camera_to_world != views[1].camera_to_world).any()


@pytest.mark.slow
def test_frames_and_panoramas_have_the_datasets_size(room):
    (view,) = render_walks(room, 0, seed=21, split="train", count=1, frames=1)
    assert view.colour.shape == (1, 240, 320, 3)
    assert view.depth_mm.shape == view.surface.shape == (1, 240, 320)
    assert view.probe_panoramas.shape == (3, 120, 240, 3)
