"""`roomlight bench train`: the cost of a training step by its parts, measured over a few real steps.

Importing this module needs PyTorch: pip install 'roomlight[train]'.
"""

import resource
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import torch
from rich import box
from rich.table import Table

from roomlight_bench.reporting import describe_machine, short_number
from roomlight_bench.timing import ProgressCallback
from roomlight_model.checkpoint import Checkpoint
from roomlight_model.networks import SingleModel
from roomlight_model.training.examples import Recordings
from roomlight_model.training.gradients import BACKGROUND, PARTS, StepClock
from roomlight_model.training.loop import Run, Stage, batches_ahead
from roomlight_model.training.single_view import SingleViewOptions, SingleViewStage
from roomlight_model.training.subsets import Subset
from roomlight_model.training.video import VideoOptions, VideoStage

_WARM_UP = 3
"""Steps before measuring starts: kernels are loaded, memory is allocated."""


@dataclass(frozen=True)
class PartCost:
    """Median and least milliseconds of one part of a step.

    `beside`: the part runs in the background, on threads of its own, ahead of the step that needs its result.
    """

    name: str
    median_ms: float
    least_ms: float
    beside: bool


@dataclass(frozen=True)
class TrainCosts:
    """A run of `roomlight bench train`.

    Attributes:
        parts: The parts of a step.
        step_ms: Mean time from one step to the next.
        cpu_ms: Mean processor time of a step over all threads.
        steps: Number of steps measured.
        stage: The stage of training.
        batch: Examples per step: views, or sequences.
        frames: Largest number of frames of an example; in video stages of every example.
        window: Video stages: frames over which gradients go back in time; 0 in single-view stages.
        peak_mb: Largest resident memory of the whole process so far, in MB.
        volume_shape: Voxels (z, y, x).
        bf16: Whether the networks compute in bf16; else fp32.
        threads: Threads of PyTorch.
        machine: Processor, system and versions; see `describe_machine`.
    """

    parts: tuple[PartCost, ...]
    step_ms: float
    cpu_ms: float
    steps: int
    stage: str
    batch: int
    frames: int
    window: int
    peak_mb: float
    volume_shape: tuple[int, int, int]
    bf16: bool
    threads: int
    machine: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self)

    def table(self) -> Table:
        """Return a table with a row per part, then the whole step."""
        length = f" of {self.frames} frames, window {self.window}" if self.window else ""
        table = Table(
            title=f"A step of {self.stage}, batch {self.batch}{length}, "
            f"volume {' x '.join(map(str, self.volume_shape))}, {'bf16' if self.bf16 else 'fp32'}",
            title_justify="left",
            caption=(
                f"{self.steps} steps on {self.threads} threads, {self.machine['processor']}; data is prepared in the "
                "background on threads of its own, which its time counts; processor time hardly grows if the machine "
                "does other work"
            ),
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            show_edge=False,
        )
        table.add_column("part")
        for heading in ("median ms", "least ms", "of the step"):
            table.add_column(heading, justify="right", no_wrap=True)
        for part in self.parts:
            share = "in background" if part.beside else f"{part.median_ms / self.step_ms:.0%}"
            table.add_row(part.name, short_number(part.median_ms), short_number(part.least_ms), share)
        table.add_section()
        table.add_row("a step", short_number(self.step_ms), "", f"{3600e3 / self.step_ms:,.0f} per hour")
        table.add_row("processor time", short_number(self.cpu_ms), "", "")
        table.add_row("largest memory, MB", f"{self.peak_mb:,.0f}", "", "of the process")
        return table


def measure_training(
    options: SingleViewOptions, recordings: Recordings, *, steps: int, device: str, progress: ProgressCallback
) -> TrainCosts:
    """Train for `steps` steps, after a few unmeasured ones, in a temporary folder.

    Video stages (`VideoOptions`) start from fresh single-view weights, and all their sequences have `options.frames`
    frames.

    Raises:
        ModelError: The options or the data do not allow a run.
    """
    with tempfile.TemporaryDirectory(prefix="roomlight-bench-") as folder:
        stage = _stage(options, recordings, device=torch.device(device), cache=Path(folder) / "cache")
        run = Run(stage, Path(folder) / "run")
        run.network.train()
        wall_s = cpu_s = 0.0
        with batches_ahead(stage, 0, run.clock) as batches:
            for step in range(_WARM_UP + steps):
                if step == _WARM_UP:
                    run.clock.enabled = True
                    wall_s, cpu_s = time.perf_counter(), time.process_time()
                run.advance(next(batches))
                progress(f"step {run.step} of {steps + _WARM_UP}")
            wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    return TrainCosts(
        parts=_part_costs(run.clock),
        step_ms=wall_s * 1e3 / steps,
        cpu_ms=cpu_s * 1e3 / steps,
        steps=steps,
        stage=options.stage,
        batch=options.batch,
        frames=options.frames,
        window=options.window if isinstance(options, VideoOptions) else 0,
        peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3),
        volume_shape=options.volume_shape,
        bf16=options.bf16,
        threads=torch.get_num_threads(),
        machine=describe_machine() | {"torch": torch.__version__},
    )


def _stage(options: SingleViewOptions, recordings: Recordings, *, device: torch.device, cache: Path) -> Stage:
    """Build the stage without held-out sequences."""
    if not isinstance(options, VideoOptions):
        return SingleViewStage(options, recordings, Subset([]), device=device)
    config = options.trained_model
    start_from = Checkpoint("single", config, SingleModel(config), {"steps": 0})
    options = replace(options, augment=False)
    return VideoStage(options, recordings, Subset([]), device=device, start_from=start_from, cache=cache)


def _part_costs(clock: StepClock) -> tuple[PartCost, ...]:
    costs: list[PartCost] = []
    for name in PARTS:
        beside = name in BACKGROUND
        values = (clock.thread_ms if beside else clock.wall_ms).get(name)
        if values:  # a stage has only some of the parts
            costs.append(PartCost(name, median(values), min(values), beside))
    return tuple(costs)
