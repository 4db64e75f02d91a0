"""The counted memory of a session against the arrays that it holds."""

from dataclasses import replace

import numpy as np
import pytest

from roomlight.engine.memory import KEYFRAME_BYTES, Footprint, release_free_memory
from roomlight.engine.networks.graphs import load_graphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.sglv import Sglv
from rooms import BoxRoom, camera_at


def arrays_in(thing):
    """The arrays of an object, in lists and bound graphs too."""
    if isinstance(thing, np.ndarray):
        return [thing]
    if isinstance(thing, Sglv):
        return [thing.alpha, thing.lobes]
    if isinstance(thing, FusedVolume):
        return [thing.colour, thing.opacity, thing.count, thing.clipping]
    if isinstance(thing, list | tuple):
        return [array for item in thing for array in arrays_in(item)]
    for name in ("arrays", "steps"):  # of bound graphs
        if hasattr(thing, name):
            return arrays_in(getattr(thing, name))
    return []


def held_by(thing):
    """Bytes of the arrays of an object, each buffer counted once."""
    found = {array.__array_interface__["data"][0]: array.nbytes for array in arrays_in(list(vars(thing).values()))}
    return sum(found.values())


def pushed(options):
    session = Session(options)
    session.track((0.2, 1.2, -0.2))
    session.push(BoxRoom().frame(camera_at((0.2, 1.4, 0.8)), width=64, height=48))
    return session


def test_the_classical_models_volume():
    session = pushed(SessionOptions(model="classical", height=16))
    assert Footprint.of(None, 16).volume == held_by(volume_of(session))


def volume_of(session):
    assert session._room is not None
    return session._room.volume


@pytest.mark.parametrize("form", ["single", "video"])
def test_the_networks_volume_and_probe(tiny_video, form):
    graphs = replace(load_graphs(tiny_video[1]), form=form)
    session = pushed(SessionOptions(model=form, weights=tiny_video[1], height=32))
    footprint = Footprint.of(graphs, 32)
    assert footprint.volume == held_by(volume_of(session))
    probe = session._probes[0]
    assert footprint.probe == held_by(probe.estimator) + held_by(probe.panorama)


@pytest.mark.parametrize(("started", "expected"), [(False, 300), (True, 300 + 1000 + 3 * KEYFRAME_BYTES)])
def test_the_total_counts_the_parts(started, expected):
    assert Footprint(1000, 100).total(keyframes=2, probes=3, started=started) == expected


def test_releasing_memory_runs_anywhere():
    release_free_memory()
