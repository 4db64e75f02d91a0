"""Convert examples to batches of tensors: initial volumes, partial panoramas and the true light.

The serving engine's own code computes them, so that the networks are trained on the inputs they will get.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from roomlight.depth import complete_depth
from roomlight.engine.networks.clipping import shipped_clipping
from roomlight.engine.panorama.blend import (
    PanoramaState,
    PartialPanorama,
    accumulate,
    farthest_depth_m,
    fill_beyond,
    latest_detail,
    unseen_depth_m,
)
from roomlight.engine.preparation import restored
from roomlight.engine.surface.bracket import update_keyframes
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.fusion import FusedVolume
from roomlight.engine.volume.grid import VolumeGrid, clipping_buffer, initial_volume
from roomlight.frame import Frame
from roomlight.spheres import resize_panorama
from roomlight_model.accumulate import Panorama
from roomlight_model.training.examples import Example

Self = TypeVar("Self", bound="Tensors")
"""`typing.Self`, which the tests' type checker accepts only in decorated classes."""


@dataclass(frozen=True, eq=False)
class Tensors:
    """Examples of any stage: fields are tensors or arrays whose first axis is the example, or None."""

    def __len__(self) -> int:
        return len(next(value for value in vars(self).values() if value is not None))

    def take(self: Self, numbers: Sequence[int]) -> Self:
        """Return the examples with these numbers; all fields must be known."""
        return replace(self, **{name: value[list(numbers)] for name, value in vars(self).items()})

    def to(self: Self, device: torch.device) -> Self:
        """Copy the batch to another device."""
        moved = {name: value.to(device) for name, value in vars(self).items() if isinstance(value, Tensor)}
        return replace(self, **moved)

    def pieces(self: Self, size: int) -> list[Self]:
        """Split the batch into batches of `size`; the last one has the remainder."""
        parts = {name: value.split(size) for name, value in vars(self).items() if isinstance(value, Tensor)}
        return [
            replace(self, **{name: part[number] for name, part in parts.items()})
            for number in range(-(-len(self) // size))
        ]


@dataclass(frozen=True, eq=False)
class Probes(Tensors):
    """Volumes' frames and probes of some examples. Subclasses add the examples' other tensors."""

    lower_m: Float[Tensor, "b 3"]
    voxel_m: Float[Tensor, "b 3"]
    world_to_volume_rotation: Float[Tensor, "b 3 3"]
    """World to volume axes; includes the reflection of a mirrored example."""
    origins: Float[Tensor, "b p 3"]
    """Probes in the volume's frame, metres."""
    to_viewer: Float[Tensor, "b p 3"]
    """Unit world vectors from the probes toward the first camera."""


@dataclass(frozen=True, eq=False)
class Batch(Probes):
    """Examples as tensors."""

    volume: Float[Tensor, "b 5 z y x"]
    truth: Float[Tensor, "b p 3 h w"]
    partial: Float[Tensor, "b p 3 h w"] | None = None
    """The last frame's mesh rendered at each probe, and a fill outside it; for the blending stages."""
    mask: Float[Tensor, "b p 1 h w"] | None = None
    """1 where `partial` shows the mesh, 0 where it is filled."""
    before: Float[Tensor, "b p 3 h w"] | None = None
    """Detail accumulated from the earlier frames."""
    kept: Float[Tensor, "b p 1 h w"] | None = None
    """1 where the probe keeps `before`: the last frame shows no closer surface."""


def collate(examples: list[Example], *, volume_shape: tuple[int, int, int], panorama_height: int | None) -> Batch:
    """Build a batch of examples that have the same number of probes.

    With a `panorama_height`, partial panoramas are rendered and the truth is resampled at this height.
    """
    columns: dict[str, list[np.ndarray]] = {}

    def add(name: str, value: np.ndarray) -> None:
        columns.setdefault(name, []).append(np.asarray(value, np.float32))

    for example in examples:
        frames = restored_frames(example)
        grid = VolumeGrid.from_frame(frames[0], shape=volume_shape)
        volume = _mean_volume(grid, frames)
        add("volume", volume[..., ::-1] if example.mirrored else volume)
        for name, value in probe_columns(example, grid).items():
            add(name, value)
        add("truth", np.moveaxis(at_height(example.truth, panorama_height), -1, 1))
        if panorama_height is not None:
            meshes = [FrameMesh(frame) for frame in frames]
            details = [_probe_detail(meshes, position, grid, panorama_height) for position in example.positions]
            for name, planes in zip(_ProbeDetail._fields, zip(*details, strict=True), strict=True):
                add(name, np.stack([np.moveaxis(plane, -1, 0) for plane in planes]))
    return Batch(**{name: torch.from_numpy(np.stack(values)) for name, values in columns.items()})


def restored_frames(example: Example) -> list[Frame]:
    """Return the frames of an example with completed depth and restored clipped light, as in the serving engine.

    Clipped pixels are taken from earlier frames of shorter exposure, as if all of these were keyframes; the shipped
    network estimates the others.
    """
    clipping = shipped_clipping("cpu")
    frames = [restored(example.frame, example.depth_m, clipping=clipping)]
    meshes: list[FrameMesh] = []
    for frame in example.later:
        meshes.append(FrameMesh(frames[-1]))
        update_keyframes(meshes[-1], meshes[:-1], turn=len(meshes) - 1)
        frames.append(restored(frame, complete_depth(frame.depth_m), meshes, clipping=clipping))
    return frames


def probe_columns(example: Example, grid: VolumeGrid) -> dict[str, np.ndarray]:
    """Return the fields of `Probes` for one example."""
    rotation = np.diag([-1.0 if example.mirrored else 1.0, 1.0, 1.0]) @ grid.world_to_volume[:3, :3]
    away = example.positions - example.frame.camera_to_world[:3, 3]
    return {
        "lower_m": grid.lower_m,
        "voxel_m": grid.voxel_m,
        "world_to_volume_rotation": rotation,
        "origins": away @ rotation.T,
        "to_viewer": -away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6),
    }


def _mean_volume(grid: VolumeGrid, frames: Sequence[Frame]) -> Float[np.ndarray, "5 z y x"]:
    """Compute the volume that the serving engine gives to the networks after these frames."""
    fused = FusedVolume.fresh(grid.shape)
    for frame in frames:
        clipping = clipping_buffer(grid, frame)
        fused.add(initial_volume(grid, frame, clipping=clipping), clipping)
    volume = np.empty((5, *grid.shape), np.float32)
    fused.write(volume)
    return volume


class _ProbeDetail(NamedTuple):
    """One probe's share of the fields of `Batch` with the same names."""

    partial: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w 1"]
    before: Float[np.ndarray, "h w 3"]
    kept: Bool[np.ndarray, "h w 1"]


def _probe_detail(
    meshes: Sequence[FrameMesh], position: Float[np.ndarray, "3"], grid: VolumeGrid, height: int
) -> _ProbeDetail:
    """Compute the serving engine's panoramas at the last frame, with blending weight 1 in the earlier frames."""
    state = PanoramaState.fresh(height, grid.depth_max_m)
    nothing = np.zeros((height, 2 * height, 3), np.float32)
    farthest_m = farthest_depth_m(grid.depth_max_m)
    *earlier, last = (mesh.render_panorama(position, height=height).within(farthest_m) for mesh in meshes)
    for mesh, detail in zip(meshes, earlier, strict=False):
        weight, camera = detail.mask.astype(np.float32), mesh.camera_to_world[:3, 3] - position
        unseen_m = unseen_depth_m(grid.depth_max_m)
        accumulate(state, detail, hdr=nothing, weight=weight, unseen_m=unseen_m, camera=camera)
    filled = fill_beyond(*latest_detail(state, last), last, hdr=nothing)
    kept = (state.observed > 0) & ~(last.mask & state.is_closer(last.depth_m))
    return _ProbeDetail(filled, last.mask[..., None], state.radiance, kept[..., None])


def at_height(panoramas: Float[np.ndarray, "p h w 3"], height: int | None) -> Float[np.ndarray, "p h2 w2 3"]:
    """Resample panoramas to a height; None keeps them."""
    if height is None or panoramas.shape[1] == height:
        return panoramas
    return np.stack([resize_panorama(panorama, height) for panorama in panoramas])


def fill_detail(
    state: Panorama | None,
    detail: Float[Tensor, "3 h w"],
    mask: Float[Tensor, "1 h w"],
    distance_m: Float[Tensor, "1 h w"],
    hdr: Float[Tensor, "3 h w"],
    depth_max_m: float,
) -> Float[Tensor, "3 h w"]:
    """Return one probe's detail with the serving engine's fill outside the mesh; without a gradient."""
    accumulated = PanoramaState.fresh(mask.shape[-2], depth_max_m)
    if state is not None:
        accumulated.radiance[:] = _image(state.radiance)
        accumulated.depth_m[:] = _image(state.depth)[..., 0] * np.float32(depth_max_m)
        accumulated.observed[:] = _image(state.weight)[..., 0]
    seen = PartialPanorama(_image(detail), _image(mask)[..., 0] > 0, _image(distance_m)[..., 0])
    filled = fill_beyond(*latest_detail(accumulated, seen), seen, hdr=_image(hdr))
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(filled, -1, 0)))


def _image(planes: Float[Tensor, "c h w"]) -> Float[np.ndarray, "h w c"]:
    return np.moveaxis(planes.detach().float().cpu().numpy(), 0, -1)
