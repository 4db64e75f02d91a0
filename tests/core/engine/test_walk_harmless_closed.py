"""Ten walks in closed rooms: light of directions that no frame shows does not grow when frames show the same again.

The camera pans over a part of the room, and twice more over the same part, with the small movements of a hand and a
narrower view. What the first pass showed may make the unseen part brighter or darker. The later ones show nothing new.
"""

from dataclasses import replace

import numpy as np
import pytest

from roomlight.conventions import panorama_solid_angles
from roomlight.engine.session import Session, SessionOptions
from rooms import BoxRoom, camera_at

PASSES, FRAMES, HEIGHT = 3, 7, 60
WIDE_DEG, NARROW_DEG = 75.0, 62.0
"""Fields of view of the first pass and of the later ones. The hand turns the camera by less than half the gap."""
NOISE = 1.05
"""Movements of the hand show other edges of the view: the unseen part beside them changes by some percent."""


def closed_walk(seed):
    """A room of random size and lamp, a probe, and frames at a phone's exposure: three passes over one part of it."""
    rng = np.random.default_rng([20, seed])
    size = (rng.uniform(3.5, 8), rng.uniform(2.4, 3.5), rng.uniform(3.5, 8))
    lamp = ((rng.uniform(-0.3, 0.3) * size[0], size[1], rng.uniform(-0.3, 0.3) * size[2]), rng.uniform(0.2, 0.5))
    room = BoxRoom(size, lamp=lamp, lamp_radiance=float(rng.uniform(4, 20)))
    start, turn, pitch = rng.uniform(0, 360), rng.uniform(60, 140), rng.uniform(-15, 15)
    frames = []
    for index in range(PASSES * FRAMES):
        along = index % FRAMES / (FRAMES - 1)
        along = along if (index // FRAMES) % 2 == 0 else 1 - along  # and back
        position = np.array([0.0, 1.4, 0.0]) + rng.normal(0, 0.01, 3)
        shake = rng.normal(0, 1, 2) * (index >= FRAMES)
        pose = camera_at(position, start + turn * along + shake[0], pitch + shake[1])
        fov = WIDE_DEG if index < FRAMES else NARROW_DEG
        frame = room.frame(pose, index=index, width=80, height=60, fov_degrees=fov)
        clipped = frame.image.max(-1) >= 1
        frames.append(replace(frame, image=np.minimum(frame.image, 1), clipped=clipped))
    return room, (0.3, 1.1, -0.2), frames


def unseen_energies(options, graphs, seed):
    """Energy of the directions that no frame shows after each pass, and their share of the sphere."""
    _, probe, frames = closed_walk(seed)
    session = Session(options, graphs=graphs)
    handle = session.track(probe)
    panoramas = []
    for index, frame in enumerate(frames, 1):
        session.push(frame)
        if index % FRAMES == 0:
            panoramas.append(session.estimate(handle).panorama)
    never = (session.light(handle).observed == 0) * panorama_solid_angles(HEIGHT)
    return [float((panorama.mean(-1) * never).sum()) for panorama in panoramas], float(never.sum() / (4 * np.pi))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_looking_again_brightens_nothing_unseen(seed):
    found, share = unseen_energies(SessionOptions(model="classical", provider="cpu", height=HEIGHT), None, seed)
    assert 0.2 < share < 0.9
    assert max(found[1:]) <= NOISE * found[0]
