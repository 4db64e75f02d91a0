"""`roomlight train`: a stage of training with its progress, curves and pictures."""

import signal
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from roomlight.errors import ModelError

if TYPE_CHECKING:
    from roomlight_model.dataset.recording import Recording
    from roomlight_model.training.examples import Recordings
    from roomlight_model.training.options import TrainOptions
    from roomlight_model.training.trainer import Trainer

_HELD_OUT: Final = 24
"""Sequences kept from training for the run's own curve: the last ones, six rooms."""


@dataclass(frozen=True)
class Part:
    """Some sequences of a dataset, numbered from 0."""

    recordings: "Recordings"
    numbers: Sequence[int]

    def __len__(self) -> int:
        """How many."""
        return len(self.numbers)

    def read(self, index: int, *, frames: list[int]) -> "Recording":
        """One of them, with the frames asked for."""
        return self.recordings.read(self.numbers[index], frames=frames)


def split_off(recordings: "Recordings", held_out: int = _HELD_OUT) -> tuple[Part, Part]:
    """(to train on, held out): whole rooms at the end, at most a quarter of everything."""
    count = len(recordings)
    kept = min(held_out, count // 4)
    return Part(recordings, range(count - kept)), Part(recordings, range(count - kept, count))


def train(
    options: "TrainOptions",
    recordings: "Recordings",
    out: Path,
    *,
    device: str,
    start_from: Path | None,
    minutes: float | None,
    every_steps: int,
    console: Console,
) -> dict[str, Any]:
    """Run a stage until its last step, for so many minutes, or until Ctrl-C; returns the card."""
    import torch
    from torch.utils.tensorboard import SummaryWriter

    from roomlight_model.checkpoint import load_checkpoint
    from roomlight_model.training.trainer import Trainer
    from roomlight_model.training.validation import Validation

    chosen = device if device != "auto" else ("cuda" if torch.cuda.is_available() else "cpu")
    if chosen == "cuda" and not torch.cuda.is_available():
        raise ModelError("no CUDA device is to be found; use --device cpu")
    training, held_out = split_off(recordings)
    trainer = Trainer(
        options,
        training,
        out,
        device=torch.device(chosen),
        start_from=None if start_from is None else load_checkpoint(start_from),
    )
    validation = Validation(held_out, range(len(held_out)), trainer.options)
    curves = SummaryWriter(str(out / "tensorboard"), purge_step=trainer.step)
    if trainer.step:
        console.print(f"going on from step {trainer.step} of {options.steps}", highlight=False)

    def look(now: "Trainer") -> None:
        if not len(held_out):
            return
        model = now.averaged()
        scores = validation.scores(model, device=now.device)
        for name, value in scores.items():
            curves.add_scalar(f"held out/{name}", value, now.step)
        validation.draw(model, out / "pictures" / f"{now.step:07d}.png", device=now.device)
        told = ", ".join(f"{name.removeprefix('log_l2_')} {value:.4f}" for name, value in scores.items())
        console.print(f"step {now.step}: held-out log-L2: {told}", highlight=False)

    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(), TextColumn("{task.fields[detail]}"), console=console,
    )  # fmt: skip
    with bar, _stopping(minutes) as stop:
        task = bar.add_task(options.stage, total=options.steps, completed=trainer.step, detail="")

        def report(now: Any) -> None:
            for name in ("loss", "log_l2", "rendering", "learning_rate", "seconds_a_step", "waited_for_data"):
                curves.add_scalar(f"train/{name}", getattr(now, name), now.step)
            detail = f"loss {now.loss:.4f}  {now.seconds_a_step:.2f} s a step, {now.waited_for_data:.0%} for data"
            bar.update(task, completed=now.step, detail=detail)

        trainer.train(report=report, every=look, every_steps=every_steps, stop=stop)
    look(trainer)
    curves.close()
    return trainer.card()


@contextmanager
def _stopping(minutes: float | None) -> Generator[Any]:
    """A function that says when to stop: after so many minutes, or at the first Ctrl-C or SIGTERM."""
    asked: list[int] = []
    began = time.monotonic()

    def stop() -> bool:
        return bool(asked) or (minutes is not None and time.monotonic() - began > 60 * minutes)

    before = {
        number: signal.signal(number, lambda got, _: asked.append(got)) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
