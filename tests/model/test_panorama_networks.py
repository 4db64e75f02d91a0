"""The 2D networks over panoramas: the weight's range, the seam, and the recursion of one probe."""

import pytest
import torch

from roomlight.conventions import LUMINANCE
from roomlight.engine.panorama.blend import UNSEEN_DEPTH
from roomlight_model.accumulate import Observation, fill_in
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.panorama_networks import (
    SINGLE_PANELS,
    VIDEO_PANELS,
    BlendDecoder,
    BlendEncoder,
    single_panels,
    video_panels,
)

HEIGHT = 24
BLEND = BlendConfig(height=HEIGHT, channels=4, full_channels=4)
CONFIG = ModelConfig(SGConfig(channels=4, full_channels=4), BLEND)


def observation(seed):
    random = torch.Generator().manual_seed(seed)
    mask = (torch.rand((1, 1, HEIGHT, 2 * HEIGHT), generator=random) < 0.5).float()
    return Observation(
        hdr=20 * torch.rand((1, 3, HEIGHT, 2 * HEIGHT), generator=random),
        ldr=torch.rand((1, 3, HEIGHT, 2 * HEIGHT), generator=random),
        mask=mask,
        depth=torch.rand((1, 1, HEIGHT, 2 * HEIGHT), generator=random) * mask,
    )


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(5)


@pytest.mark.parametrize("panels", [SINGLE_PANELS, VIDEO_PANELS])
def test_shapes_and_range(panels):
    seen = observation(0)
    f0, f1 = BlendEncoder(BLEND, panels=panels)(torch.rand(1, panels, HEIGHT, 2 * HEIGHT))
    assert f0.shape == (1, 4, 12, 24)
    assert f1.shape == (1, 16, 3, 6)
    decoder = BlendDecoder(BLEND)
    weight = decoder(f0, f1, seen.mask)
    assert weight.shape == (1, 1, HEIGHT, 2 * HEIGHT)
    assert ((weight > 0) & (weight < 1)).all()
    assert weight[seen.mask == 1].mean() > weight[seen.mask == 0].mean() + 0.3  # before any training


def test_sizes_that_do_not_halve():
    seen = torch.ones(1, 1, 30, 60)
    f0, f1 = BlendEncoder(BLEND, panels=SINGLE_PANELS)(torch.rand(1, 8, 30, 60))
    assert BlendDecoder(BLEND)(f0, f1, seen).shape == seen.shape


def test_rotating_the_panorama_rotates_the_weight():
    """Eight columns are one step of the coarsest level; the seam must not show. Tolerance: order of summation."""
    encoder, decoder = BlendEncoder(BLEND, panels=SINGLE_PANELS), BlendDecoder(BLEND)
    seen = observation(1)
    panels = single_panels(seen.hdr, seen.ldr, seen.mask)
    weight = decoder(*encoder(panels), seen.mask)
    turned = decoder(*encoder(panels.roll(8, dims=-1)), seen.mask.roll(8, dims=-1))
    torch.testing.assert_close(turned, weight.roll(8, dims=-1), atol=1e-6, rtol=0)


def test_panels_are_stacked_in_the_papers_order():
    seen = observation(2)
    previous, accumulated = torch.rand_like(seen.hdr), torch.full_like(seen.depth, UNSEEN_DEPTH)
    panels = video_panels(previous, seen.hdr, seen.ldr, mask=seen.mask, depth=seen.depth, accumulated_depth=accumulated)
    parts = [previous, seen.hdr, seen.ldr, seen.mask, 1 - seen.mask, seen.depth, accumulated]
    assert torch.equal(panels, torch.cat(parts, dim=1))
    assert torch.equal(single_panels(seen.hdr, seen.ldr, seen.mask), panels[:, 3:11])


def brightness(light):
    return torch.einsum("bchw,c->bhw", light, torch.from_numpy(LUMINANCE))


def test_single_view_blend_lies_between_its_panoramas():
    """In every channel where the mesh shows something; beyond it in brightness."""
    seen = observation(3)
    light, weight = SingleModel(CONFIG).blend(seen.hdr, seen.ldr, seen.mask)
    mixed = seen.hdr * (1 - weight) + seen.ldr * weight
    inside = (seen.mask == 1).expand_as(light)
    torch.testing.assert_close(light[inside], mixed[inside])
    torch.testing.assert_close(light, fill_in(mixed, seen.ldr, seen.mask, weight=weight * seen.mask))
    torch.testing.assert_close(brightness(light), brightness(mixed))


def test_a_probes_first_frame_is_the_single_view_panorama():
    seen = observation(4)
    model = VideoModel(CONFIG)
    state = model.blend_start(seen)
    light, weight = model.single.blend(seen.hdr, seen.ldr, seen.mask)
    torch.testing.assert_close(state.panorama.radiance, light)
    assert torch.equal(state.panorama.weight, weight * seen.mask)  # a fill was not seen


def test_probe_recursion():
    model = VideoModel(CONFIG)
    state = model.blend_start(observation(0))
    assert torch.equal(
        state.panorama.depth[observation(0).mask == 0],
        torch.full((1,), UNSEEN_DEPTH).expand(int((observation(0).mask == 0).sum())),
    )
    for seed in range(1, 5):
        before = state
        state = model.blend_step(observation(seed), before, margin=0.05)
        assert not torch.equal(state.h0, before.h0)
        assert not torch.equal(state.h1, before.h1)
        assert (state.panorama.weight >= before.panorama.weight).all()
        assert state.panorama.weight.max() <= 1
        assert state.panorama.radiance.min() >= 0
        assert brightness(state.panorama.radiance).max() <= 20


def test_gradients_reach_every_2d_weight():
    model = VideoModel(CONFIG)
    state = model.blend_start(observation(0))
    first = state.panorama.radiance.sum()
    for seed in (1, 2):
        state = model.blend_step(observation(seed), state, margin=0.05)
    (first + state.panorama.radiance.sum()).backward()
    silent = [
        name
        for name, weight in model.named_parameters()
        if "blend" in name and (weight.grad is None or not weight.grad.any())
    ]
    assert not silent
