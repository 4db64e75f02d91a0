"""The 3D networks: shapes, clearing, ranges, merging, the GRUs, warm start."""

import pytest
import torch

from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel, VideoModel
from roomlight_model.volume_networks import SGGRU, SGDecoder, SGEncoder, SGVolume, merge

SHAPE = (17, 14, 23)  # halves to 8 7 11, 4 3 5, 2 1 2: nothing divides
TINY = SGConfig(volume_shape=SHAPE, channels=8, full_channels=4)
CONFIG = ModelConfig(TINY, BlendConfig(height=16, channels=4, full_channels=4))


def volume(batch=1, *, shape=SHAPE, seed=0):
    """A random initial volume: HDR colour, alpha in [0, 1], e of -1 in about a third."""
    random = torch.Generator().manual_seed(seed)
    radiance = 5 * torch.rand((batch, 3, *shape), generator=random)
    alpha = torch.rand((batch, 1, *shape), generator=random)
    empty = -(torch.rand((batch, 1, *shape), generator=random) < 0.3).float()
    return torch.cat([radiance * alpha, alpha, empty], dim=1)


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(3)


@pytest.mark.parametrize("recurrent", [False, True])
@pytest.mark.parametrize(("shape", "half", "eighth"), [(SHAPE, (8, 7, 11), (2, 1, 2)), ((16,) * 3, (8,) * 3, (2,) * 3)])
def test_two_skips_and_the_renderers_layout(recurrent, shape, half, eighth):
    """Also of another size than the configuration's: training begins at half resolution."""
    given = volume(2, shape=shape)
    f0, f1 = SGEncoder(TINY)(given)
    assert (f0.shape, f1.shape) == ((2, 8, *half), (2, 32, *eighth))
    assert max(f0.abs().max(), f1.abs().max()) <= 1
    predicted = SGDecoder(TINY, recurrent=recurrent)(f0, f1, given)
    assert (predicted.alpha.shape, predicted.lobes.shape) == ((2, *shape), (2, *shape, 10))
    assert (predicted.update is not None) == recurrent
    if recurrent:
        assert predicted.update.shape == (2, *shape)
        assert ((predicted.update > 0) & (predicted.update < 1)).all()


def test_voxels_that_the_depth_map_empties_are_cleared_and_others_are_in_range():
    given = volume(2)
    predicted = SingleModel(CONFIG)(given)
    cleared = given[:, 4] == -1
    assert cleared.any()
    assert not predicted.alpha[cleared].any()
    assert not predicted.lobes[cleared].any()
    assert predicted.alpha[~cleared].all()
    lobes = predicted.lobes[~cleared]
    assert ((predicted.alpha >= 0) & (predicted.alpha <= 1)).all()
    assert (lobes[:, :6] >= 0).all()
    assert (lobes[:, 6] > 0).all()
    # float32 rounding of a square root and a division
    torch.testing.assert_close(lobes[:, 7:].norm(dim=1), torch.ones(len(lobes)), atol=1e-5, rtol=0)


def test_starts_nearly_clear_where_nothing_was_seen():
    """The head's bias of -3 lets the first gradients reach every voxel of a ray."""
    given = volume()
    given[:, :4, :8] = 0
    alpha = SingleModel(CONFIG)(given).alpha
    assert 0.02 < alpha[:, :8][given[:, 4, :8] == 0].mean() < 0.12


def test_direct_heads_start_as_a_copy_of_what_was_seen():
    given = volume()
    given[:, 3] = (given[:, 3] > 0.5).float()
    given[:, :3] = given[:, 3:4] * (0.05 + given[:, :3].clamp(max=1))
    model = SingleModel(CONFIG)
    for parameter in model.sg_decoder.heads.parameters():
        parameter.data[:] = parameter.data.clone() if parameter.ndim == 1 else 0
    predicted = model(given)
    seen = (given[:, 3] == 1) & (given[:, 4] == 0)
    colour = given[:, :3].permute(0, 2, 3, 4, 1)[seen]
    torch.testing.assert_close(predicted.lobes[seen][:, :3], colour + 0.02, rtol=1e-4, atol=1e-5)
    assert (predicted.alpha[seen] > 0.85).all()
    assert (predicted.alpha[(given[:, 3] == 0) & (given[:, 4] == 0)] < 0.06).all()


def yellow_room(level=1.0):
    """A frame that shows yellow surfaces in half of the volume and leaves the rest unseen."""
    given = torch.zeros((1, 5, *SHAPE))
    given[:, 3, :8] = 1
    given[:, :3, :8] = level * torch.tensor([0.8, 0.6, 0.2])[:, None, None, None] * (0.7 + 0.6 * torch.rand(SHAPE)[:8])
    return given


def first_colours(given):
    """c where nothing was seen, before any training; the heads' own random weights set to 0."""
    model = SingleModel(CONFIG)
    model.sg_decoder.heads.weight.data.zero_()
    return model(given).lobes.detach()[0, ..., :3]


def test_unseen_walls_begin_in_the_rooms_own_colour():
    colours = first_colours(yellow_room())[8:].mean(dim=(0, 1, 2))
    assert colours / colours[1] == pytest.approx(torch.tensor([0.82 / 0.62, 1.0, 0.22 / 0.62]), rel=0.1)


def test_unseen_voxels_start_from_their_surroundings():
    given = torch.zeros((1, 5, *SHAPE))
    given[:, 3, :2], given[:, 3, -2:] = 1, 1
    given[:, :3, :2] = torch.tensor([0.8, 0.2, 0.2])[:, None, None, None]
    given[:, :3, -2:] = torch.tensor([0.2, 0.2, 0.8])[:, None, None, None]
    red, _, blue = first_colours(given).mean(dim=(1, 2)).T
    assert red[2] > 0.6 > 0.3 > blue[2]
    assert blue[-3] > 0.6 > 0.3 > red[-3]
    assert float(red[8]) == pytest.approx(float(blue[8]), rel=0.3)


def test_a_window_fills_its_surroundings_with_at_most_white():
    given = yellow_room()
    given[:, :3, :8, :, 12:] = 50.0
    around = first_colours(given)[8:]
    assert 0.7 < around.max() < 1.1
    assert first_colours(given)[:8, :, 12:].min() > 45  # what was seen itself stays as bright as it is


def test_twice_the_input_light_gives_twice_the_light():
    model = SingleModel(CONFIG)
    torch.manual_seed(3)
    dim = model(yellow_room(0.4)).lobes.detach()[..., :6]
    torch.manual_seed(3)
    bright = model(yellow_room(0.8)).lobes.detach()[..., :6]
    assert (bright / dim).mean() == pytest.approx(2, rel=0.15)
    nothing = model(torch.zeros((1, 5, *SHAPE))).lobes.detach()[..., :3]
    assert nothing.mean() == pytest.approx(0.3, rel=0.2)  # a black volume: grey, not an end of all light


def test_absurdly_bright_input_stays_finite():
    given = volume()
    given[:, :3] *= 1e6
    predicted = SingleModel(CONFIG)(given)
    assert torch.isfinite(predicted.lobes).all()
    assert predicted.lobes[..., :6].max() <= 22_027  # e^10: c + w still fits half precision


def test_every_voxel_depends_on_the_whole_volume():
    """128 voxels are beyond all convolutions: only the global view transmits the change (normalisation is off)."""
    model = SingleModel(ModelConfig(SGConfig(channels=4, full_channels=4)))
    for block in [part for part in model.modules() if isinstance(part, torch.nn.Sequential)]:
        for number, layer in enumerate(block):
            if isinstance(layer, torch.nn.GroupNorm):
                block[number] = torch.nn.Identity()
    dark = volume(shape=(128, 8, 8))
    lit = dark.clone()
    lit[:, :3, 0] += 50
    assert not torch.equal(model(dark).lobes[:, -1], model(lit).lobes[:, -1])


def test_autocast_heads_are_float32():
    with torch.autocast("cpu", dtype=torch.bfloat16):
        predicted = SingleModel(CONFIG)(volume())
    assert predicted.alpha.dtype == torch.float32
    assert predicted.lobes.dtype == torch.float32
    assert torch.isfinite(predicted.lobes).all()


def test_merge_is_a_convex_mix_of_every_channel():
    alpha, lobes, update = torch.rand(2, 1, *SHAPE), torch.rand(2, 1, *SHAPE, 10), torch.rand(1, *SHAPE)
    merged = merge(SGVolume(alpha[0], lobes[0], update), alpha[1], lobes[1])
    expected = torch.lerp(lobes[0], lobes[1], update[..., None].expand_as(lobes[0]))
    torch.testing.assert_close(merged.lobes, expected)
    torch.testing.assert_close(merged.alpha, torch.lerp(alpha[0], alpha[1], update))


@pytest.mark.parametrize("kernel", [1, 3])
def test_gru_gates_do_what_they_are_for(kernel):
    gru = SGGRU(4, gate_kernel=kernel)
    gates_bias = gru.get_parameter("gates.bias")
    hidden, feature = torch.rand(1, 4, 5, 6, 7) * 2 - 1, torch.rand(1, 4, 5, 6, 7) * 2 - 1
    gates_bias.data[:4] = 100.0  # keep all
    assert torch.equal(gru(hidden, feature), hidden)
    gates_bias.data[:4] = -100.0  # keep nothing
    gates_bias.data[4:] = -100.0  # and reset what the candidate sees
    assert torch.equal(gru(hidden, feature), gru(-hidden, feature))
    assert not torch.equal(gru(hidden, feature), gru(hidden, -feature))


def test_hidden_states_cannot_drift():
    """40 frames of violent input: the state stays within [-1, 1], where it started."""
    gru = SGGRU(4)
    for weight in gru.parameters():
        weight.data *= 10
    hidden = torch.tanh(torch.randn(1, 4, 3, 4, 5))
    for _ in range(40):
        hidden = gru(hidden, torch.tanh(5 * torch.randn(1, 4, 3, 4, 5)))
    assert hidden.abs().max() <= 1


def test_video_begins_with_the_single_view_networks():
    model = VideoModel(CONFIG)
    volumes = torch.stack([volume(seed=1), volume(seed=2)], dim=1)
    state = model.start(volumes[:, 0])
    assert torch.equal(state.volume.lobes, model.single(volumes[:, 0]).lobes)
    f0, f1 = model.single.sg_encoder(volumes[:, 0])
    assert torch.equal(state.h0, f0)
    assert torch.equal(state.h1, f1)
    after = model.step(volumes[:, 1], state)
    assert not torch.equal(after.h0, state.h0)
    assert not torch.equal(after.h1, state.h1)


def test_gradients_reach_every_3d_weight():
    model = VideoModel(CONFIG)
    state = model.start(volume(seed=0))
    total = state.volume.lobes.sum() + state.volume.alpha.sum()
    for seed in (1, 2):
        state = model.step(volume(seed=seed), state)
        total = total + state.volume.lobes.sum() + state.volume.alpha.sum()
    total.backward()
    silent = [
        name
        for name, weight in model.named_parameters()
        if "blend" not in name and (weight.grad is None or not weight.grad.any())
    ]
    assert not silent


def test_warm_start_predicts_as_the_single_view_model():
    model = VideoModel(CONFIG)
    model.warm_start()
    given = volume()
    single = model.single(given)
    video = model.sg_decoder(*model.sg_encoder(given), given)
    # one head more, or five panels of zeros: the convolutions sum in another order
    torch.testing.assert_close(video.alpha, single.alpha, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(video.lobes, single.lobes, atol=1e-5, rtol=1e-5)
    panels = torch.rand(1, 13, 16, 32)
    wanted = model.single.blend_encoder(panels[:, 3:11])
    torch.testing.assert_close(model.blend_encoder(panels), wanted, atol=1e-5, rtol=1e-5)
