"""`roomlight bench train`: what a training step costs, by part, in a run of a few real steps."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from roomlight_bench.stages_report import machine_here, short

if TYPE_CHECKING:
    from roomlight_model.training.examples import Recordings
    from roomlight_model.training.options import TrainOptions

_WARM_UP = 3
"""Steps before the clock: kernels are loaded, memory is allocated."""


@dataclass(frozen=True)
class PartCost:
    """One part of a step: median and least milliseconds; `beside` is what runs on threads of its own, ahead of need."""

    name: str
    median_ms: float
    least_ms: float
    beside: bool


@dataclass(frozen=True)
class TrainCosts:
    """A run of `roomlight bench train`."""

    parts: tuple[PartCost, ...]
    step_ms: float
    """From one step to the next, mean."""
    cpu_ms: float
    """Processor time of a step over all threads, mean."""
    steps: int
    stage: str
    batch: int
    volume_shape: tuple[int, int, int]
    bf16: bool
    threads: int
    machine: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self)

    def table(self) -> Table:
        """The parts, and what they come to."""
        table = Table(
            title=f"A step of {self.stage}, batch {self.batch}, volume {' x '.join(map(str, self.volume_shape))}, "
            f"{'bf16' if self.bf16 else 'fp32'}",
            title_justify="left",
            caption=(
                f"{self.steps} steps on {self.threads} threads, {self.machine['processor']}; data is made ahead on "
                "threads of its own, and its time is theirs alone; processor time hardly grows with other work"
            ),
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            show_edge=False,
        )
        table.add_column("part")
        for heading in ("median ms", "least ms", "of the step"):
            table.add_column(heading, justify="right", no_wrap=True)
        for part in self.parts:
            share = "beside it" if part.beside else f"{part.median_ms / self.step_ms:.0%}"
            table.add_row(part.name, short(part.median_ms), short(part.least_ms), share)
        table.add_section()
        table.add_row("a step", short(self.step_ms), "", f"{3600e3 / self.step_ms:,.0f} an hour")
        table.add_row("processor time", short(self.cpu_ms), "", "")
        return table


def measure(
    options: "TrainOptions", recordings: "Recordings", *, steps: int, device: str, progress: Callable[[str], object]
) -> TrainCosts:
    """Train in a folder that is thrown away. ModelError where the options or the data make no run."""
    import torch

    from roomlight_model.training.clock import PARTS, StepClock
    from roomlight_model.training.trainer import Trainer

    with tempfile.TemporaryDirectory(prefix="roomlight-bench-") as folder:
        trainer = Trainer(options, recordings, Path(folder) / "run", device=torch.device(device))
        began: list[tuple[float, float]] = []
        ended: list[tuple[float, float]] = []

        def look(now: Trainer) -> None:
            progress(f"step {now.step} of {steps + _WARM_UP}")
            at = time.perf_counter(), time.process_time()
            if now.step == _WARM_UP:
                now.clock = StepClock()
                began.append(at)
            if now.step == steps + _WARM_UP:
                ended.append(at)

        trainer.train(report=lambda _: None, every=look, every_steps=1, stop=lambda: trainer.step >= steps + _WARM_UP)
        clock = trainer.clock
    assert clock is not None
    parts: list[PartCost] = []
    for name in PARTS:
        beside = name == "data"
        values = (clock.thread_ms if beside else clock.wall_ms).get(name, [0.0])
        parts.append(PartCost(name, median(values), min(values), beside))
    (wall, cpu), (wall_end, cpu_end) = began[0], ended[0]
    return TrainCosts(
        parts=tuple(parts),
        step_ms=(wall_end - wall) * 1e3 / steps,
        cpu_ms=(cpu_end - cpu) * 1e3 / steps,
        steps=steps,
        stage=options.stage,
        batch=options.batch,
        volume_shape=options.volume_shape,
        bf16=options.bf16,
        threads=torch.get_num_threads(),
        machine=machine_here() | {"torch": torch.__version__},
    )
