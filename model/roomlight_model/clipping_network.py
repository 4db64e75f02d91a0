"""The network that estimates the radiance of clipped pixels from one frame, its depth and its pose.

Its input is a square of `SIDE` x `SIDE` pixels that holds the whole frame, reduced, in its middle; the rest is empty.
Channels, in order (`roomlight.engine.networks.clipping` makes them; see `CHANNELS` there):

    linear RGB (3), clipped, inside the frame, depth known, log(1 + depth in metres), surface normal (3) in a frame
    whose y is the world's up and whose z points back from the camera's heading, y of the pixel's ray

The output is, at half the resolution, the logarithm of each channel's radiance in units of the frame's white.
"""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from roomlight.engine.networks.clipping import CHANNELS
from roomlight_model.layers import LEAK

LOG_RANGE: Final = (-1.5, 7.0)
"""Radiance from 0.2 (glare that no probe sees) to 1,100 x white, the sunlit outdoors from a dark room."""


def _block(inputs: int, outputs: int, *, stride: int = 1) -> nn.Sequential:
    kernel = 4 if stride == 2 else 3
    return nn.Sequential(nn.Conv2d(inputs, outputs, kernel, stride, padding=1), nn.LeakyReLU(LEAK))


class ClippingNetwork(nn.Module):
    """A small encoder-decoder with a global mean at its bottom: how bright a lamp is shows in the whole frame."""

    form = "clipping"

    def __init__(self, width: int = 24) -> None:
        """Build the layers: `width` channels at half resolution, up to six times that at a sixteenth."""
        super().__init__()
        widths = (width, 2 * width, 3 * width, 4 * width)
        self.down = nn.ModuleList(
            nn.Sequential(_block(inputs, outputs, stride=2), _block(outputs, outputs))
            for inputs, outputs in zip((CHANNELS, *widths), widths, strict=False)
        )
        self.room = nn.Linear(widths[-1], widths[-1])
        self.up = nn.ModuleList(
            _block(low + high, high) for low, high in zip(widths[:0:-1], widths[-2::-1], strict=True)
        )
        self.head = nn.Conv2d(width, 4, 3, padding=1)
        with torch.no_grad():
            self.head.weight.mul_(0.1)
            self.head.bias.zero_()  # pyright: ignore[reportOptionalMemberAccess]

    def forward(self, planes: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 3 h2 w2"]:
        """Return log radiance of the three channels at half the resolution: a common brightness and a small colour."""
        planes = torch.cat([torch.log1p(8 * planes[:, :3]), planes[:, 3:]], dim=1)
        features: list[Tensor] = []
        x = planes
        for down in self.down:
            x = down(x)
            features.append(x)
        x = x + functional.leaky_relu(self.room(x.mean(dim=(2, 3))), LEAK)[:, :, None, None]
        for up, skip in zip(self.up, features[-2::-1], strict=True):
            x = up(torch.cat([functional.interpolate(x, size=skip.shape[2:], mode="nearest"), skip], dim=1))
        out = self.head(x)
        brightness = 1 + out[:, :1]  # begins at e x white, near the median of real rooms
        return (brightness + 0.5 * torch.tanh(out[:, 1:])).clamp(*LOG_RANGE)
