"""Which walks are filmed: with views of the lit side, of as many frames as were asked for."""

import numpy as np
import pytest

from fixture_rooms import lit_room
from roomlight.conventions import panorama_solid_angles
from roomlight_generator.sequences import render as room_sequences
from roomlight_generator.sequences.render import plan_camera_path, render_walks


@pytest.fixture(scope="module")
def stage():
    return lit_room(0)


def first_views(stage, count):
    """How bright so many first views are, over the mean of the panoramas at their probes."""
    shots = [plan_camera_path(stage, np.random.default_rng(number), frames=1) for number in range(count)]
    brightness = []
    for shot in shots:
        view = stage.light.frame(shot.intrinsics.resized(40, 30), shot.poses[0], seed=0)
        panoramas = [stage.light.panorama(place, height=32, seed=1) for place in shot.probes]
        around = np.sqrt(panoramas).mean(axis=(0, 3))
        weight = np.broadcast_to(panorama_solid_angles(32), around.shape)
        brightness.append(np.sqrt(view.radiance).mean() / np.average(around, weights=weight))
    return np.array(brightness)


@pytest.mark.parametrize(("of", "views"), [(4, 12), (12, 5)])
def test_most_walks_begin_with_a_view_of_the_lit_side(stage, monkeypatch, of, views):
    monkeypatch.setattr(room_sequences, "_CHOICES", (1, 1, 1))
    anywhere = first_views(stage, views)
    monkeypatch.setattr(room_sequences, "_CHOICES", (of, of, of))
    chosen = first_views(stage, views)
    assert chosen.mean() > (1.1 if of == 4 else 1.2) * anywhere.mean()
    assert (chosen > anywhere - 0.1).all()  # the walk of the former is among those chosen from


def test_a_single_view_is_a_sequence_of_one_frame(stage):
    views = list(render_walks(stage, 0, seed=21, split="train", count=2, frames=1))
    for view in views:
        assert view.colour.shape == (1, 240, 320, 3)
        assert view.depth_mm.shape == view.surface.shape == (1, 240, 320)
        assert view.probe_panoramas.shape == (3, 120, 240, 3)
        assert view.exposure.tolist() == [1.0]
    assert (views[0].camera_to_world != views[1].camera_to_world).any()
