"""The 3D networks: SGEncoder, SGDecoder with clearing and update volume, SGGRU (paper, network section).

Volumes are [batch, channel, z, y, x] in the session's volume frame. The input's channels are c (3, linear
radiance), alpha and e (-1 in voxels that are empty by the depth map, else 0).

Layers for a volume of 64 x 60 x 84, with C = `channels` and F = `full_channels`; K is the kernel, S the stride:

    input              5 x 64 x 60 x 84   c enters as log(1 + c)
    f0 (first skip)    C x 32 x 30 x 42   C-K4-S2, C-K3, tanh
    quarter            2C x 16 x 15 x 21  2C-K4-S2, 2C-K3
    f1 (second skip)   4C x 8 x 7 x 10    4C-K4-S2, 4C-K3, 4C-K3, tanh
    decoder, eighth    2C                 2C-K3 plus a matrix product of f1's mean over the volume, added to every voxel
    decoder, quarter   2C                 resize, 2C-K3 twice
    decoder, half      C, then F          resize, join f0, C-K3, F-K3
    decoder, full      F                  resize, F-K3, then all heads as one 1 x 1 x 1
    output             alpha, and c (3), w (3), lambda, s (3) channels last; V_x (1 + e) on each
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from roomlight.engine.networks.units import DARKEST, GREY
from roomlight_model.config import SGConfig
from roomlight_model.layers import ConvGRU, block3d, conv3d, resize_volume

MAX_LOG_RADIANCE = 10.0
"""Heads of c and w are clamped at e^10 = 22,026 x white: their sum fits a half float (65,504)."""

MAX_LOG_SHARPNESS = 7.0
"""lambda is clamped at e^7 = 1,097: a lobe of 2 degrees half width, a pixel of a 120-row panorama."""

GROUPS = 4
"""Groups of a normalisation: the narrowest layer allowed (8 channels, one voxel) still has two values in each."""

_FILL_OPACITY = 0.02
"""Opacity at which the fill weighs a cell as much as its surroundings."""

_KEPT_BIAS = 2.0
"""Initial V_u before its sigmoid: 0.88 of the previous volume is kept where the frame shows nothing."""

_INITIAL_BIAS = {"alpha": -3.0, "c": math.log(GREY), "w": math.log(0.05), "sharpness": math.log(8.0)}
"""Initial head biases: nearly clear air (alpha 0.05), dim walls, faint broad lobes. s starts straight up in the volume
frame, where rooms have their lamps; this also avoids 0 / 0 in its normalisation."""


class SGVolume(NamedTuple):
    """A spherical Gaussian lighting volume, with the update volume of a recurrent decoder."""

    alpha: Float[Tensor, "b z y x"]
    lobes: Float[Tensor, "b z y x 10"]
    """c (3), w (3), lambda (1), s (3); the serving kernel's layout."""
    update: Float[Tensor, "b z y x"] | None = None
    """V_u: the share of the previous volume that is kept."""


class SGEncoder(nn.Module):
    """V_f0, V_f1 = SGEncoder(c, alpha, e): features at half and an eighth of the resolution, in [-1, 1]."""

    def __init__(self, config: SGConfig) -> None:
        super().__init__()
        width = config.channels
        self.at_half = nn.Sequential(block3d(5, width, kernel=4, stride=2), conv3d(width, width))
        self.at_eighth = nn.Sequential(
            block3d(width, 2 * width, kernel=4, stride=2, groups=GROUPS),
            block3d(2 * width, 2 * width, groups=GROUPS),
            block3d(2 * width, 4 * width, kernel=4, stride=2, groups=GROUPS),
            block3d(4 * width, 4 * width, groups=GROUPS),
            conv3d(4 * width, 4 * width),
        )

    def forward(
        self, volume: Float[Tensor, "b 5 z y x"], unit: Float[Tensor, "b 3 1 1 1"] | None = None
    ) -> tuple[Float[Tensor, "b c0 z0 y0 x0"], Float[Tensor, "b c1 z1 y1 x1"]]:
        """Return (f0, f1) of an initial volume; `unit` replaces its own mean colour."""
        radiance, rest = volume[:, :3], volume[:, 3:]
        # in units of the mean colour: unseen walls take the room's colour and brightness without learning it
        radiance = radiance * (GREY / (mean_colour(volume) if unit is None else unit))
        # the loss compares log(L + 1); a lamp at 100 x white must not dominate the walls
        volume = torch.cat([torch.log1p(torch.relu(radiance)), rest], dim=1)
        f0 = torch.tanh(self.at_half(volume))
        f1 = torch.tanh(self.at_eighth(f0))
        return f0, f1


class SGDecoder(nn.Module):
    """V_c, V_alpha, V_w, V_lambda, V_s (and V_u) = SGDecoder(V_f0, V_f1), cleared by V_x (1 + V_e)."""

    def __init__(self, config: SGConfig, *, recurrent: bool) -> None:
        """Build the layers; `recurrent` adds the head of the update volume V_u."""
        super().__init__()
        self.recurrent = recurrent
        width, full = config.channels, config.full_channels
        self.at_eighth = block3d(4 * width, 2 * width, groups=GROUPS)
        self.room = nn.Linear(4 * width, 2 * width)
        self.tint = nn.Linear(3, 2 * width, bias=False)
        nn.init.zeros_(self.tint.weight)
        self.at_quarter = nn.Sequential(
            block3d(2 * width, 2 * width, groups=GROUPS), block3d(2 * width, 2 * width, groups=GROUPS)
        )
        self.at_half = nn.Sequential(block3d(3 * width, width), block3d(width, full))
        self.at_full = nn.Sequential(block3d(full, full))
        self.heads = _heads(full, recurrent=recurrent)
        self.direct = _direct_heads(self.heads.out_channels, recurrent=recurrent)

    def forward(
        self,
        f0: Float[Tensor, "b c0 z0 y0 x0"],
        f1: Float[Tensor, "b c1 z1 y1 x1"],
        volume: Float[Tensor, "b 5 z y x"],
        unit: Float[Tensor, "b 3 1 1 1"] | None = None,
    ) -> SGVolume:
        """Predict the volume; `volume` is the encoder's input, `unit` replaces its mean colour."""
        # global view: every voxel receives the mean of the whole volume, at the cost of one matrix product
        room = self.room(f1.mean(dim=(2, 3, 4)))
        level = torch.log((mean_colour(volume) if unit is None else unit) / GREY)
        room = room + self.tint(level[:, :, 0, 0, 0])
        x = self.at_eighth(f1) + room[:, :, None, None, None]
        x = self.at_quarter(resize_volume(x, [size // 2 for size in f0.shape[2:]]))
        x = self.at_half(torch.cat([resize_volume(x, f0.shape[2:]), f0], dim=1))
        x = self.at_full(resize_volume(x, volume.shape[2:]))
        observed = _observed(volume, level)
        raw = self.heads(x) + self.direct(torch.cat([observed, _surroundings(observed, level)], dim=1))
        return self._activate(raw, volume[:, 4:], level)

    def _activate(self, raw: Float[Tensor, "b _ z y x"], empty: Float[Tensor, "b 1 z y x"], level: Tensor) -> SGVolume:
        """Convert head values to a volume; `level` is the logarithm of the unit of c and w."""
        if raw.dtype in (torch.bfloat16, torch.float16):  # autocast: exp of a bf16 keeps two digits
            raw = raw.float()
        keep = 1 + empty  # V_x = V_x (1 + V_e) for every x
        # split once: each slice's gradient would be a whole volume of zeros, a sixth of a training step
        opacity, colour, intensity, sharpness, axis, *update = raw.split(
            [1, 3, 3, 1, 3, *((1,) if self.recurrent else ())], dim=1
        )
        alpha = torch.sigmoid(opacity) * keep
        radiance = torch.exp((colour + level).clamp(max=MAX_LOG_RADIANCE)) * keep
        intensity = torch.exp((intensity + level).clamp(max=MAX_LOG_RADIANCE))
        sharpness = torch.exp(sharpness.clamp(max=MAX_LOG_SHARPNESS))
        axis = axis / torch.sqrt((axis * axis).sum(dim=1, keepdim=True) + 1e-12)
        gaussian = torch.cat([intensity, sharpness, axis], dim=1) * keep
        lobes = torch.cat([radiance, gaussian], dim=1).permute(0, 2, 3, 4, 1)  # [b, z, y, x, 10]
        return SGVolume(alpha[:, 0], lobes, torch.sigmoid(update[0][:, 0]) if update else None)


class SGGRU(ConvGRU):
    """V_h^i = SGGRU(V_h^{i-1}, V_f^i) on either level of features."""

    def __init__(self, channels: int, *, gate_kernel: int = 3) -> None:
        """Build the GRU. Gates of kernel 1 more than halve SGGRU_0's cost; the candidate still sees its neighbours."""
        super().__init__(conv3d(2 * channels, 2 * channels, kernel=gate_kernel), conv3d(2 * channels, channels))


def merge(
    current: SGVolume, alpha_previous: Float[Tensor, "b z y x"], lobes_previous: Float[Tensor, "b z y x 10"]
) -> SGVolume:
    """Merge with the previous volume: V_x^i = V_x^i (1 - V_u^i) + V_u^i V_x^{i-1}; `current` is already cleared.

    Raises:
        ValueError: `current` has no update volume.
    """
    if current.update is None:
        raise ValueError("only a recurrent decoder's volume can be merged: it has no update volume")
    update = current.update
    alpha = current.alpha * (1 - update) + update * alpha_previous
    share = update[..., None]
    lobes = current.lobes * (1 - share) + share * lobes_previous
    return SGVolume(alpha, lobes, update)


def _heads(channels: int, *, recurrent: bool) -> nn.Conv3d:
    """Build all heads as one 1 x 1 x 1 convolution: alpha, c(3), w(3), lambda, s(3) [, u]."""
    bias = [_INITIAL_BIAS["alpha"], *[_INITIAL_BIAS["c"]] * 3]
    bias += [*[_INITIAL_BIAS["w"]] * 3, _INITIAL_BIAS["sharpness"], 0.0, 1.0, 0.0]
    if recurrent:
        bias += [_KEPT_BIAS]
    heads = nn.Conv3d(channels, len(bias), 1)
    nn.init.normal_(heads.weight, std=0.1 / math.sqrt(channels))
    with torch.no_grad():
        heads.bias.copy_(torch.tensor(bias))  # pyright: ignore[reportOptionalMemberAccess]
    return heads


def _direct_heads(outputs: int, *, recurrent: bool) -> nn.Conv3d:
    """Build the connection from the observed volume to the heads, initially a copy.

    V_u, the last row of a recurrent decoder, starts at `_KEPT_BIAS`, and at its opposite where the frame shows a
    surface or empty space: a new observation replaces the previous volume, everything else is kept.
    Where the frame shows a surface, alpha starts at 0.88 and c at the observed colour; elsewhere c starts at the
    surroundings' colour. Without this connection the image must be learned through half the
    resolution: on 8 held-out sequences, mean log-L2 was 0.075 after 100 steps; the copy has 0.067 before the first.
    """
    direct = nn.Conv3d(8, outputs, 1, bias=False)
    with torch.no_grad():
        direct.weight.zero_()
        for channel in range(3):
            direct.weight[1 + channel, channel] = 1.0
            direct.weight[1 + channel, 5 + channel] = 1.0
        direct.weight[0, 3] = 5.0
        if recurrent:
            direct.weight[-1, 3] = -2 * _KEPT_BIAS
            direct.weight[-1, 4] = 2 * _KEPT_BIAS  # e is -1 in empty space
    return direct


def mean_colour(volume: Float[Tensor, "b 5 z y x"]) -> Float[Tensor, "b 3 1 1 1"]:
    """Return the geometric mean of the radiance of an initial volume's surfaces; grey if there are hardly any.

    Geometric, because a window makes a room's arithmetic mean several times as bright as its walls.
    """
    alpha = volume[:, 3:4]
    logs = (alpha * torch.log(_colour(volume).clamp(max=1) + DARKEST)).sum(dim=(2, 3, 4), keepdim=True)
    return torch.exp((logs + math.log(GREY)) / (alpha.sum(dim=(2, 3, 4), keepdim=True) + 1))


def _colour(volume: Float[Tensor, "b 5 z y x"]) -> Float[Tensor, "b 3 z y x"]:
    """C of an initial volume, whose c is alpha C."""
    return torch.relu(volume[:, :3]) / volume[:, 3:4].clamp(min=1e-3)


def _observed(volume: Float[Tensor, "b 5 z y x"], level: Tensor) -> Float[Tensor, "b 5 z y x"]:
    """Convert an initial volume to the heads' units: log c relative to its initial value (0 if unseen), alpha, e."""
    seen = torch.log(_colour(volume) + DARKEST) - _INITIAL_BIAS["c"] - level
    return torch.cat([volume[:, 3:4] * seen, volume[:, 3:]], dim=1)


def _surroundings(observed: Float[Tensor, "b 5 z y x"], level: Tensor) -> Float[Tensor, "b 3 z y x"]:
    """Fill voxels without a surface from their surroundings, in the units of `_observed`, by push-pull.

    Push-pull (Gortler et al. 1996) uses coarser levels where finer ones have no data; the coarsest falls back to the
    mean colour (0). Colours brighter than white count as white: windows and lamps end at their frames, walls continue.
    """
    alpha = observed[:, 3:4]
    white = -_INITIAL_BIAS["c"] - level
    sums = [torch.cat([torch.minimum(observed[:, :3], alpha * white), alpha], dim=1)]
    while min(sums[-1].shape[2:]) >= 4:
        sums.append(functional.avg_pool3d(sums[-1], 2))
    around = torch.zeros_like(sums[-1][:, :3])
    for level in reversed(sums):
        known = level[:, 3:4]
        around = resize_volume(around, level.shape[2:])
        around = (level[:, :3] + _FILL_OPACITY * around) / (known + _FILL_OPACITY)
    return (1 - alpha) * around
