"""The counted memory of a session against the arrays that it holds."""

from dataclasses import replace

import numpy as np
import pytest

from present import present
from roomlight.engine.memory import KEYFRAME_BYTES, Footprint
from roomlight.engine.models.network_probe import NetworkProbe
from roomlight.engine.networks.graphs import SHIPPED, load_graphs
from rooms import BoxRoom, camera_at
from sessions import session_of


def everything_in(thing, met):
    """Bytes of all arrays that an object of this package refers to, each buffer counted once and as a whole."""
    if isinstance(thing, np.ndarray):
        while isinstance(thing.base, np.ndarray):
            thing = thing.base
        assert thing.base is None or isinstance(thing.base, int), type(thing.base)
    if id(thing) in met:
        return 0
    met[id(thing)] = thing
    if isinstance(thing, np.ndarray):
        return thing.nbytes
    if isinstance(thing, dict):
        return everything_in(list(thing.values()), met)
    if isinstance(thing, list | tuple):
        return sum(everything_in(item, met) for item in thing)
    if type(thing).__module__.startswith("roomlight.") and hasattr(thing, "__dict__"):
        return everything_in(vars(thing), met)
    return 0


@pytest.mark.parametrize("model", ["classical", "single", "video"])
def test_the_volume_and_a_networks_probe(tiny_video, model):
    weights = None if model == "classical" else tiny_video
    frame = BoxRoom().frame(camera_at((0.2, 1.4, 0.8)), width=64, height=48)
    session = session_of([frame], probes=[(0.2, 1.2, -0.2)], model=model, weights=weights, height=32)
    footprint = Footprint.of(None if weights is None else replace(load_graphs(weights), form=model), 32)
    volume, probe = present(session._room).volume, session._probes[0]
    assert footprint.volume == everything_in(volume, {id(volume.sglv.grid): None})
    if weights is not None:
        assert isinstance(probe.estimator, NetworkProbe)
        shared = dict.fromkeys(map(id, (probe.estimator._graphs, probe.estimator._prior)))
        assert footprint.probe == everything_in([probe.estimator, probe.panorama], shared)


@pytest.mark.parametrize(("started", "expected"), [(False, 300), (True, 300 + 1000 + 3 * KEYFRAME_BYTES)])
def test_the_total_counts_the_parts(started, expected):
    assert Footprint(1000, 100).total(keyframes=2, probes=3, started=started) == expected


@pytest.mark.slow
def test_twenty_keyframes_take_what_is_counted():
    """60 MB with networks: each keyframe held 3.6 MB, of which it can make 2.1 again."""
    session = session_of(probes=[(0.2, 1.2, -0.2)])
    room = BoxRoom(lamp=((0.0, 2.6, 0.0), 0.4))
    for number in range(40):
        pose = camera_at((0.3, 1.4, 0.2), 37.0 * number, 50.0 * np.sin(number))
        session.push(room.frame(pose, index=number, width=320, height=240))
    session.light_at((0.1, 1.0, 0.1))
    session.track((0.1, 1.1, 0.1))
    for _, mesh in session.meshes:
        assert len(mesh.faces) > 0
    assert session.keyframes >= 20
    counted = Footprint.of(None, 120).total(keyframes=session.keyframes, probes=2, started=True)
    assert 0.7 * counted < everything_in(session, {}) < 1.03 * counted
    with_networks = Footprint.of(load_graphs(SHIPPED / "single"), 120)
    assert with_networks.total(keyframes=20, probes=1, started=True) < 48e6
