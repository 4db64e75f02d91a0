"""A training stage on a terminal: progress, TensorBoard curves, pictures of held-out rooms, a clean stop."""

import ctypes
import signal
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch.utils.tensorboard import SummaryWriter

from roomlight.errors import OptionError
from roomlight_export.importing import load_weights
from roomlight_model.training.examples import Recordings
from roomlight_model.training.options import TrainOptions, is_video
from roomlight_model.training.trainer import Trainer
from roomlight_model.training.unroll import window_mb
from roomlight_model.training.validation import Validation
from roomlight_model.training.walk_validation import WalkValidation

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""glibc's numbers of two options (malloc.h)."""


def train(
    options: TrainOptions,
    training: Recordings,
    out: Path,
    *,
    held_out: Recordings,
    device: str,
    start_from: Path | None,
    minutes: float | None,
    every_steps: int,
    console: Console,
    grow: Callable[[], int] = lambda: 0,
    data: Callable[[], list[dict[str, Any]]] = list,
) -> dict[str, Any]:
    """Run a stage until its last step, for `minutes`, or until Ctrl-C; return the model card.

    Args:
        options: The stage and its hyperparameters.
        training: Sequences to train on.
        out: The run's folder; a run that is there already is continued.
        held_out: Sequences that are scored every `every_steps` steps and not trained on.
        device: auto, cpu or cuda.
        start_from: A checkpoint or a model folder whose weights the stage starts from.
        minutes: When to stop; None runs to the last step.
        every_steps: Steps between two scores of the held-out sequences.
        console: Where progress is printed.
        grow: Called before each scoring; adds sequences that were finished meanwhile, returns how many.
        data: Called for the model card's list of datasets.

    Raises:
        OptionError: The device is not there.
        ModelError: The weights or the run's folder do not fit the options.
    """
    chosen = choose_device(device)
    _keep_freed_memory()
    cv2.setNumThreads(1)  # examples are made on the trainer's own threads already
    trainer = Trainer(
        options,
        training,
        out,
        device=torch.device(chosen),
        start_from=None if start_from is None else load_weights(start_from),
        data=data,
    )
    video = is_video(options.stage)
    checked = WalkValidation if video else Validation
    validation = checked(held_out, range(len(held_out)), trainer.options)
    curves = SummaryWriter(str(out / "tensorboard"), purge_step=trainer.step)
    console.print(f"{len(training)} sequences to train on, {len(held_out)} held out", highlight=False)
    if video:
        window = min(options.window, options.frames - 1)
        console.print(f"gradients go back {window} frames: {window_mb(trainer.options):,.0f} MB of states a step")
    if trainer.step:
        console.print(f"continuing from step {trainer.step} of {options.steps}", highlight=False)

    def validate(now: Trainer) -> None:
        added = grow()
        if added:
            console.print(f"step {now.step}: {added} more sequences, {len(training)} in all", soft_wrap=True)
        if not len(held_out):
            return
        model = now.averaged()
        scores = validation.scores(model, device=now.device)
        for name, value in scores.items():
            curves.add_scalar(f"held out/{name}", value, now.step)
        validation.draw(model, out / "pictures" / f"{now.step:07d}.png", device=now.device)
        best = now.keep_scored(validation.loss(scores), scores)
        listed = ", ".join(
            f"{name.removeprefix('log_l2_')} {value:.4f} ({scores[name.replace('log_l2', 'rendering')]:.4f})"
            for name, value in scores.items()
            if name.startswith("log_l2")
        )
        console.print(
            f"step {now.step}: held-out log-L2 (rendering loss): {listed}" + (", best so far" if best else ""),
            soft_wrap=True,
        )

    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(), TextColumn("{task.fields[detail]}"), console=console,
    )  # fmt: skip
    with bar, _stopping(minutes) as stop:
        task = bar.add_task(options.stage, total=options.steps, completed=trainer.step, detail="")

        def report(now: Any) -> None:
            for name in (
                "loss",
                "log_l2",
                "rendering",
                "smoothness",
                "learning_rate",
                "seconds_a_step",
                "waited_for_data",
            ):
                curves.add_scalar(f"train/{name}", getattr(now, name), now.step)
            detail = f"loss {now.loss:.4f}  {now.seconds_a_step:.2f} s a step, {now.waited_for_data:.0%} for data"
            bar.update(task, completed=now.step, detail=detail)

        pause_s = 600.0 if video else 240.0  # a step of a video stage takes seconds
        trainer.train(report=report, every=validate, every_steps=every_steps, checkpoint_s=pause_s, stop=stop)
    validate(trainer)
    curves.close()
    return trainer.card()


def _keep_freed_memory() -> None:
    """Have the C library (glibc) keep freed buffers for the next step.

    Otherwise it returns them to the system, which clears every page again.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 32 << 20)  # glibc's maximum; a step's largest buffers are 7 MB
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)


def choose_device(device: str) -> str:
    """Resolve `auto` to cuda or cpu. Raises OptionError for cuda on a machine without a GPU."""
    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cuda" and not torch.cuda.is_available():
        raise OptionError("device is 'cuda', but PyTorch finds no GPU; use 'cpu'")
    return device


@contextmanager
def _stopping(minutes: float | None) -> Generator[Any]:
    """Yield a function that returns whether to stop: after `minutes`, or at the first Ctrl-C or SIGTERM."""
    signals: list[int] = []
    began = time.monotonic()

    def stop() -> bool:
        return bool(signals) or (minutes is not None and time.monotonic() - began > 60 * minutes)

    def note(number: int, _: Any) -> None:
        signals.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
