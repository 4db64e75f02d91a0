"""The network that gives the light that lights things: a 2D encoder-decoder on a probe's panorama.

Panels are `roomlight.engine.lighting.lighting_panels`, linear radiance in units of white: what the frames
have shown together. All layers wrap around at the left and right edge; the elevation is an input, because ceilings are
brighter than floors.
"""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from roomlight.engine.panorama.panels import HEIGHT, PANELS
from roomlight_model.layers import LEAK, PanoramaConv, block2d

_DERIVED: Final = 4
"""Planes that are computed from the panels."""
_COLOUR: Final = 0.3
"""Greatest change of a channel beside the common one, in log(1 + L)."""


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = block2d(width, width)
        self.second = PanoramaConv(width, width)
        with torch.no_grad():
            self.second.conv.weight.mul_(0.2)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        return functional.leaky_relu(x + self.second(self.first(x)), LEAK)


class ObjectLightNetwork(nn.Module):
    """A change of log(1 + L) for each channel.

    It begins as the identity, without any change.
    """

    form = "objects"

    def __init__(self, width: int = 32) -> None:
        """Build the layers: `width` channels at half the panels' resolution, two and a half times that at an eighth."""
        super().__init__()
        widths = (width, width * 3 // 2, width * 5 // 2)
        self.down = nn.ModuleList(
            nn.Sequential(block2d(inputs, outputs, kernel=4, stride=2), _Residual(outputs))
            for inputs, outputs in zip((PANELS + 1 + _DERIVED, *widths), widths, strict=False)
        )
        self.room = nn.Linear(widths[-1], widths[-1])
        self.bottom = nn.Sequential(_Residual(widths[-1]), _Residual(widths[-1]))
        self.up = nn.ModuleList(
            nn.Sequential(block2d(low + high, high), _Residual(high))
            for low, high in zip(widths[:0:-1], widths[-2::-1], strict=True)
        )
        self.head = PanoramaConv(width, 4)
        nn.init.zeros_(self.head.conv.weight)
        elevation = torch.cos((torch.arange(HEIGHT) + 0.5) / HEIGHT * torch.pi)
        self.register_buffer(
            "elevation", elevation[None, None, :, None].expand(1, 1, HEIGHT, 2 * HEIGHT).clone(), persistent=False
        )

    def forward(self, panels: Float[Tensor, "b p h w"]) -> Float[Tensor, "b c h w"]:
        """Return the change of log(1 + L) in every direction; meaningful where the light was not measured."""
        known = panels[:, 3:4]
        detail = torch.log1p(panels[:, :3]) * known
        total = known.mean((2, 3), keepdim=True)
        room = detail.mean((1, 2, 3), keepdim=True) / (total + 1e-3)
        elevation = self.get_buffer("elevation").expand(panels.shape[0], -1, -1, -1)
        x = torch.cat(
            [
                detail,
                panels[:, 3:5],
                torch.log1p(panels[:, 5:6]) * known,
                torch.log1p(panels[:, 6:PANELS]),
                elevation,
                elevation.square(),
                total.expand_as(elevation),
                room.expand_as(elevation),
                torch.log1p(panels[:, PANELS:]),
            ],
            dim=1,
        )
        features: list[Tensor] = []
        for down in self.down:
            x = down(x)
            features.append(x)
        x = x + functional.leaky_relu(self.room(x.mean((2, 3))), LEAK)[:, :, None, None]
        x = self.bottom(x)
        for up, skip in zip(self.up, features[-2::-1], strict=True):
            x = up(torch.cat([functional.interpolate(x, size=skip.shape[2:], mode="nearest"), skip], dim=1))
        out = self.head(x)
        change = out[:, :1] + _COLOUR * torch.tanh(out[:, 1:])
        return functional.interpolate(change, size=panels.shape[2:], mode="bilinear", align_corners=False)
