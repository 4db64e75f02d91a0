"""The network of depth and its stage: what zoom leaves alone, published weights, batches, a step of training."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from box_room import LENS, exact_depth, frame, pose
from roomlight.camera import Intrinsics
from roomlight.conventions import linear_to_srgb8
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from roomlight.errors import ModelError
from roomlight.monocular.network import DEPTH_CHANNELS, DEPTH_SIDE, ray_planes
from roomlight_model.depth.network import DepthNetwork, Depthwise, log_focal
from roomlight_model.depth.stage import DepthFrames, DepthOptions, DepthStage, _blurred, depth_batch


def _frames(count: int) -> DepthFrames:
    shots = [pose(0.1 * k, turn=0.4 * k) for k in range(count)]
    colour = [linear_to_srgb8(frame(k, at).image) for k, at in enumerate(shots)]
    depth = [np.rint(1000 * exact_depth(at)).astype(np.uint16) for at in shots]
    ups = [at[1, :3].astype(np.float64) for at in shots]
    return DepthFrames.of(colour, depth, [LENS] * count, ups, [0.0] * count)


def _published(network: DepthNetwork) -> Iterator[tuple[str, torch.Tensor]]:
    """Yield weights in the published order: convolution, then the four tensors of its normalisation and a counter."""
    generator = torch.Generator().manual_seed(3)
    for number, (name, value) in enumerate(network.encoder.state_dict().items()):
        if name.endswith("weight"):
            yield f"{number}.weight", torch.randn(value.shape, generator=generator)
            for part in ("gain", "bias", "mean"):
                yield f"{number}.{part}", torch.randn(value.shape[:1], generator=generator)
            yield f"{number}.variance", torch.rand(value.shape[:1], generator=generator) + 0.5
            yield f"{number}.num_batches_tracked", torch.tensor(7)


def test_a_zoomed_picture_is_farther_by_the_zoom() -> None:
    """The same pixels seen by a lens of twice the focal length: depth is doubled, but for what the rays tell."""
    near, far = (ray_planes(Intrinsics(k * 280.0, k * 280.0, 160.0, 120.0, 320, 240))[None] for k in (1, 2))
    doubled = log_focal(torch.from_numpy(far[:, :2])) - log_focal(torch.from_numpy(near[:, :2]))
    assert float(doubled) == pytest.approx(np.log(2), abs=1e-5)


def test_published_weights_are_folded_with_their_normalisation() -> None:
    network = DepthNetwork()
    published = dict(_published(network))
    network.start_encoder(published)
    weight, gain, bias, mean, variance = [value for name, value in published.items() if "num_" not in name][:5]
    picture = torch.rand(1, 3, 32, 32)
    padded = torch.nn.functional.pad(picture, (0, 1, 0, 1))
    wanted = torch.nn.functional.conv2d(padded, weight, stride=2)
    wanted = (wanted - mean[:, None, None]) / (variance[:, None, None] + 1e-3).sqrt() * gain[:, None, None]
    wanted = (wanted + bias[:, None, None]).clamp(0, 6)
    assert torch.allclose(network.encoder.stem(picture), wanted, atol=1e-4)


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    network = DepthNetwork()
    with pytest.raises(ModelError, match="3 tensors are no EfficientNet-Lite0"):
        network.start_encoder({str(k): torch.zeros(1) for k in range(3)})
    wrong = {name: value[..., :1] for name, value in _published(network) if value.ndim}
    with pytest.raises(ModelError, match=r"layer 0 is .* not EfficientNet-Lite0"):
        network.start_encoder(wrong)
    (tmp_path / "text.pth").write_text("no weights")
    options = DepthOptions(encoder=tmp_path / "text.pth")
    with pytest.raises(ModelError, match=r"text\.pth: the encoder's weights cannot be read"):
        DepthStage(options, _frames(1), _frames(1)).network()


def test_a_batch_holds_the_truth_at_half_the_size() -> None:
    frames = _frames(2)
    batch = depth_batch(frames)
    assert batch.planes.shape == (2, DEPTH_CHANNELS, DEPTH_SIDE, DEPTH_SIDE)
    assert bool(batch.known.all())
    middle = batch.log_depth[0, 0, DEPTH_SIDE // 4, DEPTH_SIDE // 4].exp()
    assert float(middle) == pytest.approx(float(exact_depth(pose(0))[120, 160]), rel=0.02)


def test_a_cut_keeps_rays_and_depth_together() -> None:
    """Points of a cut, mirrored or not, still lie on the room's far wall, 3.5 m away."""
    frames = _frames(1)
    for seed in range(6):
        batch = depth_batch(frames, np.random.default_rng(seed))
        depth = batch.log_depth[0, 0].exp().numpy()
        rays = batch.planes[0, 3:, ::2, ::2].numpy()
        height = 1.4 - rays[1] * depth
        assert height.min() > -0.1
        assert height.max() < 2.7
        assert np.abs(depth[np.abs(rays[1]) < 0.1].max() - 3.5) < 0.1


def test_rays_of_a_batch_are_those_of_the_engine() -> None:
    frames = _frames(2)
    rays = depth_batch(frames).planes[:, 3:].numpy()
    for k in (0, 1):
        assert np.allclose(rays[k], ray_planes(LENS, pose(0.1 * k, turn=0.4 * k)[1, :3]), atol=1e-5)


def test_a_blur_keeps_flat_pictures_and_leaves_those_without() -> None:
    flat, noise = (
        torch.full((1, 3, 32, 32), 0.3),
        torch.rand((1, 3, 32, 32), generator=torch.Generator().manual_seed(0)),
    )
    flat_after, noise_after = _blurred(torch.cat([flat, noise]), np.array([1.2, 0.0]))
    assert torch.allclose(flat_after, flat[0], atol=1e-6)
    assert torch.allclose(noise_after, noise[0], atol=1e-6)
    assert float(_blurred(noise, np.array([1.2])).std()) == pytest.approx(0.29 / (2 * np.sqrt(np.pi) * 1.2), rel=0.15)


def test_the_rise_of_rays_gives_the_depth_of_the_floor() -> None:
    """A tilted and rolled camera 1.4 m over the floor: exp(plane) gives the floor's depth."""
    turn, _ = np.linalg.qr(np.array([[1.0, 0.1, 0.0], [-0.1, 0.9, 0.4], [0.05, -0.4, 0.9]]))
    at = np.eye(4)
    at[:3, :3], at[1, 3] = turn * np.sign(np.diag(turn)), 1.4
    known, unknown = ray_planes(LENS, at[1, :3]), ray_planes(LENS)
    assert np.array_equal(known[:2], unknown[:2])
    assert not unknown[2:].any()
    truth = cv2.resize(exact_depth(at), (DEPTH_SIDE, DEPTH_SIDE), interpolation=cv2.INTER_NEAREST)
    focal = np.sqrt(LENS.fx * LENS.fy / (LENS.width * LENS.height))
    steep = known[2] < -0.6  # the nearest wall is 2 m away
    assert steep.mean() > 0.1
    assert np.allclose(1.4 * focal * np.exp(known[3])[steep], truth[steep], rtol=0.02)
    assert (known[2] <= 2).all()
    assert float(np.exp(-known[3]).min()) == pytest.approx(0.1 * focal, rel=0.02)


def test_gravity_is_left_out_of_some_examples_and_mirrored_with_the_picture() -> None:
    frames, without = _frames(1), 0
    for seed in range(40):
        batch = depth_batch(frames, np.random.default_rng(seed))
        rise, depth = batch.planes[0, 5, ::2, ::2].numpy(), batch.log_depth[0, 0].exp().numpy()
        without += not rise.any()
        below = rise * depth + 1.4  # height of the points, of a camera at 1.4 m
        assert not rise.any() or below.min() > -0.25
    assert 2 <= without <= 16


def test_a_room_whose_size_nothing_tells_is_resized_to_the_height_of_a_phone() -> None:
    frames = _frames(1)
    own = depth_batch(frames).log_depth.exp()
    assert float(own.max()) == pytest.approx(3.5, abs=0.1)
    for height_m, factor in ((1.0, 1.45), (0.1, 1.8), (4.0, 0.6)):
        frames.heights_m[0] = height_m
        assert torch.allclose(depth_batch(frames).log_depth.exp(), factor * own, rtol=1e-4)


def test_views_from_near_the_floor_are_thinned_out() -> None:
    heights = [0.5, 1.4, 0.6, 0.7, 1.5, 0.8, 0.4]

    class Rooms(Dataset):
        def __init__(self) -> None:
            """Hold no files."""

        def __len__(self) -> int:
            return 1

        def read(self, number: int, **options: object) -> Recording:
            assert (number, options) == (0, {"probes": False})
            poses = np.stack([np.eye(4)] * len(heights))
            poses[:, 1, 3] = heights
            whole = Dataset(Path("tests/data/rooms"), "train").read(0)
            names = ("colour", "depth_mm", "surface", "exposure", "timestamp_s", "clipped_radiance")
            parts = {name: np.resize(getattr(whole, name), (len(heights), *getattr(whole, name).shape[1:]))
                     for name in names if getattr(whole, name) is not None}  # fmt: skip
            return replace(whole, camera_to_world=poses, facts={"furniture": {}}, **parts)

    frames = DepthFrames.read([Rooms()])
    assert frames.heights_m.tolist() == pytest.approx([1.4, 0.7, 1.5])
    assert len(frames.colour) == len(frames.ups) == 3


def test_a_step_trains_all_layers() -> None:
    stage = DepthStage(DepthOptions(batch=2), _frames(3), _frames(2))
    network = stage.network()
    batch = stage.batch(0)
    batch.known[0, :, 8:] = 0
    losses, *parts = (stage.losses(network, piece, torch.Generator()) for piece in (batch, *batch.pieces(1)))
    for name, value in losses.items():  # a picture counts alike in any piece
        assert value.item() == pytest.approx(np.mean([part[name].item() for part in parts]), rel=0.02)
    losses["loss"].backward()
    still = [name for name, value in network.named_parameters() if value.grad is None or not value.grad.any()]
    assert still == []
    scores = stage.scores(network)
    assert set(scores) == {"loss", "within_25", "scaled", "constant"}
    assert all(np.isfinite(value) for value in scores.values())


@pytest.mark.parametrize(("kernel", "stride"), [(3, 1), (5, 1), (3, 2), (5, 2)])
def test_gradients_of_depthwise_convolutions_are_those_of_pytorch(kernel: int, stride: int) -> None:
    generator = torch.Generator().manual_seed(kernel + stride)
    x, weight, bias = (
        torch.randn(shape, generator=generator, dtype=torch.float64, requires_grad=True)
        for shape in ((2, 6, 4 * stride + kernel, 2 * stride + kernel), (6, 1, kernel, kernel), (6,))
    )
    ours = Depthwise.apply(x, weight, bias, stride)
    theirs = torch.nn.functional.conv2d(x, weight, bias, stride, groups=6)
    assert torch.equal(ours, theirs)
    factor = torch.randn(ours.shape, generator=generator, dtype=torch.float64)
    wanted = torch.autograd.grad((theirs * factor).sum(), (x, weight, bias))
    for got, want in zip(torch.autograd.grad((ours * factor).sum(), (x, weight, bias)), wanted, strict=True):
        assert torch.allclose(got, want)
