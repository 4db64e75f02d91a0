"""Stages in plain PyTorch, to time beside ours: `grid_sample` and whole tensors, without kernels of our own.

Ray tracing is `roomlight_model.ray_marching_reference`, the readable twin of training's ray tracing; accumulation is
`roomlight_model.accumulate`.

Functions import PyTorch when they are called, because `roomlight bench stages` also runs without it: call them only if
`torch_installed()`.
"""

import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from roomlight.camera import rigid_inverse
from roomlight.engine.observations import CLOSER_M
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.volume.grid import VolumeGrid
from roomlight.engine.volume.sglv import Far, Sglv
from roomlight.frame import Frame

if TYPE_CHECKING:
    from torch import Tensor


def torch_installed() -> bool:
    """Return whether PyTorch can be imported, without importing it."""
    return importlib.util.find_spec("torch") is not None


def volume_by_grid_sample(grid: VolumeGrid, frame: Frame) -> Callable[[], Float[np.ndarray, "5 z y x"]]:
    """Return a function that does what `roomlight.engine.volume.grid.initial_volume` does, all voxels at once."""
    import torch
    from torch.nn import functional

    lens = frame.intrinsics
    pose = rigid_inverse(frame.camera_to_world) @ grid.volume_to_world
    centres, transform = _tensor(grid.centres_m()), _tensor(pose)
    camera = _tensor(rigid_inverse(pose)[:3, 3])
    lower, upper, edge = _tensor(grid.lower_m), _tensor(grid.upper_m), grid.edge_m
    image = _tensor(frame.image).permute(2, 0, 1)[None]
    depth = _tensor(frame.depth_m)[None, None]
    known = (depth > 0).float()

    def look_up(picture: "Tensor", unit: "Tensor") -> "Tensor":
        flat = unit.reshape(1, 1, -1, 2)
        values = functional.grid_sample(picture, flat, padding_mode="border", align_corners=False)
        return values[0, :, 0].reshape(-1, *grid.shape)

    @torch.inference_mode()
    def run() -> Float[np.ndarray, "5 z y x"]:
        points = centres @ transform[:3, :3].T + transform[:3, 3]
        z = -points[..., 2]
        u = (lens.cx + lens.fx * points[..., 0] / z) / lens.width
        v = (lens.cy - lens.fy * points[..., 1] / z) / lens.height
        unit = torch.stack([2 * u - 1, 2 * v - 1], dim=-1).nan_to_num(0.0)
        in_view = (z > 0) & (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
        share = look_up(known, unit)[0]
        measured = look_up(depth, unit)[0] / share.clamp(min=1e-6)
        away = centres - camera
        away = torch.where(away.abs() < 1e-9, torch.full_like(away, 1e-9), away)
        reach = torch.maximum((lower - camera) / away, (upper - camera) / away).amin(dim=-1)
        unknown = share < 0.5
        surface = torch.where(unknown, z * reach - edge, measured)
        offset = (surface - z) / edge
        alpha = (4 * torch.where(offset > 0, 1 - offset, offset + 5)).clamp(0, 1) * in_view
        empty = -((offset > 3) & ~unknown & in_view).float()
        return torch.cat([alpha * look_up(image, unit), alpha[None], empty[None]]).numpy()

    return run


def panorama_by_grid_sample(
    sglv: Sglv,
    position_world: tuple[float, float, float],
    directions_world: Float[np.ndarray, "n 3"],
    *,
    samples: int,
    step_m: float,
    far: Far,
) -> Callable[[], Float[np.ndarray, "n 3"]]:
    """Return a function that traces all rays and samples at once; the volume is converted to tensors beforehand.

    `position_world` and `directions_world` are in world axes, metres; the result is linear radiance.
    """
    import torch

    from roomlight_model.ray_marching_reference import render_rays

    grid = sglv.grid
    rotation = grid.world_to_volume[:3, :3]
    alpha, lobes = _tensor(sglv.alpha), _tensor(sglv.lobes)
    lower_m, voxel_m = _tensor(grid.lower_m), _tensor(grid.voxel_m)
    origin = _tensor(rotation @ np.asarray(position_world) + grid.world_to_volume[:3, 3])
    directions = _tensor(directions_world @ rotation.T)

    @torch.inference_mode()
    def run() -> Float[np.ndarray, "n 3"]:
        radiance, _ = render_rays(
            alpha,
            lobes,
            lower_m=lower_m,
            voxel_m=voxel_m,
            step_m=step_m,
            origin=origin,
            directions=directions,
            samples=samples,
            far=far,
        )
        return radiance.numpy()

    return run


def accumulate_by_tensors(
    state: PanoramaState,
    *,
    hdr: Float[np.ndarray, "h w 3"],
    detail: Float[np.ndarray, "h w 3"],
    detail_depth_m: Float[np.ndarray, "h w"],
    weight: Float[np.ndarray, "h w"],
) -> Callable[[], Float[np.ndarray, "h w 3"]]:
    """Return a function that applies the conservative rule and the accumulation to tensors [1, c, h, w]."""
    import torch

    from roomlight_model.accumulate import Observation, Panorama, accepted, accumulate

    def panel(array: Float[np.ndarray, "..."]) -> "Tensor":
        planes = array if array.ndim == 3 else array[..., None]
        return _tensor(planes).permute(2, 0, 1)[None].contiguous()

    before = Panorama(panel(state.radiance), panel(state.depth_m), panel(state.observed))
    share = panel(weight)
    seen = Observation(panel(hdr), panel(detail), (share > 0).float(), panel(detail_depth_m))

    @torch.inference_mode()
    def run() -> Float[np.ndarray, "h w 3"]:
        after = accumulate(before, seen, accepted(share, seen, before, margin=CLOSER_M))
        return after.radiance[0].permute(1, 2, 0).numpy()

    return run


def _tensor(array: Any) -> "Tensor":
    import torch

    return torch.from_numpy(np.array(array, np.float32))  # a copy: PyTorch warns of read-only memory
