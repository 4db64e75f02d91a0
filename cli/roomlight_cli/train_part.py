"""The stages `clipping`, `completion` and `objects` on a terminal: read the examples, train, resume, stop cleanly."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from roomlight.dataset.loader import Dataset
from roomlight.engine.networks.graphs import PartForm
from roomlight.errors import DatasetError
from roomlight_model.training.clipping_examples import ClippingFrames
from roomlight_model.training.clipping_stage import ClippingStage
from roomlight_model.training.completion_examples import CompletionExamples
from roomlight_model.training.completion_stage import CompletionStage
from roomlight_model.training.objects_stage import ObjectsStage
from roomlight_model.training.part_trainer import PartOptions, PartProgress, PartStage, PartTrainer


def train_part(
    form: PartForm,
    folders: Sequence[Path],
    out: Path,
    *,
    options: PartOptions,
    start_from: Path | None,
    minutes: float | None,
    every_steps: int,
    console: Console,
) -> dict[str, Any]:
    """Run a stage to its last step, for `minutes`, or until Ctrl-C; return the card.

    The test splits of the folders are the held-out examples; without any, a twelfth of the train split is.

    Raises:
        DatasetError: A folder is not a dataset, or holds nothing to learn from.
        ModelError: The folder's run has other options, or the loss is not finite.
        OutputError: `out` cannot be written.
    """
    training = [Dataset(folder, "train") for folder in folders]
    with _progress(console) as progress:
        task = progress.add_task("reading examples", total=None)
        stage = _stage(form, training, options, lambda done, total: progress.update(task, completed=done, total=total))
    data = [
        {"seed": one.manifest.settings.seed, "frames": one.manifest.settings.frames, "sequences": len(one)}
        for one in training
    ]
    trainer = PartTrainer(stage, options, out, data=data, start_from=start_from)
    ends = None if minutes is None else time.monotonic() + 60 * minutes
    with _progress(console) as progress:
        task = progress.add_task(form, total=options.steps, completed=trainer.step)

        def report(now: PartProgress) -> None:
            progress.update(task, completed=now.step, description=f"{form}, loss {now.loss:.4f}")
            if now.scores is not None:
                figures = ", ".join(f"{name} {value:.4f}" for name, value in now.scores.items())
                console.print(f"step {now.step}: held out: {figures}", highlight=False)

        try:
            trainer.train(
                report=report,
                every_steps=every_steps,
                stop=lambda: ends is not None and time.monotonic() > ends,
            )
        except KeyboardInterrupt:
            trainer.save()
            trainer.keep_scored()
            console.print(f"stopped at step {trainer.step}; the same command continues")
    return trainer.card()


def _stage(
    form: PartForm, training: Sequence[Dataset], options: PartOptions, progress: Callable[[int, int], object]
) -> PartStage:
    test = [dataset for dataset in (_test_split(one) for one in training) if dataset is not None]
    if form == "clipping":
        frames = ClippingFrames.read(training, seed=options.seed, progress=progress)
        if test:
            return ClippingStage(frames, ClippingFrames.read(test, seed=options.seed))
        return ClippingStage(*frames.split(options.seed))
    build = CompletionStage if form == "completion" else ObjectsStage
    models = ("classical",) if form == "completion" else ("classical", "single")
    examples = CompletionExamples.read(training, seed=options.seed, models=models, progress=progress)
    if test:
        return build(examples, CompletionExamples.read(test, seed=options.seed, models=models))
    return build(*examples.split(options.seed))


def _test_split(dataset: Dataset) -> Dataset | None:
    try:
        found = Dataset(dataset.folder, "test")
    except DatasetError:
        return None
    return found if len(found) else None


def _progress(console: Console) -> Progress:
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    return Progress(*columns, TimeRemainingColumn(), console=console, transient=True)
