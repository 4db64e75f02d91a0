"""Completion of a probe's panorama: what was observed stays, the rest is changed by the network and finite."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from part_models import write_part
from roomlight.engine import session as session_module
from roomlight.engine.completion import (
    BRIGHTEST,
    FARTHEST_M,
    HEIGHT,
    PANELS,
    CompletionBackend,
    CompletionModel,
    completion_panels,
)
from roomlight.engine.networks.graphs import load_part
from roomlight.engine.session import Session, SessionOptions
from rooms import BoxRoom, camera_at, pan

ROOM = BoxRoom(lamp=((0.3, 1.6, -2.5), 0.35))
PROBE = (0.1, 1.2, -0.6)


def known_model(folder, **graph):
    path = write_part(folder / f"completion-{len(list(folder.iterdir()))}", "completion", **graph)
    return CompletionModel(load_part(path, "completion", provider="cpu"))


def parts(folder, **graph):
    write_part(folder / "completion", "completion", **graph)
    write_part(folder / "clipping", "clipping", constant=1.0)
    return folder


def observed(seed=0, height=120):
    """Random panels' sources: detail, known, clipped, depth, fill."""
    rng = np.random.default_rng(seed)
    shape = (height, 2 * height)
    return {
        "detail": rng.exponential(1, (*shape, 3)).astype(np.float32),
        "known": (rng.random(shape) < 0.4).astype(np.float32),
        "clipped": rng.random(shape).astype(np.float32),
        "depth_m": rng.uniform(0.5, 6, shape).astype(np.float32),
        "fill": rng.exponential(0.5, (*shape, 3)).astype(np.float32),
    }


def test_panels_are_means_of_what_was_observed():
    given = observed()
    panels = completion_panels(**given)
    assert panels.shape == (PANELS, HEIGHT, 2 * HEIGHT)
    assert panels.dtype == np.float32

    def blocks(plane):
        return plane.reshape(60, 2, 120, 2, *plane.shape[2:]).sum(axis=(1, 3))

    count = blocks(given["known"])
    assert panels[3] == pytest.approx(count / 4)
    seen = count > 0
    for found, name in ((panels[:3], "detail"), (panels[4], "clipped"), (panels[5], "depth_m")):
        weight = given["known"].reshape(given["known"].shape + (1,) * (given[name].ndim - 2))
        expected = blocks(weight * given[name])[seen] / count[seen].reshape(-1, *(1,) * (given[name].ndim - 2))
        assert np.moveaxis(found, 0, -1)[seen] == pytest.approx(expected, rel=1e-4) if found.ndim == 3 else True
        assert found.ndim == 3 or found[seen] == pytest.approx(expected, rel=1e-4)
        assert (found[..., ~seen] == 0).all()
    assert panels[6:9] == pytest.approx(np.moveaxis(blocks(given["fill"]) / 4, -1, 0), rel=1e-4)


def test_panels_rotate_with_the_panorama():
    given = observed()
    rolled = completion_panels(**{name: np.roll(plane, 34, axis=1) for name, plane in given.items()})
    assert rolled == pytest.approx(np.roll(completion_panels(**given), 17, axis=2), abs=1e-4)


@pytest.mark.parametrize("height", [16, 32, 60, 120, 200])
def test_panels_have_one_size_for_every_panorama(height):
    panels = completion_panels(**observed(height=height))
    assert panels.shape == (PANELS, HEIGHT, 2 * HEIGHT)
    assert np.isfinite(panels).all()


def test_panels_are_limited():
    given = observed(height=60)
    given["detail"][:] = 1e12
    given["fill"][:] = 1e12
    given["depth_m"][:] = 1e6
    panels = completion_panels(**given)
    assert panels[:3].max() == panels[6:].max() == BRIGHTEST
    assert panels[5].max() == FARTHEST_M


@pytest.mark.parametrize("height", [32, 60, 120])
def test_observed_directions_keep_their_bits(height, tmp_path):
    model = known_model(tmp_path, constant=0.7)
    given = observed(height=height)
    fill, known = given["fill"], given["known"]
    result = model.complete(completion_panels(**given), fill, known)
    assert result.dtype == np.float32
    assert (result[known == 1] == fill[known == 1]).all()
    assert np.log1p(result[known == 0]) == pytest.approx(np.log1p(fill[known == 0]) + 0.7, rel=1e-5)


def test_partly_observed_directions_change_by_what_is_left(tmp_path):
    model = known_model(tmp_path, constant=-0.4)
    given = observed() | {"known": np.full((120, 240), np.float32(0.25))}
    result = model.complete(completion_panels(**given), given["fill"], given["known"])
    expected = np.maximum(np.expm1(np.log1p(given["fill"]) - 0.3), 0)
    assert result == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("constant", [-30.0, 30.0])
@pytest.mark.parametrize("radiance", [0.0, 1.0, 1e12])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_light_is_finite_for_black_bright_and_empty(constant, radiance, share, tmp_path):
    model = known_model(tmp_path, constant=constant)
    shape = (120, 240)
    image, known = np.full((*shape, 3), np.float32(radiance)), np.full(shape, np.float32(share))
    flat = np.full(shape, np.float32(1))
    panels = completion_panels(detail=image, known=known, clipped=flat, depth_m=flat, fill=image)
    result = model.complete(panels, image, known)
    assert np.isfinite(result).all()
    assert result.min() >= 0
    if share < 1:
        assert result.max() <= BRIGHTEST * 1.001


def test_threads_share_the_completion(tmp_path):
    model = known_model(tmp_path, image=0.1, constant=0.1)
    given = [observed(seed) for seed in range(6)]
    panels = [completion_panels(**one) for one in given]

    def complete(number):
        return model.complete(panels[number], given[number]["fill"], given[number]["known"])

    alone = [complete(number) for number in range(6)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(complete, [*range(6)] * 4))
    for index, image in enumerate(together):
        assert np.array_equal(image, alone[index % 6])


def light(options, frames):
    session = Session(options)
    handle = session.track(PROBE)
    for frame in frames:
        session.push(frame)
    return session.light(handle), session.light_at(PROBE)


def test_a_network_without_effect_is_the_classical_model(tmp_path):
    folder = parts(tmp_path)
    frames = pan(ROOM, 4)
    found, wanted = (
        light(SessionOptions(model=name, parts=folder, provider="cpu", height=60), frames)
        for name in ("completion", "classical")
    )
    for ours, theirs in zip(found, wanted, strict=True):
        assert ours.panorama == pytest.approx(theirs.panorama, rel=1e-4, abs=1e-6)  # a logarithm and back
        assert (ours.observed == theirs.observed).all()


def test_completion_changes_only_what_no_frame_shows(tmp_path):
    folder = parts(tmp_path, constant=0.5)
    frames = pan(ROOM, 4)
    (found, _), (wanted, _) = (
        light(SessionOptions(model=name, parts=folder, provider="cpu", height=60), frames)
        for name in ("completion", "classical")
    )
    seen = wanted.observed >= 1
    assert 0.05 < seen.mean() < 0.9
    # numba may reorder the blending of hdr with weight 0: the last bit
    assert found.panorama[seen] == pytest.approx(wanted.panorama[seen], rel=1e-6)
    unseen = wanted.observed == 0
    assert np.log1p(found.panorama[unseen]).mean() > np.log1p(wanted.panorama[unseen]).mean() + 0.2


def test_the_session_names_its_model(tmp_path):
    session = Session(SessionOptions(model="completion", parts=parts(tmp_path), provider="cpu"))
    assert session.model == "completion"


def test_an_empty_view_is_completed(tmp_path):
    """A probe that the frame does not see at all: black stays finite."""
    options = SessionOptions(model="completion", parts=parts(tmp_path, constant=0.3), provider="cpu", height=32)
    session = Session(options)
    session.push(ROOM.frame(camera_at((0.3, 1.4, 0.2)), width=32, height=24))
    panorama = session.light_at((0.0, 1.4, 400.0)).panorama
    assert np.isfinite(panorama).all()
    assert panorama.min() >= 0


def test_the_network_sees_what_it_was_trained_on(tmp_path, monkeypatch):
    """Training takes its panels from the accumulated panorama of the classical model, the engine before it."""
    shown = []

    class Recorder(CompletionModel):
        digest = "recorder"

        def __init__(self):
            pass

        def complete(self, panels, fill, known):
            shown.append((panels, known))
            return fill

    folder = parts(tmp_path)
    monkeypatch.setattr(session_module, "_backend", lambda *_: CompletionBackend(Recorder()))
    session = Session(SessionOptions(model="completion", parts=folder, provider="cpu"))
    handle = session.track(PROBE)
    session.push(pan(ROOM, 1)[0])
    state = session.panorama_state(handle)
    trained = completion_panels(
        detail=state.radiance, known=state.seen, clipped=state.clipped, depth_m=state.depth_m, fill=state.radiance
    )
    panels, known = shown[0]
    assert panels == pytest.approx(trained, abs=1e-5)
    assert (known == state.seen).all()
