"""SGLV ray marching in plain PyTorch: the differentiable twin of `roomlight.engine.volume.sglv` (paper, section 3).

Frame: the volume's, in metres, for origins, directions and lobe axes. `grid_sample` evaluates all samples at once and
keeps [N, samples, 11] values for the backward pass, which limits the number of rays in a training step.
"""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from roomlight.engine.volume.sglv import MAX_SAMPLES, Far


def render_rays(
    alpha: Float[Tensor, "z y x"],
    lobes: Float[Tensor, "z y x 10"],
    *,
    lower_m: Float[Tensor, "3"],
    voxel_m: Float[Tensor, "3"],
    origin: Float[Tensor, "3"] | Float[Tensor, "n 3"],
    directions: Float[Tensor, "n 3"],
    step_m: float | None = None,
    samples: int = MAX_SAMPLES,
    far: Far = "boundary",
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Compute the radiance and the residual transmittance of rays. A ray that misses has radiance 0, transmittance 1.

    Args:
        alpha: Opacity of each voxel.
        lobes: c (3), w (3), lambda, s (3) of each voxel.
        lower_m: The volume's lower corner (x, y, z).
        voxel_m: A voxel's edges (x, y, z).
        origin: Origin of all rays, or of each ray.
        directions: Unit directions.
        step_m: Distance of samples, which are at t_enter + (i + 0.5) step_m; the mean edge if None.
        samples: Largest number of samples on a ray.
        far: "boundary" adds the values at the exit point by the residual transmittance; "none" adds nothing.
    """
    volume = torch.cat([alpha[None], lobes.permute(3, 0, 1, 2)])[None]  # [1, 11, z, y, x]
    size = voxel_m * torch.tensor(alpha.shape[::-1], dtype=voxel_m.dtype, device=voxel_m.device)
    step = float(voxel_m.mean()) if step_m is None else step_m
    origin = origin.expand_as(directions)
    enter, leave = _box(origin, directions, lower_m=lower_m, upper_m=lower_m + size)
    hits = leave > enter  # [n]

    index = torch.arange(samples, dtype=directions.dtype, device=directions.device)
    t = enter[:, None] + (index + 0.5) * step  # [n, samples]
    inside = hits[:, None] & (t < leave[:, None])
    points = origin[:, None] + t[..., None] * directions[:, None]
    values = _sample(volume, points, lower_m=lower_m, size_m=size)  # [n, samples, 11]

    # eq. 1: x_l = sum_i alpha_i x_i prod_{j < i} (1 - alpha_j)
    opacity = torch.where(inside, values[..., 0], 0.0)
    passed = torch.cumprod(1 - opacity, dim=1)
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    total = ((before * opacity)[..., None] * values[..., 1:]).sum(dim=1)  # [n, 10]
    transmittance = passed[:, -1]
    if far == "boundary":
        exits = origin + torch.where(hits, leave, 0.0)[:, None] * directions
        shell = _sample(volume, exits[:, None], lower_m=lower_m, size_m=size)[:, 0, 1:]
        total = total + torch.where(hits, transmittance, 0.0)[:, None] * shell

    # eq. 2: L_l = c_l + w_l exp(lambda_l (l . s_l - 1))
    colour, intensity, sharpness, axis = total.split([3, 3, 1, 3], dim=1)
    cosine = (directions * axis).sum(dim=1, keepdim=True)
    return colour + intensity * torch.exp(sharpness * (cosine - 1)), transmittance


def _box(
    origin: Float[Tensor, "n 3"],
    directions: Float[Tensor, "n 3"],
    *,
    lower_m: Float[Tensor, "3"],
    upper_m: Float[Tensor, "3"],
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Return the distances at which rays enter (0 from inside) and leave the box; leave <= enter is a miss."""
    # an exact 0 would give 0 / 0 on a face; 1e-12 moves that wall to 1e12 m
    tiny = torch.full_like(directions, 1e-12)
    slope = torch.where(directions.abs() < 1e-12, tiny, directions)
    first, second = (lower_m - origin) / slope, (upper_m - origin) / slope
    enter = torch.minimum(first, second).amax(dim=1).clamp(min=0.0)
    leave = torch.maximum(first, second).amin(dim=1)
    return enter, leave


def _sample(
    volume: Float[Tensor, "1 c z y x"],
    points: Float[Tensor, "n s 3"],
    *,
    lower_m: Float[Tensor, "3"],
    size_m: Float[Tensor, "3"],
) -> Float[Tensor, "n s c"]:
    """Sample trilinearly: index (p - lower) / voxel - 0.5, clamped to the outermost voxel centres.

    This is exactly `grid_sample` with align_corners=False and border padding.
    """
    unit = 2 * (points - lower_m) / size_m - 1
    sampled = functional.grid_sample(
        volume, unit[None, :, :, None], mode="bilinear", padding_mode="border", align_corners=False
    )
    return sampled[0, :, :, :, 0].permute(1, 2, 0)
