"""`roomlight bench stages`: every stage of a session beside its NumPy reference and plain PyTorch."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np
from jaxtyping import Float

from roomlight.conventions import panorama_directions
from roomlight.engine.kernels.reference import accumulate_reference, initial_volume_reference, render_rays_reference
from roomlight.engine.models.classical import ClassicalVolume
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.engine.panorama.blend import (
    PanoramaState,
    PartialPanorama,
    accumulate,
    fill_beyond,
    latest_detail,
    unseen_depth_m,
)
from roomlight.engine.session import warm_up
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.engine.volume.grid import VolumeGrid, initial_volume
from roomlight.engine.volume.sglv import LOBE_CHANNELS, Far, Sglv, render_rays
from roomlight.errors import OptionError
from roomlight.frame import Frame
from roomlight.threads import thread_count
from roomlight_bench.reporting import describe_machine
from roomlight_bench.stages import plain_torch
from roomlight_bench.stages.bench_stage import BenchStage, differences, largest_difference
from roomlight_bench.stages.network_stages import load_networks, network_stages
from roomlight_bench.stages.report import AgainstReport, AgainstRow, StageRow, StagesReport, judge
from roomlight_bench.stages.room import PROBE, RoomSize, views
from roomlight_bench.stages.sessions import MeasuredSession, measure_against
from roomlight_bench.timing import Implementation, ProgressCallback, Timing, time_interleaved

SLOW_RUNS: Final = 3
"""Most runs of the references that take seconds."""
_FAINT_ALPHA: Final = (0.02, 0.05)
"""Opacity of empty space in the network-like volume: decoders start at 0.05, and training lowers it."""
_PEAK_EDGE: Final = 2048
"""Edge of the float32 matrices whose product, on NumPy's BLAS, is the machine's peak."""
_BRUTE_FORCE_RAYS: Final = 32
"""Rays of the brute-force reference; all 28,800 would take minutes."""


def run_stages(
    *,
    repeats: int = 7,
    model: Path | None = None,
    progress: ProgressCallback | None = None,
    size: RoomSize | None = None,
) -> StagesReport:
    """Time every stage; two to three minutes by default.

    Args:
        model: A model folder of `roomlight export`; default: the single-view networks inside the package.

    Raises:
        ModelError: `model` is not a model folder.
    """
    report: ProgressCallback = progress or (lambda _: None)
    size = size or RoomSize()
    report("compiling kernels")
    warm_up()
    if plain_torch.torch_installed():
        import torch

        torch.set_num_threads(thread_count())
    networks = load_networks(model or SHIPPED / "single")
    report("building the room")
    frames = views(size.keyframes, size)
    grid = VolumeGrid.from_frame(frames[0], shape=networks.loaded["cpu"].volume_shape)
    volume = initial_volume(grid, frames[0])
    report("warming up every stage")
    stages = [_volume_stage(grid, frames[0])]
    stages += network_stages(networks, volume)
    stages += _march_stages(grid, frames, size)
    stages += _mesh_stages(frames[0], size)
    stages.append(_fill_stage(frames[0], grid, size))
    stages.append(_accumulate_stage(frames[0], grid, size))
    provider = list(networks.loaded)[-1]  # the fastest
    sessions = [
        MeasuredSession("classical", size, provider=provider),
        MeasuredSession(networks.form, size, provider=provider, weights=model),
    ]
    stages += [
        BenchStage(name, Implementation(run), note=f"{session.keyframes} keyframes" if "late" in name else "")
        for session in sessions
        for name, run in session.runs().items()
    ]
    matrix = np.ones((_PEAK_EDGE, _PEAK_EDGE), np.float32)
    product = np.empty_like(matrix)
    peak = Implementation(lambda: np.matmul(matrix, matrix, out=product))
    peak.run()
    every = [work for stage in stages for work in (stage.ours, stage.reference, stage.torch) if work is not None]
    multiplied, *timings = time_interleaved([peak, *every], repeats, progress=report)
    timed = iter(timings)
    rows = [
        StageRow(
            stage.name,
            next(timed),
            next(timed) if stage.reference else None,
            next(timed) if stage.torch else None,
            paper_ms=stage.paper_ms,
            flops=stage.flops,
            note=stage.note,
            differences=stage.differences,
        )
        for stage in stages
    ]
    for session in sessions:
        for stage, times_ms in session.stage_ms.items():
            ours = Timing(min(times_ms), median(times_ms), len(times_ms))
            rows.append(StageRow(f"{stage}, {session.name}", ours, None, None, None, None, "of a frame", {}))
    return StagesReport(
        rows=tuple(rows),
        peak_flops_per_s=2e3 * _PEAK_EDGE**3 / multiplied.least_ms,
        criteria=judge(rows),
        machine=describe_machine(),
        threads=thread_count(),
        repeats=repeats,
        networks=f"{networks.form}, {model or 'shipped'}",
        torch=plain_torch.torch_installed(),
    )


def run_against(other: Path, *, rounds: int, progress: ProgressCallback | None = None) -> AgainstReport:
    """Measure whole frames and late points of this checkout and of another one, in turns.

    Args:
        rounds: Measurements of each; the least counts.

    Raises:
        OptionError: There is no checkout of RoomLight, or it cannot be measured.
    """
    if not (other / "core" / "roomlight").is_dir():
        raise OptionError(f"{other}: is no checkout of RoomLight, it has no core/roomlight")
    if progress is not None:
        progress("frames and late points, in turns with the other checkout")
    rows = measure_against(other, ("classical", "single"), rounds=rounds)
    return AgainstReport(tuple(AgainstRow(*row) for row in rows), str(other), describe_machine())


def _volume_stage(grid: VolumeGrid, frame: Frame) -> BenchStage:
    out = np.empty((5, *grid.shape), np.float32)
    ours = Implementation(lambda: initial_volume(grid, frame, out=out))
    reference = Implementation(lambda: initial_volume_reference(grid, frame))
    torch = Implementation(plain_torch.volume_by_grid_sample(grid, frame)) if plain_torch.torch_installed() else None
    deviations = differences(ours.run, {"reference": reference.run, "torch": torch.run if torch else None})
    return BenchStage("volume initialisation", ours, reference, torch, paper_ms=4.1, differences=deviations)


def _march_stages(grid: VolumeGrid, frames: list[Frame], size: RoomSize) -> list[BenchStage]:
    classical = ClassicalVolume(grid)
    for frame in frames:
        initial_volume(grid, frame, out=classical.volume)
        classical.update()
    classical.update()
    sparse = classical.sglv
    dense = _network_like(grid, sparse)
    return [
        _march_stage("ray tracing, network-like volume", dense, size, far="boundary", paper_ms=22.0),
        _march_stage("ray tracing, classical volume", sparse, size, far="none"),
    ]


def _march_stage(name: str, sglv: Sglv, size: RoomSize, *, far: Far, paper_ms: float | None = None) -> BenchStage:
    directions = panorama_directions(size.panorama_height).reshape(-1, 3)
    step_m = sglv.grid.edge_m

    def ours() -> Float[np.ndarray, "n 3"]:
        return render_rays(sglv, PROBE, directions, samples=size.samples, step_m=step_m, far=far)[0]

    def reference() -> Float[np.ndarray, "n 3"]:
        return render_rays_reference(sglv, PROBE, directions, samples=size.samples, step_m=step_m, far=far)[0]

    torch = None
    if plain_torch.torch_installed():
        traced = plain_torch.panorama_by_grid_sample
        torch = Implementation(traced(sglv, PROBE, directions, samples=size.samples, step_m=step_m, far=far))
    deviations = differences(ours, {"reference": reference, "torch": torch.run if torch else None})
    note = f"{len(directions)} rays, {size.samples} samples"
    return BenchStage(
        name,
        Implementation(ours),
        Implementation(reference, max_runs=SLOW_RUNS),
        torch,
        paper_ms,
        note=note,
        differences=deviations,
    )


def _mesh_stages(frame: Frame, size: RoomSize) -> list[BenchStage]:
    mesh = FrameMesh(frame)
    position, height = np.asarray(PROBE), size.panorama_height
    seen = mesh.render_panorama(position, height=height)
    directions = panorama_directions(height).reshape(-1, 3)
    chosen = np.linspace(0, len(directions) - 1, min(_BRUTE_FORCE_RAYS, len(directions))).astype(int)

    def trace() -> Float[np.ndarray, " n"]:
        return _brute_force_depth(mesh, position, directions[chosen])

    agreement = {"reference": largest_difference(seen.depth_m.reshape(-1)[chosen], trace())}
    rays, faces = len(directions), len(mesh.faces)
    panorama = BenchStage(
        "partial-mesh panorama",
        Implementation(lambda: mesh.render_panorama(position, height=height)),
        reference=Implementation(trace, scale=rays / len(chosen), max_runs=SLOW_RUNS),
        note=f"{rays} rays, {faces} triangles",
        differences=agreement,
    )
    return [BenchStage("mesh building", Implementation(lambda: FrameMesh(frame)), note="once per frame"), panorama]


def _brute_force_depth(
    mesh: FrameMesh, origin: Float[np.ndarray, "3"], directions: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return the distance of the first triangle along each ray, 0 without one or at a back face.

    Moeller and Trumbore, 1997.
    """
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    edge1, edge2, from_a = b - a, c - a, origin - a
    across = np.cross(from_a, edge1)
    result = np.zeros(len(directions))
    with np.errstate(divide="ignore", invalid="ignore"):
        for index, direction in enumerate(directions.astype(np.float64)):
            p = np.cross(direction, edge2)
            determinant = (edge1 * p).sum(axis=-1)
            u, v = (from_a * p).sum(axis=-1) / determinant, (across @ direction) / determinant
            distance = (edge2 * across).sum(axis=-1) / determinant
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
            if hit.any():
                nearest = np.flatnonzero(hit)[np.argmin(distance[hit])]
                result[index] = distance[nearest] if determinant[nearest] > 0 else 0.0
    return result


def _fill_stage(frame: Frame, grid: VolumeGrid, size: RoomSize) -> BenchStage:
    """Time the filled panorama that the blending network gets beyond the mesh."""
    seen, state = _first_panorama(frame, grid, size)

    def fill() -> Float[np.ndarray, "h w 3"]:
        return fill_beyond(*latest_detail(state, seen), seen, hdr=state.radiance)

    return BenchStage("fill beyond the mesh", Implementation(fill), note="with networks")


def _first_panorama(frame: Frame, grid: VolumeGrid, size: RoomSize) -> tuple[PartialPanorama, PanoramaState]:
    """Return what one frame shows of the probe's surroundings, and the empty panorama that accumulates it."""
    seen = FrameMesh(frame).render_panorama(np.asarray(PROBE), height=size.panorama_height)
    return seen, PanoramaState.fresh(size.panorama_height, grid.depth_max_m)


def _accumulate_stage(frame: Frame, grid: VolumeGrid, size: RoomSize) -> BenchStage:
    shown, state = _first_panorama(frame, grid, size)
    seen = replace(shown, clipped=None, guessed=None)  # as the plain twin takes it
    random, unseen_m = np.random.default_rng(0), unseen_depth_m(grid.depth_max_m)
    hdr = random.random(state.radiance.shape, dtype=np.float32)
    weight = np.where(seen.mask, random.random(seen.mask.shape, dtype=np.float32), np.float32(0))

    def apply(to: PanoramaState, accumulate_into: Callable[..., None]) -> Float[np.ndarray, "h w 3"]:
        accumulate_into(to, seen, hdr=hdr, weight=weight, unseen_m=unseen_m)
        return to.radiance

    torch = None
    if plain_torch.torch_installed():
        torch = Implementation(
            plain_torch.accumulate_by_tensors(
                state, hdr=hdr, detail=seen.radiance, detail_depth_m=seen.depth_m, weight=weight
            )
        )
    deviations = differences(
        lambda: apply(state.copy(), accumulate),
        {"reference": lambda: apply(state.copy(), accumulate_reference), "torch": torch.run if torch else None},
    )
    ours_state, reference_state = state.copy(), state.copy()
    return BenchStage(
        "accumulation",
        Implementation(lambda: apply(ours_state, accumulate)),
        Implementation(lambda: apply(reference_state, accumulate_reference)),
        torch,
        differences=deviations,
    )


def _network_like(grid: VolumeGrid, surfaces: Sglv) -> Sglv:
    """Return a volume as a network predicts it: faint opacity and a lobe in every voxel, besides the surfaces."""
    random = np.random.default_rng(0)
    alpha = random.uniform(*_FAINT_ALPHA, grid.shape).astype(np.float32)
    alpha = np.maximum(alpha, np.minimum(surfaces.alpha, np.float32(0.9)))
    lobes = np.empty((*grid.shape, LOBE_CHANNELS), np.float32)
    lobes[..., :3] = surfaces.lobes[..., :3] + random.uniform(0.1, 0.3, (*grid.shape, 3))
    lobes[..., 3:6] = random.uniform(0, 0.2, (*grid.shape, 3))
    lobes[..., 6] = random.uniform(4, 12, grid.shape)
    axis = random.normal(size=(*grid.shape, 3))
    lobes[..., 7:] = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    return replace(surfaces, alpha=alpha, lobes=lobes)
