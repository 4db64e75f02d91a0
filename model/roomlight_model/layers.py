"""Building blocks of both networks: convolutions in 3D and on panoramas, resizing, the convolutional GRU.

Chosen so that a graph exports and runs well in ONNX Runtime: every convolution has a bias (onnxscript writes
Conv3d without one with a wrong shape), sizes grow by Resize and never by a transposed convolution.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

_START_NOISE = 0.1
"""Share of the random initial weights that `ConvGRU.pass_features` leaves."""
_START_GAIN = 1.2
"""tanh(1.2 f) differs from f by at most 0.17 in [-1, 1]."""

LEAK = 0.1
"""Slope of the leaky ReLU below 0. With 8 to 16 channels, one dead plain ReLU would be a tenth of the layer."""


def conv3d(inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1) -> nn.Conv3d:
    """Build a 3D convolution. Kernel 3 or 1 keeps the size; kernel 4 with stride 2 halves it, rounding down."""
    conv = nn.Conv3d(inputs, outputs, kernel, stride, padding=(kernel - 1) // 2)
    _initialise(conv)
    return conv


class PanoramaConv(nn.Module):
    """A 2D convolution on panoramas: columns wrap around, rows are zero-padded at the poles."""

    def __init__(self, inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1) -> None:
        """Build the convolution. Kernel 3 or 1 keeps the size; kernel 4 with stride 2 halves it."""
        super().__init__()
        self.wrap = (kernel - 1) // 2
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, padding=(self.wrap, 0))
        _initialise(self.conv)

    def forward(self, image: Float[Tensor, "b _ h w"]) -> Float[Tensor, "b _ _h _w"]:
        """Wrap the columns, then convolve."""
        if self.wrap:
            image = torch.cat([image[..., -self.wrap :], image, image[..., : self.wrap]], dim=-1)
        return self.conv(image)


def block3d(inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1, groups: int = 0) -> nn.Sequential:
    """Build a 3D convolution, group normalisation if `groups` > 0, and leaky ReLU."""
    layers: list[nn.Module] = [conv3d(inputs, outputs, kernel=kernel, stride=stride)]
    if groups:
        layers.append(nn.GroupNorm(groups, outputs))
    return nn.Sequential(*layers, nn.LeakyReLU(LEAK))


def block2d(inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Build a panorama convolution and leaky ReLU."""
    return nn.Sequential(PanoramaConv(inputs, outputs, kernel=kernel, stride=stride), nn.LeakyReLU(LEAK))


def resize_volume(volume: Float[Tensor, "b c _z _y _x"], size: Sequence[int]) -> Float[Tensor, "b c z y x"]:
    """Resize trilinearly to an explicit size: halving rounds down (15 -> 7), so that a factor of 2 would not fit.

    In ONNX Runtime, to the full volume with 16 channels: trilinear 7 ms, nearest 36 (no fast path in 3D).
    """
    return functional.interpolate(volume, size=tuple(size), mode="trilinear", align_corners=False)


def resize_panorama(image: Float[Tensor, "b c _h _w"], size: Sequence[int]) -> Float[Tensor, "b c h w"]:
    """Resize by nearest neighbour: without border effects, so that the result rotates with the panorama."""
    return functional.interpolate(image, size=tuple(size), mode="nearest")


class ConvGRU(nn.Module):
    """A gated recurrent unit (Cho et al. 2014) whose matrices are convolutions, in 2D or 3D.

    The candidate is a tanh, and the new state a convex mix of the old state and the candidate. Features lie in
    [-1, 1], so that a state that starts as a feature stays in that range in sessions of any length.
    """

    def __init__(self, gates: nn.Module, candidate: nn.Module) -> None:
        """Take the two convolutions: `gates` 2C -> 2C and `candidate` 2C -> C."""
        super().__init__()
        self.gates = gates
        self.candidate = candidate

    def pass_features(self) -> None:
        """Set weights with which a new state is nearly the mean of the old state and the feature.

        The start of recurrent training from single-view weights: their decoders know such states, and would get noise
        from initial random weights. What is left of those lets all weights receive different gradients.
        """
        with torch.no_grad():
            for weight in (*self.gates.parameters(), *self.candidate.parameters()):
                weight.mul_(_START_NOISE)
            convolutions = (part for part in self.candidate.modules() if isinstance(part, nn.Conv2d | nn.Conv3d))
            weight = next(convolutions).weight  # [C, 2C, *kernel]
            channels, centre = weight.shape[0], tuple(size // 2 for size in weight.shape[2:])
            for channel in range(channels):
                weight[(channel, channels + channel, *centre)] += _START_GAIN

    def forward(
        self, hidden: Float[Tensor, "b c *space"], feature: Float[Tensor, "b c *space"]
    ) -> Float[Tensor, "b c *space"]:
        """Compute h^i from h^{i-1} and f^i."""
        keep, reset = torch.sigmoid(self.gates(torch.cat([hidden, feature], dim=1))).chunk(2, dim=1)
        candidate = torch.tanh(self.candidate(torch.cat([reset * hidden, feature], dim=1)))
        return keep * hidden + (1 - keep) * candidate


def _initialise(conv: nn.Conv2d | nn.Conv3d) -> None:
    nn.init.kaiming_normal_(conv.weight, a=LEAK)
    nn.init.zeros_(conv.bias)  # pyright: ignore[reportArgumentType]
