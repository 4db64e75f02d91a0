"""The network that estimates depth from one picture and its camera: an EfficientNet-Lite0 encoder and a light decoder.

The input is a square of `DEPTH_SIDE` pixels into which any picture is stretched: sRGB in [0, 1] (3), the pixels' rays
x / z and y / z (2), which hold field of view, aspect and principal point, and how far the rays rise (2), zero where
gravity is not known (`roomlight.monocular.network` makes it). The output, at half the resolution, is the logarithm of
z-depth in metres, and the logarithm of the error's scale.

Depth is learned as log(depth / focal length), which a change of zoom leaves as it is (the canonical camera of Yin et
al. 2023, "Metric3D"). The encoder follows Tan and Le 2019, "EfficientNet", in its Lite form: without squeeze and
excitation, with ReLU6; layers have the published order, so that published ImageNet weights can start it.
"""

from collections.abc import Mapping
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from roomlight.errors import ModelError
from roomlight.monocular.network import DEPTH_CHANNELS

LOG_ERROR: Final = (-4.0, 1.0)
"""Range of the logarithm of the error's scale: 2 % to a factor of 15."""
_STAGES: Final = (
    # repeats, kernel, stride, expansion, outputs
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
_STEM: Final = 32
_SKIPS: Final = (0, 1, 2, 4, 6)
"""Stages whose output the decoder takes: at a half to a thirty-second of the resolution."""
_SKIP_WIDTHS: Final = (16, 24, 40, 112, 320)
_CAMERA: Final = DEPTH_CHANNELS - 3
_COARSE: Final = (40, 112, 320)
"""Widths of the features that the camera's planes are added to: at an eighth of the resolution and below."""
_WIDTHS: Final = (24, 40, 64, 96, 128)
_MEAN, _DEVIATION = 127 / 255, 128 / 255
"""Of the input, as the published encoder was trained."""
_EPSILON: Final = 1e-3
"""Of its batch normalisation."""


class Depthwise(torch.autograd.Function):
    """A convolution of each channel by itself, without padding, whose gradients are sums of shifted products.

    For CPUs, where PyTorch takes up to 20 times as long in bfloat16. The input must end where the last kernel ends.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, stride: int) -> Tensor:  # noqa: D102
        y = functional.conv2d(x, weight, bias, stride, groups=len(weight))
        ctx.save_for_backward(x.to(y.dtype), weight)
        ctx.stride = stride
        return y

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # noqa: D102
        (gradient,), (x, weight), stride = gradients, ctx.saved_tensors, ctx.stride
        high, wide, size = *gradient.shape[2:], weight.shape[-1]
        taps = [
            (x[:, :, i::stride, j::stride][:, :, :high, :wide] * gradient).sum((0, 2, 3))
            for i in range(size)
            for j in range(size)
        ]
        spread = gradient
        if stride > 1:
            spread = gradient.new_zeros(*gradient.shape[:2], stride * (high - 1) + 1, stride * (wide - 1) + 1)
            spread = spread.contiguous(memory_format=torch.channels_last)
            spread[:, :, ::stride, ::stride] = gradient
        turned = weight.flip((2, 3)).to(gradient.dtype)
        back = functional.conv2d(spread, turned, padding=size - 1, groups=len(weight))
        of_weight = torch.stack(taps, dim=1).view(weight.shape).to(weight.dtype)
        return back, of_weight, gradient.sum((0, 2, 3)).to(weight.dtype), None


class _Conv(nn.Module):
    """A convolution and ReLU6; stride 2 pads as TensorFlow does ("same"). Normalisation is folded into the weights."""

    def __init__(
        self, inputs: int, outputs: int, kernel: int = 1, stride: int = 1, groups: int = 1, *, linear: bool = False
    ) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, groups=groups)
        before = (kernel - stride) // 2
        self.pad = (before, kernel - stride - before) if kernel > 1 else (0, 0)
        self.linear = linear

    def forward(self, x: Tensor) -> Tensor:
        if any(self.pad):
            x = functional.pad(x, (*self.pad, *self.pad))
        if self.conv.groups > 1 and x.device.type == "cpu" and torch.is_grad_enabled():
            assert self.conv.bias is not None
            x = Depthwise.apply(x, self.conv.weight, self.conv.bias, self.conv.stride[0])
        else:
            x = self.conv(x)
        return x if self.linear else functional.relu6(x)


class _Inverted(nn.Module):
    """An inverted residual: widen, convolve each channel, narrow."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        layers = [_Conv(inputs, wide)] if expansion > 1 else []
        layers += [_Conv(wide, wide, kernel, stride, wide), _Conv(wide, outputs, linear=True)]
        self.layers = nn.Sequential(*layers)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        return x + self.layers(x) if self.residual else self.layers(x)


class _Encoder(nn.Module):
    """EfficientNet-Lite0 up to its last block."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = _Conv(3, _STEM, 3, 2)
        stages, inputs = list[nn.Module](), _STEM
        for repeats, kernel, stride, expansion, outputs in _STAGES:
            blocks = [
                _Inverted(inputs if k == 0 else outputs, outputs, kernel, stride if k == 0 else 1, expansion)
                for k in range(repeats)
            ]
            stages.append(nn.Sequential(*blocks))
            inputs = outputs
        self.stages = nn.ModuleList(stages)

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> list[Tensor]:
        """Return the features that the decoder takes, from fine to coarse."""
        x, kept = self.stem((image - _MEAN) / _DEVIATION), list[Tensor]()
        for number, stage in enumerate(self.stages):
            x = stage(x)
            if number in _SKIPS:
                kept.append(x)
        return kept


class _Merge(nn.Module):
    """Add coarse features, enlarged, to fine ones, then two convolutions."""

    def __init__(self, coarse: int, skip: int, width: int) -> None:
        super().__init__()
        self.reduce = nn.Conv2d(coarse, width, 1)
        self.skip = nn.Conv2d(skip, width, 1)
        self.refine = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1), nn.ReLU(), nn.Conv2d(width, width, 3, padding=1)
        )

    def forward(self, coarse: Tensor, skip: Tensor) -> Tensor:
        larger = functional.interpolate(self.reduce(coarse), scale_factor=2.0, mode="bilinear", align_corners=False)
        x = functional.relu(larger + self.skip(skip))
        return functional.relu(x + self.refine(x))


class DepthNetwork(nn.Module):
    """Depth and its error from a picture and its camera."""

    form = "depth"

    def __init__(self) -> None:
        super().__init__()
        self.encoder = _Encoder()
        bottom = _WIDTHS[-1]
        self.bottom = nn.Conv2d(_SKIP_WIDTHS[-1] + _CAMERA, bottom, 1)
        self.room = nn.Linear(bottom, bottom)
        self.merges = nn.ModuleList(
            _Merge(coarse, skip + (_CAMERA if skip in _COARSE else 0), width)
            for coarse, skip, width in zip(_WIDTHS[:0:-1], _SKIP_WIDTHS[-2::-1], _WIDTHS[-2::-1], strict=True)
        )
        self.head = nn.Conv2d(_WIDTHS[0], 2, 3, padding=1)
        with torch.no_grad():
            self.head.weight.mul_(0.1)
            self.head.bias.copy_(torch.tensor([1.1, -1.2]))  # pyright: ignore[reportOptionalMemberAccess]

    def forward(self, planes: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 2 h2 w2"]:
        """Return log depth in metres, and the log of the error's scale, at half the resolution."""
        camera = planes[:, 3:]
        features = self.encoder(planes[:, :3])
        for place, side in ((-1, 32), (-2, 16), (-3, 8)):
            features[place] = torch.cat([features[place], functional.avg_pool2d(camera, side)], dim=1)
        x = functional.relu(self.bottom(features[-1]))
        x = x + functional.relu(self.room(x.mean(dim=(2, 3))))[:, :, None, None]
        for merge, skip in zip(self.merges, features[-2::-1], strict=True):
            x = merge(x, skip)
        out = self.head(x)
        return torch.cat([out[:, :1] + log_focal(camera[:, :2]), out[:, 1:].clamp(*LOG_ERROR)], dim=1)

    def start_encoder(self, published: Mapping[str, Tensor]) -> None:
        """Take published weights of EfficientNet-Lite0 (ImageNet): the same layers in the same order.

        Args:
            published: For each layer the convolution's weights, then gain, bias, mean and variance of its batch
                normalisation, which are folded into weights and bias; what follows the encoder's layers is left out.

        Raises:
            ModelError: The weights are of another network.
        """
        values = [value for name, value in published.items() if not name.endswith("num_batches_tracked")]
        layers = [layer.conv for layer in self.encoder.modules() if isinstance(layer, _Conv)]
        if len(values) < 5 * len(layers):
            raise ModelError(f"{len(values)} tensors are no EfficientNet-Lite0, which has {5 * len(layers)} and more")
        for number, layer in enumerate(layers):
            weight, gain, bias, mean, variance = values[5 * number : 5 * number + 5]
            if weight.shape != layer.weight.shape or gain.shape != mean.shape or gain.shape != weight.shape[:1]:
                wanted = f"it must be {tuple(layer.weight.shape)}"
                raise ModelError(f"layer {number} is {tuple(weight.shape)}; {wanted}: not EfficientNet-Lite0")
            assert layer.bias is not None
            scale = gain / (variance + _EPSILON).sqrt()
            with torch.no_grad():
                layer.weight.copy_(weight * scale[:, None, None, None])
                layer.bias.copy_(bias - mean * scale)


def log_focal(rays: Float[Tensor, "b 2 h w"]) -> Float[Tensor, "b 1 1 1"]:
    """Return the log of the focal length in units of the picture's sides (geometric mean), by the spacing of rays."""
    width = (rays[:, 0, :, -1] - rays[:, 0, :, 0]).mean(dim=1).abs()
    height = (rays[:, 1, -1] - rays[:, 1, 0]).mean(dim=1).abs()
    return (-0.5 * torch.log((width * height).clamp(min=1e-4)))[:, None, None, None]
