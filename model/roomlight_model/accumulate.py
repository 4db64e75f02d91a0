"""The recursion over a probe's panoramas in PyTorch: the conservative rule, blending and accumulation.

The differentiable twin of `roomlight.engine.panorama.blend`, for training. Panoramas are [batch, channel, H, 2H],
radiance is linear. Depths are distances from the probe; the margin of the conservative rule has the same unit.

The engine's rule for light that changes has no twin: the light of training rooms is constant, and there it takes
nothing (tested).
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from roomlight.conventions import LUMINANCE
from roomlight.engine.kernels.blend import HIGHER, NOISE
from roomlight.engine.panorama.blend import DARK, FILL_COLOUR


class Panorama(NamedTuple):
    """The accumulated state of a probe: radiance L^i, depth and blending weight.

    clipped and guessed are as in `roomlight.engine.panorama.blend.PanoramaState`; None: nothing was clipped.
    """

    radiance: Float[Tensor, "b 3 h w"]
    depth: Float[Tensor, "b 1 h w"]
    weight: Float[Tensor, "b 1 h w"]
    clipped: Float[Tensor, "b 1 h w"] | None = None
    guessed: Float[Tensor, "b 1 h w"] | None = None


def blend(
    hdr: Float[Tensor, "b 3 h w"], ldr: Float[Tensor, "b 3 h w"], weight: Float[Tensor, "b 1 h w"]
) -> Float[Tensor, "b 3 h w"]:
    """Blend the single-view panorama: L = L_dot (1 - L_M) + L_tilde L_M."""
    return hdr * (1 - weight) + ldr * weight


def fill_in(
    hdr: Float[Tensor, "b 3 h w"],
    ldr: Float[Tensor, "b 3 h w"],
    mask: Float[Tensor, "b 1 h w"],
    *,
    weight: Float[Tensor, "b 1 h w"],
) -> Float[Tensor, "b 3 h w"]:
    """Mix the fill in `ldr` into the HDR panorama outside the mesh: its radiance by `weight`, and most of its hue."""
    mixed = blend(hdr, ldr, weight)
    colour = (ldr + DARK) / (_luminance(ldr) + DARK)
    return hdr * mask + (1 - mask) * torch.lerp(mixed, _luminance(mixed) * colour, FILL_COLOUR)


def _luminance(light: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    return torch.einsum("bchw,c->bhw", light, torch.from_numpy(LUMINANCE).to(light))[:, None]


def first_panorama(
    hdr: Float[Tensor, "b 3 h w"],
    ldr: Float[Tensor, "b 3 h w"],
    depth: Float[Tensor, "b 1 h w"],
    *,
    weight: Float[Tensor, "b 1 h w"],
    unseen_depth: float,
    clipped: Float[Tensor, "b 1 h w"] | None = None,
    guessed: Float[Tensor, "b 1 h w"] | None = None,
) -> Panorama:
    """Return the state after frame 0: the recursion from weight 0 and depth `unseen_depth` everywhere."""
    taken = weight.detach()
    planes = [None if plane is None else taken * plane for plane in (clipped, guessed)]
    return Panorama(blend(hdr, ldr, weight), weight * depth + (1 - weight) * unseen_depth, weight, *planes)


def conservative(
    weight: Float[Tensor, "b 1 h w"],
    depth: Float[Tensor, "b 1 h w"],
    accumulated_depth: Float[Tensor, "b 1 h w"],
    *,
    margin: float | Float[Tensor, "b 1 1 1"] = 0.25,
) -> Float[Tensor, "b 1 h w"]:
    """Apply L_M = max(L_M - 1(D_hat - D < margin), 0): detail is kept unless the new surface is clearly closer.

    The paper's margin is 0.25; `roomlight.engine.panorama.blend` applies it in metres.
    """
    not_closer = (accumulated_depth - depth < margin).to(weight.dtype)
    return torch.relu(weight - not_closer)


class Clipping(NamedTuple):
    """What of an observation was clipped: its share, and a lower bound of its luminance."""

    share: Float[Tensor, "b 1 h w"]
    bound: Float[Tensor, "b 1 h w"]

    @classmethod
    def of(
        cls, radiance: Float[Tensor, "b 3 h w"], share: Float[Tensor, "b 1 h w"], guessed: Float[Tensor, "b 1 h w"]
    ) -> "Clipping":
        """Return what is known of a radiance whose luminance was estimated by `guessed`; without a gradient."""
        return cls(share, _luminance(radiance.detach()) - guessed)


def better_share(kept: Clipping, new: Clipping) -> Float[Tensor, "b 1 h w"]:
    """Return how much of a clipped observation a new one replaces (`roomlight.engine.panorama.blend.better_share`)."""
    less = (kept.share - new.share) / kept.share.clamp(min=1e-12)
    less = less.clamp(min=0) * (new.bound >= kept.bound * (1 - float(NOISE) * kept.share))
    share = torch.where(new.bound * kept.share > float(HIGHER) * kept.bound, torch.ones_like(less), less)
    return share * (kept.share > 0)


def with_brackets(
    ruled: Float[Tensor, "b 1 h w"],
    weight: Float[Tensor, "b 1 h w"],
    better: Float[Tensor, "b 1 h w"],
    *,
    distance: Float[Tensor, "b 1 h w"],
    margin: float | Float[Tensor, "b 1 1 1"],
) -> Float[Tensor, "b 1 h w"]:
    """Raise the weight after `conservative` where the new observation of the same surface knows more.

    Args:
        ruled, weight: The weight after the conservative rule, and before it.
        better: `better_share`.
        distance: Difference of the accumulated depth and the new one.
    """
    same = distance.abs() < margin
    return torch.where(same, torch.maximum(ruled, better * weight.clamp(max=1)), ruled)


def accumulate(
    state: Panorama,
    hdr: Float[Tensor, "b 3 h w"],
    ldr: Float[Tensor, "b 3 h w"],
    *,
    depth: Float[Tensor, "b 1 h w"],
    weight: Float[Tensor, "b 1 h w"],
    clipped: Float[Tensor, "b 1 h w"] | None = None,
    guessed: Float[Tensor, "b 1 h w"] | None = None,
) -> Panorama:
    """Return the state after one more frame (eqs. videoBlend, depthAccu, maskAccu).

    `weight` must be the result of `conservative` and, where clipping is known, of `with_brackets`.
    """
    # eq. videoBlend: L^i = L_M L_tilde + (1 - L_M) ((1 - L_hat_M) L_dot + L_hat_M L^{i-1})
    kept = (1 - state.weight) * hdr + state.weight * state.radiance
    radiance = weight * ldr + (1 - weight) * kept
    # eq. depthAccu
    accumulated_depth = weight * depth + (1 - weight) * state.depth
    # eq. maskAccu
    accumulated_weight = (state.weight + weight).clamp(max=1.0)
    if clipped is None or guessed is None or state.clipped is None or state.guessed is None:
        return Panorama(radiance, accumulated_depth, accumulated_weight)
    taken = weight.detach()
    return Panorama(
        radiance,
        accumulated_depth,
        accumulated_weight,
        taken * clipped + (1 - taken) * state.clipped,
        taken * guessed + (1 - taken) * state.guessed,
    )
