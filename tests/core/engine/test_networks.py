"""The engine's recursion on ONNX graphs against the same recursion in PyTorch, and its buffers."""

import dataclasses

import numpy as np
import pytest
import torch

from present import present
from roomlight.conventions import LUMINANCE
from roomlight.engine.models.interface import Rendered
from roomlight.engine.models.network_probe import OWN_COLOUR, hedged, muted
from roomlight.engine.models.network_volume import NetworkModel
from roomlight.engine.networks.graphs import load_graphs
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.panorama.blend import PanoramaState, PartialPanorama, fill_beyond, latest_detail
from roomlight.engine.session import Session, SessionOptions, warm_up
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import VolumeGrid, initial_volume
from roomlight.engine.volume.sglv import Sglv, render_panorama
from roomlight.errors import ModelError
from roomlight.metrics import log_l2
from roomlight_model.accumulate import Observation
from rooms import BoxRoom, camera_at, pan
from tiny_networks import tiny_network

ROOM = BoxRoom(lamp=((0.3, 1.6, -2.5), 0.35), lamp_radiance=1.0)  # above white networks have no part in the weight
FRAMES = pan(ROOM, 4, step_degrees=12, width=80, height=60)
PROBE = (0.1, 1.2, -0.5)
SHAPE = (16, 15, 21)
GRID = VolumeGrid.from_frame(FRAMES[0], shape=SHAPE)
HEIGHT = 32


@pytest.fixture(scope="module")
def graphs(tiny_video):
    return load_graphs(tiny_video, provider="cpu")


def _options(tiny_video, form, height=HEIGHT):
    return SessionOptions(model=form, weights=tiny_video, provider="cpu", height=height, hedge=0.0)


def _after(frames, session):
    """The session with a probe, after frames."""
    session.track(PROBE)
    for frame in frames:
        session.push(frame)
    return session


def _observation(sglv, frame, before):
    """What the session renders at the probe for one frame, as the networks' batch of one."""
    hdr, _ = render_panorama(sglv, PROBE, height=HEIGHT, far="boundary")
    partial = FrameMesh(frame).render_panorama(np.array(PROBE), height=HEIGHT)

    def batch(plane):
        array = np.atleast_3d(plane.astype(np.float32))
        return torch.from_numpy(np.moveaxis(array, -1, 0)[None].copy())

    state = PanoramaState.fresh(HEIGHT, GRID.depth_max_m)
    if before is not None:
        state.radiance[:] = np.moveaxis(before.radiance[0].numpy(), 0, -1)
        state.depth_m[:] = before.depth[0, 0].numpy() * GRID.depth_max_m
        state.observed[:] = before.weight[0, 0].numpy()
    ldr = fill_beyond(*latest_detail(state, partial), partial, hdr=hdr)
    depth = partial.depth_m / GRID.depth_max_m
    return Observation(batch(hdr), batch(ldr), batch(partial.mask), batch(depth))


def _sglv_of(volume):
    return Sglv(GRID, volume.alpha[0].numpy().copy(), volume.lobes[0].numpy().copy())


@torch.inference_mode()
def _in_torch():
    """(volumes, panorama states) of the video model over the frames, stepped in PyTorch."""
    model = tiny_network()
    sg, blend, volumes, panoramas = None, None, [], []
    for frame in FRAMES:
        given = torch.from_numpy(initial_volume(GRID, frame)[None])
        sg = model.start(given) if sg is None else model.step(given, sg)
        seen = _observation(_sglv_of(sg.volume), frame, blend and blend.panorama)
        margin = CLOSER_M / GRID.depth_max_m
        blend = model.blend_start(seen) if blend is None else model.blend_step(seen, blend, margin=margin)
        volumes.append(_sglv_of(sg.volume))
        panoramas.append(blend.panorama)
    return volumes, panoramas


def test_the_video_engine_is_the_recursion_in_pytorch(tiny_video):
    volumes, panoramas = _in_torch()
    session = Session(_options(tiny_video, "video"))
    session.track(PROBE)
    for frame, volume, panorama in zip(FRAMES, volumes, panoramas, strict=True):
        session.push(frame)
        # Graph weights are halves (2^-11 relative), and the HDR heads take an exponent of sums of dozens of them
        sglv = present(session.sglv)
        np.testing.assert_allclose(sglv.alpha, volume.alpha, atol=2e-3)
        np.testing.assert_allclose(np.log1p(sglv.lobes[..., :7]), np.log1p(volume.lobes[..., :7]), atol=1e-2)
        light = session.light(0).used_for("reflection")
        expected = np.moveaxis(panorama.radiance[0].numpy(), 0, -1)
        np.testing.assert_allclose(np.log1p(light.panorama), np.log1p(expected), atol=1e-2)
        np.testing.assert_allclose(light.observed, panorama.weight[0, 0].numpy(), atol=5e-3)


def test_inferred_light_is_as_bright_at_a_point_outside_the_volume(tiny_video):
    session = _after(FRAMES, Session(_options(tiny_video, "single")))
    lights = session.lights_at([PROBE, (0.0, 1.2, 4.0), (0.0, 1.2, 30.0)])
    brightest = [light.reflection.max(axis=-1)[light.observed == 0] for light in lights]
    inside, *outside = (float(np.median(inferred)) for inferred in brightest)
    assert min(outside) > inside


@torch.inference_mode()
def test_single_view_moves_half_way_to_the_mean_volumes_sglv(tiny_video):
    session = Session(_options(tiny_video, "single"))
    assert session.model == "single"
    model = tiny_network().single
    fused, given = FusedVolume.fresh(GRID.shape), np.empty((5, *GRID.shape), np.float32)
    alpha, lobes, targets = np.float32(0), np.float32(0), []
    for number, frame in enumerate(FRAMES[:4]):
        session.push(frame)
        fused.add(initial_volume(GRID, frame))
        fused.write(given)
        target, share = _sglv_of(model(torch.from_numpy(given[None]))), 0.5 if number else 1
        targets.append(target)
        alpha = (alpha + share * (target.alpha - alpha)) * (given[4] == 0)
        lobes = (lobes + share * (target.lobes - lobes)) * (given[4] == 0)[..., None]
        sglv = present(session.sglv)
        np.testing.assert_allclose(sglv.alpha, alpha, atol=2e-3)
        np.testing.assert_allclose(np.log1p(sglv.lobes[..., :7]), np.log1p(lobes[..., :7]), atol=1e-2)
    assert np.abs(alpha - targets[-1].alpha).max() > 1e-2  # it has not reached the target yet


def test_single_view_inference_moves_half_way(graphs):
    probe = NetworkModel(dataclasses.replace(graphs, form="single")).new_probe()
    random, shape = np.random.default_rng(2), (HEIGHT, 2 * HEIGHT)
    mask = random.random(shape) < 0.5
    seen = PartialPanorama(
        random.random((*shape, 3), np.float32) * mask[..., None], mask, mask * random.uniform(1, 2, shape).astype("f4")
    )
    state = PanoramaState.fresh(HEIGHT, GRID.depth_max_m)
    state.radiance[:] = random.uniform(0, 3, (*shape, 3))
    rendered = Rendered(random.uniform(0, 3, (*shape, 3)).astype(np.float32), np.zeros(shape, np.float32))
    first, second = (probe.estimate(state, rendered, seen, depth_max_m=GRID.depth_max_m) for _ in range(2))
    np.testing.assert_allclose(second.hdr, (first.hdr + state.radiance) / 2, rtol=1e-5)
    np.testing.assert_array_equal(second.weight, first.weight)


@pytest.mark.parametrize("form", ["single", "video"])
def test_the_hedge_is_between_networks_and_fill(tiny_video, form):
    alone, half, fill = (
        _after(FRAMES[:1], Session(dataclasses.replace(_options(tiny_video, form), hedge=share)))
        for share in (0.0, 0.5, 1.0)
    )
    networks, mean, fills = (np.log1p(session.light(0).reflection @ LUMINANCE) for session in (alone, half, fill))
    np.testing.assert_allclose(mean, (networks + fills) / 2, atol=0.03)
    unseen = half.light(0).observed == 0
    assert np.abs(networks - fills)[unseen].max() > 0.03


def test_inferred_colours_move_toward_the_mean_of_what_was_seen():
    green, known = np.array([0.1, 0.6, 0.2], np.float32), np.zeros((8, 16), np.float32)
    known[4:] = 1
    detail = np.full((8, 16, 3), 0.5, np.float32) * np.array([1.2, 1.0, 0.8], np.float32)
    quiet = muted(np.broadcast_to(green, (8, 16, 3)).copy(), detail, known)
    np.testing.assert_allclose(quiet @ LUMINANCE, green @ LUMINANCE, rtol=1e-5)
    mean = detail[0, 0] / (detail[0, 0] @ LUMINANCE) * (green @ LUMINANCE)
    np.testing.assert_allclose(quiet[0, 0], mean + OWN_COLOUR * (green - mean), rtol=1e-5)
    nothing = np.zeros_like(known)
    np.testing.assert_array_equal(muted(detail, detail, nothing), detail)


def test_hedged_light_has_no_more_error_than_the_mean_of_both():
    rng = np.random.default_rng(5)
    truth, *lights = (rng.exponential(size=(8, 16, 3)).astype(np.float32) for _ in range(4))
    errors = [log_l2(light, truth) for light in lights]
    assert log_l2(hedged(lights[0], lights[1:], share=2 / 3), truth) < np.mean(errors)
    np.testing.assert_allclose(hedged(lights[0], [lights[1]], share=1.0), lights[1], rtol=1e-5)


def test_the_first_frame_is_the_same_in_both_forms(tiny_video):
    video, single = (_after(FRAMES[:1], Session(_options(tiny_video, form))) for form in ("video", "single"))
    np.testing.assert_array_equal(video.light(0).panorama, single.light(0).panorama)


@pytest.mark.parametrize("height", [16, 48, 120])
@pytest.mark.parametrize("form", ["single", "video"])
def test_panoramas_of_other_heights_than_the_graphs(tiny_video, form, height):
    light = _after(FRAMES[:3], Session(_options(tiny_video, form, height))).light(0)
    assert light.panorama.shape == (height, 2 * height, 3)
    assert np.isfinite(light.panorama).all()
    assert light.panorama.min() >= 0
    assert 0 < light.observed.max() <= 1
    masks = [FrameMesh(frame).render_panorama(np.array(PROBE), height=height).mask for frame in FRAMES[:3]]
    assert (light.observed[~np.any(masks, axis=0)] == 0).all()


@pytest.mark.parametrize("form", ["single", "video"])
def test_finer_panoramas_are_sampled_without_mixing_surfaces(graphs, form):
    """Blocks of 3 x 3 with one surface in the middle and others around: the weight is that of the middle one's."""
    model = NetworkModel(dataclasses.replace(graphs, form=form))
    coarse, fine = model.new_probe(), model.new_probe()
    random, shape = np.random.default_rng(0), (HEIGHT, 2 * HEIGHT)
    for _ in range(3):
        mask = random.random(shape) < 0.6
        depth = np.where(mask, random.uniform(0.5, 4, shape), 0).astype(np.float32)
        radiance = (random.uniform(0, 1, (*shape, 3)) * mask[..., None]).astype(np.float32)
        hdr, held = (random.uniform(0, 3, (*shape, 3)).astype(np.float32) for _ in range(2))
        before = random.uniform(1, 9, shape).astype(np.float32)
        seen = np.ones(shape, np.float32)
        unclipped, three = np.zeros(shape, np.float32), np.zeros_like(held)
        small = coarse.weigh(
            PanoramaState(held, before, seen, unclipped, unclipped, unclipped, three, unclipped),
            hdr,
            PartialPanorama(radiance, mask, depth),
            GRID.depth_max_m,
        )
        around = (np.arange(3 * HEIGHT)[:, None] % 3 != 1) | (np.arange(6 * HEIGHT) % 3 != 1)
        partial = PartialPanorama(_thrice(radiance), _thrice(mask) | around, np.where(around, 0.7, _thrice(depth)))
        depth_m, none = np.where(around, 5, _thrice(before)), _thrice(unclipped)
        state = PanoramaState(_thrice(held), depth_m, _thrice(seen), none, none, none, _thrice(three), none)
        large = fine.weigh(state, _thrice(hdr), partial, GRID.depth_max_m)
        # means of nine equal floats differ from them in the last bit or two
        np.testing.assert_allclose(large[1::3, 1::3], small, atol=1e-5)


def _thrice(image):
    return np.repeat(np.repeat(image, 3, axis=0), 3, axis=1)


def test_sessions_on_shared_graphs_do_not_influence_each_other(graphs):
    first, second, alone = (Session(SessionOptions(height=HEIGHT), graphs=graphs) for _ in range(3))
    for session in (first, second, alone):
        session.track(PROBE)
    rotated = pan(ROOM, 3, start_degrees=90, width=80, height=60)
    for frame, elsewhere in zip(FRAMES, rotated, strict=False):
        first.push(frame)
        second.push(elsewhere)
        alone.push(frame)
    np.testing.assert_array_equal(first.light(0).panorama, alone.light(0).panorama)


def test_warm_up_runs_every_graph_and_keeps_no_state(graphs):
    fresh = _after(FRAMES[:1], Session(SessionOptions(height=HEIGHT), graphs=graphs))
    warm_up(graphs)
    warm = _after(FRAMES[:1], Session(SessionOptions(height=HEIGHT), graphs=graphs))
    np.testing.assert_array_equal(fresh.light(0).panorama, warm.light(0).panorama)


def test_the_volume_before_is_kept_while_the_next_is_written(graphs):
    recurrent = NetworkModel(graphs).begin(GRID)
    initial_volume(GRID, FRAMES[0], out=recurrent.volume)
    recurrent.update()
    first = recurrent.sglv
    kept = first.alpha.copy()
    initial_volume(GRID, FRAMES[1], out=recurrent.volume)
    recurrent.update()
    second = recurrent.sglv
    np.testing.assert_array_equal(first.alpha, kept)
    assert (second.alpha != kept).any()


def test_graphs_for_another_volume_are_refused(graphs):
    other = VolumeGrid.from_frame(ROOM.frame(camera_at((0, 1.5, 0)), width=80, height=60), shape=(16, 16, 16))
    with pytest.raises(ModelError, match=r"\(16, 15, 21\).*\(16, 16, 16\)"):
        NetworkModel(graphs).begin(other)
