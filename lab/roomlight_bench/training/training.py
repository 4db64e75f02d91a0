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
from roomlight_model.training.options import TrainOptions, is_video
from roomlight_model.training.step_clock import BACKGROUND, PARTS, VIDEO_PARTS, StepClock
from roomlight_model.training.trainer import Trainer

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
        window: Video stages: frames over which gradients go back in time.
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
        length = f" of {self.frames} frames, window {self.window}" if is_video(self.stage) else ""
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
    options: TrainOptions, recordings: Recordings, *, steps: int, device: str, progress: ProgressCallback
) -> TrainCosts:
    """Train for `steps` steps, after a few unmeasured ones, in a temporary folder.

    Video stages start from fresh single-view weights, and all their sequences have `options.frames` frames.

    Raises:
        ModelError: The options or the data do not allow a run.
    """
    start_from = None
    if is_video(options.stage):
        options = replace(options, augment=False)
        start_from = Checkpoint("single", options.model, SingleModel(options.model), {"steps": 0})
    with tempfile.TemporaryDirectory(prefix="roomlight-bench-") as folder:
        trainer = Trainer(options, recordings, Path(folder) / "run", device=torch.device(device), start_from=start_from)
        wall_s: list[float] = []  # at the first and at the last measured step
        cpu_s: list[float] = []

        def after_step(trainer: Trainer) -> None:
            progress(f"step {trainer.step} of {steps + _WARM_UP}")
            if trainer.step == _WARM_UP:
                trainer.clock = StepClock()
            if trainer.step in (_WARM_UP, steps + _WARM_UP):
                wall_s.append(time.perf_counter())
                cpu_s.append(time.process_time())

        trainer.train(
            report=lambda _: None, every=after_step, every_steps=1, stop=lambda: trainer.step >= steps + _WARM_UP
        )
        clock = trainer.clock
    assert clock is not None
    parts: list[PartCost] = []
    for name in VIDEO_PARTS if is_video(options.stage) else PARTS:
        beside = name in BACKGROUND
        values = (clock.thread_ms if beside else clock.wall_ms).get(name)
        if values is None:  # the first stage has no panoramas
            continue
        parts.append(PartCost(name, median(values), min(values), beside))
    return TrainCosts(
        parts=tuple(parts),
        step_ms=(wall_s[1] - wall_s[0]) * 1e3 / steps,
        cpu_ms=(cpu_s[1] - cpu_s[0]) * 1e3 / steps,
        steps=steps,
        stage=options.stage,
        batch=options.batch,
        frames=options.frames,
        window=options.window,
        peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3),
        volume_shape=options.volume_shape,
        bf16=options.bf16,
        threads=torch.get_num_threads(),
        machine=describe_machine() | {"torch": torch.__version__},
    )
