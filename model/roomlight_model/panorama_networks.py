"""The 2D blending networks over panoramas: BlendEncoder, BlendDecoder, BlendGRU (paper, network section).

Panoramas are [batch, channel, H, 2H], world-aligned; every layer wraps around at the left and right edge.
Inputs are linear radiance, and depth in units of the volume's depth_max_m.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from roomlight_model.config import BlendConfig
from roomlight_model.layers import ConvGRU, PanoramaConv, block2d, resize_panorama

SINGLE_PANELS = 8
"""Single-view input: HDR (3), LDR (3), mask, 1 - mask."""

VIDEO_PANELS = 13
"""Video input: previous L (3), HDR (3), LDR (3), mask, 1 - mask, depth, accumulated depth."""

_RADIANCE_CHANNELS = {SINGLE_PANELS: 6, VIDEO_PANELS: 9}


class BlendEncoder(nn.Module):
    """F_0, F_1 = BlendEncoder(panels): features at half and an eighth of the resolution, in (-1, 1)."""

    def __init__(self, config: BlendConfig, *, panels: int) -> None:
        """Build the layers; `panels` is the number of input channels, `SINGLE_PANELS` or `VIDEO_PANELS`."""
        super().__init__()
        width = config.channels
        self.radiance_channels = _RADIANCE_CHANNELS[panels]
        self.at_half = nn.Sequential(block2d(panels, width, kernel=4, stride=2), PanoramaConv(width, width))
        self.at_eighth = nn.Sequential(
            block2d(width, 2 * width, kernel=4, stride=2),
            block2d(2 * width, 2 * width),
            block2d(2 * width, 4 * width, kernel=4, stride=2),
            PanoramaConv(4 * width, 4 * width),
        )

    def forward(
        self, panels: Float[Tensor, "b c h w"]
    ) -> tuple[Float[Tensor, "b c0 h0 w0"], Float[Tensor, "b c1 h1 w1"]]:
        """Return (F0, F1) of the stacked panoramas, radiance channels first."""
        count = self.radiance_channels
        # HDR and LDR in the loss's logarithm: where they agree, their difference is 0
        panels = torch.cat([torch.log1p(torch.relu(panels[:, :count])), panels[:, count:]], dim=1)
        f0 = torch.tanh(self.at_half(panels))
        f1 = torch.tanh(self.at_eighth(f0))
        return f0, f1


class BlendDecoder(nn.Module):
    """L_M = BlendDecoder(F_0, F_1, mask): a weight in [0, 1] for each pixel.

    Outside the partial mesh it is the share of the fill.
    """

    def __init__(self, config: BlendConfig) -> None:
        super().__init__()
        width, full = config.channels, config.full_channels
        self.at_eighth = block2d(4 * width, 2 * width)
        self.room = nn.Linear(4 * width, 2 * width)
        self.at_quarter = block2d(2 * width, 2 * width)
        self.at_half = nn.Sequential(block2d(3 * width, width), block2d(width, full))
        self.at_full = block2d(full, full)
        self.head = nn.Conv2d(full + 1, 1, 1)
        with torch.no_grad():  # initial weights: 0.88 on the mesh, 0.38 of the fill outside
            self.head.weight[:, -1] = 2.5
            self.head.bias.fill_(-0.5)  # pyright: ignore[reportOptionalMemberAccess]

    def forward(
        self,
        f0: Float[Tensor, "b c0 h0 w0"],
        f1: Float[Tensor, "b c1 h1 w1"],
        mask: Float[Tensor, "b 1 h w"],
    ) -> Float[Tensor, "b 1 h w"]:
        """Return the blending weight."""
        room = self.room(f1.mean(dim=(2, 3)))[:, :, None, None]
        x = self.at_eighth(f1) + room
        x = self.at_quarter(resize_panorama(x, [size // 2 for size in f0.shape[2:]]))
        x = self.at_half(torch.cat([resize_panorama(x, f0.shape[2:]), f0], dim=1))
        x = self.at_full(resize_panorama(x, mask.shape[2:]))
        return torch.sigmoid(self.head(torch.cat([x, mask.to(x.dtype)], dim=1)))


class BlendGRU(ConvGRU):
    """H^i = BlendGRU(H^{i-1}, F^i) on either level of features."""

    def __init__(self, channels: int) -> None:
        """Build gates of 3 x 3: at panorama sizes they cost little."""
        super().__init__(PanoramaConv(2 * channels, 2 * channels), PanoramaConv(2 * channels, channels))


def single_panels(
    hdr: Float[Tensor, "b 3 h w"], ldr: Float[Tensor, "b 3 h w"], mask: Float[Tensor, "b 1 h w"]
) -> Float[Tensor, "b 8 h w"]:
    """Stack the single-view input: rendered HDR, partial LDR with its fill, the mask and its complement."""
    return torch.cat([hdr, ldr, mask, 1 - mask], dim=1)


def video_panels(
    previous: Float[Tensor, "b 3 h w"],
    hdr: Float[Tensor, "b 3 h w"],
    ldr: Float[Tensor, "b 3 h w"],
    *,
    mask: Float[Tensor, "b 1 h w"],
    depth: Float[Tensor, "b 1 h w"],
    accumulated_depth: Float[Tensor, "b 1 h w"],
) -> Float[Tensor, "b 13 h w"]:
    """Stack the video input; both depths in units of the volume's depth_max_m."""
    return torch.cat([previous, hdr, ldr, mask, 1 - mask, depth, accumulated_depth], dim=1)
