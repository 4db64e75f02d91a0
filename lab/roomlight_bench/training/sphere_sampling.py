"""A glossy sphere, lit by the rendering layer's importance sampling or by a grid of directions.

The grid covers theta and phi of each normal's hemisphere and is the same for every normal, as in earlier rendering
layers (Li et al. 2020). Importing this module needs PyTorch.
"""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from roomlight_model.sphere_rendering import brdf_and_density, look_up, sample_sphere, shade

_CHUNK = 500_000
"""Directions that are evaluated together: a few tens of megabytes."""


class SphereSampling:
    """One sphere lit by one panorama: linear radiance of its pixels, from any number of directions per pixel."""

    def __init__(
        self,
        panorama: Float[np.ndarray, "h w 3"],
        normals: Float[np.ndarray, "n 3"],
        view: tuple[float, float, float],
        *,
        seed: int = 0,
    ) -> None:
        """Prepare a sphere; `normals` and `view` are in world axes, as in `roomlight.spheres.SphereRenderer`."""
        self._light = torch.from_numpy(np.ascontiguousarray(panorama, np.float32)).permute(2, 0, 1)[None]
        self._normals = torch.from_numpy(np.ascontiguousarray(normals, np.float32))
        self._to_viewer = functional.normalize(-torch.tensor(view, dtype=torch.float32), dim=0)
        self._generator = torch.Generator().manual_seed(seed)

    def by_importance(self, count: int) -> Float[np.ndarray, "n 3"]:
        """Sample `count` directions per pixel by the BRDF; they differ between pixels and between calls."""
        parts: list[Tensor] = []
        for normals in self._normals.split(max(1, _CHUNK // count)):
            samples = sample_sphere(normals, self._to_viewer, samples=count, generator=self._generator)
            parts.append(shade(samples, self._radiance(samples.directions)))
        return torch.cat(parts).numpy()

    def by_grid(self, count: int) -> Float[np.ndarray, "n 3"]:
        """Use k rows of 4 k directions (count = 4 k^2) for every pixel, weighted by the solid angles of their cells."""
        rows = max(1, round(math.sqrt(count / 4)))
        columns = count // rows
        theta = (torch.arange(rows) + 0.5) / rows * (math.pi / 2)
        phi = (torch.arange(columns) + 0.5) / columns * (2 * math.pi)
        theta, phi = (axis.reshape(-1) for axis in torch.meshgrid(theta, phi, indexing="ij"))
        local = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], dim=-1)
        up = torch.tensor([0.0, 1.0, 0.0]).expand_as(self._normals)
        sideways = torch.tensor([1.0, 0.0, 0.0]).expand_as(self._normals)
        across = torch.where(self._normals[:, 1:2].abs() < 0.9, up, sideways)
        tangent = functional.normalize(torch.linalg.cross(across, self._normals), dim=-1)
        frame = torch.stack([tangent, torch.linalg.cross(self._normals, tangent), self._normals], dim=1)
        directions = torch.einsum("sa,nai->nsi", local, frame)
        value, _ = brdf_and_density(self._normals, self._to_viewer, directions, 0.5)
        solid_angle = theta.sin() * (math.pi / 2 / rows) * (2 * math.pi / columns)
        return (value * solid_angle)[..., None].mul(self._radiance(directions)).sum(1).numpy()

    def _radiance(self, directions: Float[Tensor, "n s 3"]) -> Float[Tensor, "n s 3"]:
        return look_up(self._light, directions.reshape(1, -1, 3)).reshape(directions.shape)
