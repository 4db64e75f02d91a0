"""The recursion over a probe's panoramas in PyTorch: the conservative rule, blending and accumulation.

The differentiable twin of `roomlight.engine.panorama.blend`, for training. Panoramas are [batch, channel, H, 2H],
radiance is linear. Depths are distances from the probe; the margin of the conservative rule has the same unit.

Two rules of the engine have no twin: that for light that changes, as the light of training rooms is constant and there
it takes nothing (tested), and the weight of 1 of measured light above white, which was added after the training.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from roomlight.conventions import LUMINANCE
from roomlight.engine.kernels.blend import HIGHER, NOISE
from roomlight.engine.panorama.blend import DARK, FILL_COLOUR, UNSEEN_DEPTH


class Observation(NamedTuple):
    """Panoramas rendered at a probe for one frame.

    hdr is the volume's rendering. ldr is the mesh's, and outside the mesh (mask 0) a fill from the pixels seen so far
    (`roomlight.engine.panorama.fill.fill_unknown`). depth is in units of the volume's depth_max_m and at most
    `roomlight.engine.panorama.blend.farthest_depth_m`; otherwise the conservative rule would reject surfaces outside
    the volume when they are first seen. clipped and guessed are those of the engine's `PartialPanorama`;
    None: nothing was clipped in the whole sequence.
    """

    hdr: Float[Tensor, "b 3 h w"]
    ldr: Float[Tensor, "b 3 h w"]
    mask: Float[Tensor, "b 1 h w"]
    depth: Float[Tensor, "b 1 h w"]
    clipped: Float[Tensor, "b 1 h w"] | None = None
    guessed: Float[Tensor, "b 1 h w"] | None = None


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
    colour = (ldr + DARK) / (luminance(ldr) + DARK)
    return hdr * mask + (1 - mask) * torch.lerp(mixed, luminance(mixed) * colour, FILL_COLOUR)


def luminance(light: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Return the luminance of linear RGB (`roomlight.conventions.LUMINANCE`)."""
    weights = torch.from_numpy(LUMINANCE).to(light.device)
    return (light.float() * weights[:, None, None]).sum(dim=1, keepdim=True)  # in float32 under autocast too


def first_panorama(seen: Observation, weight: Float[Tensor, "b 1 h w"]) -> Panorama:
    """Return the state after frame 0: the recursion from weight 0 and depth `UNSEEN_DEPTH` everywhere."""
    taken = weight.detach()
    planes = [None if plane is None else taken * plane for plane in (seen.clipped, seen.guessed)]
    depth = weight * seen.depth + (1 - weight) * UNSEEN_DEPTH
    return Panorama(blend(seen.hdr, seen.ldr, weight), depth, weight, *planes)


def conservative(
    weight: Float[Tensor, "b 1 h w"],
    depth: Float[Tensor, "b 1 h w"],
    accumulated_depth: Float[Tensor, "b 1 h w"],
    *,
    margin: float | Float[Tensor, "b 1 1 1"],
) -> Float[Tensor, "b 1 h w"]:
    """Apply L_M = max(L_M - 1(D_hat - D < margin), 0): detail is kept unless the new surface is clearly closer.

    The paper's margin is 0.25; `roomlight.engine.panorama.blend` applies it in metres.
    """
    not_closer = (accumulated_depth - depth < margin).to(weight.dtype)
    return torch.relu(weight - not_closer)


def accepted(
    weight: Float[Tensor, "b 1 h w"], seen: Observation, kept: Panorama, *, margin: float | Float[Tensor, "b 1 1 1"]
) -> Float[Tensor, "b 1 h w"]:
    """Return the weight after the engine's rules: closer surfaces, and clipped ones seen at another exposure."""
    ruled = conservative(weight, seen.depth, kept.depth, margin=margin)
    if seen.clipped is None or seen.guessed is None or kept.clipped is None or kept.guessed is None:
        return ruled
    # `roomlight.engine.panorama.blend.better_share`, of lower bounds of luminance
    old, new = (luminance(light.detach()) for light in (kept.radiance, seen.ldr))
    old, new = old - kept.guessed, new - seen.guessed
    less = (kept.clipped - seen.clipped) / kept.clipped.clamp(min=1e-12)
    less = less.clamp(min=0) * (new >= old * (1 - float(NOISE) * kept.clipped))
    share = torch.where(new * kept.clipped > float(HIGHER) * old, torch.ones_like(less), less)
    better = share * (kept.clipped > 0)
    same = (kept.depth - seen.depth).abs() < margin
    return torch.where(same, torch.maximum(ruled, better * weight.clamp(max=1)), ruled)


def accumulate(state: Panorama, seen: Observation, weight: Float[Tensor, "b 1 h w"]) -> Panorama:
    """Return the state after one more frame (eqs. videoBlend, depthAccu, maskAccu); `weight` is as `accepted` has it.

    Its mask is not used: outside it the weight is 0.
    """
    # eq. videoBlend: L^i = L_M L_tilde + (1 - L_M) ((1 - L_hat_M) L_dot + L_hat_M L^{i-1})
    kept = (1 - state.weight) * seen.hdr + state.weight * state.radiance
    radiance = weight * seen.ldr + (1 - weight) * kept
    depth = weight * seen.depth + (1 - weight) * state.depth  # eq. depthAccu
    accumulated_weight = (state.weight + weight).clamp(max=1.0)  # eq. maskAccu
    if seen.clipped is None or seen.guessed is None or state.clipped is None or state.guessed is None:
        return Panorama(radiance, depth, accumulated_weight)
    taken = weight.detach()
    clipped = taken * seen.clipped + (1 - taken) * state.clipped
    guessed = taken * seen.guessed + (1 - taken) * state.guessed
    return Panorama(radiance, depth, accumulated_weight, clipped, guessed)
