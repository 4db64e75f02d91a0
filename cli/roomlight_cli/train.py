"""A recipe on a terminal: missing datasets, the stages one after the other, the export of the weights."""

import ctypes
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import cv2
import torch
import typer
from rich.console import Console

from roomlight.dataset.folder import MANIFEST, locked
from roomlight.dataset.loader import Dataset
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.errors import DatasetError, ModelError, OptionError
from roomlight_cli.commands.export import model_folder
from roomlight_cli.console import stopped_by_signals
from roomlight_cli.generation import show_generation
from roomlight_cli.progress import Progress
from roomlight_export.exporting import ExportReport, export_checkpoint
from roomlight_export.importing import load_weights
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_model.checkpoint import load_checkpoint
from roomlight_model.training.loop import Run, TrainingProgress
from roomlight_model.training.recipe import Recipe, StageRecipe, build_stage, read_options
from roomlight_model.training.run_folder import RunFolder
from roomlight_model.training.single_view import SingleViewOptions
from roomlight_model.training.subsets import describe

LOCK: Final = "training.lock"
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""glibc's numbers of two options (malloc.h)."""


def train_recipe(
    recipe: Recipe, out: Path, *, data: Path, device: str, minutes: float | None, console: Console
) -> ExportReport | None:
    """Generate missing datasets, train the stages, export the weights; continue what is there.

    Args:
        recipe: What to train.
        out: A folder with the run of each stage, and the exported model in `onnx`: of a small network in a folder
            there that has the name of its form.
        data: A folder with the datasets by name; a dataset's `panoramas` are a folder in it.
        device: auto, cpu or cuda.
        minutes: Of training, after which it stops; None runs to the last step. Generating data does not count.
        console: Where progress is printed.

    Returns:
        The report of the export; None if training stopped before its end.

    Raises:
        OptionError: The device is not there, the recipe's options of a dataset are wrong, or it uses the best weights
            of a stage that scores none.
        DatasetError: A dataset is missing and cannot be generated.
        ModelError: The weights or a run's folder do not fit the options, or a run started from a stage that is not
            finished.
        OutputError: Another process trains in `out`, or it cannot be written.
    """
    chosen = _choose_device(device)
    _keep_freed_memory()
    cv2.setNumThreads(1)  # examples are made on the loop's own threads already
    wanted = {name: _generation(recipe, name, data) for name in recipe.data}
    unfinished = list[str]()
    for stage in recipe.stages:
        _start_path(recipe, stage, out)
        if RunFolder(out / stage.name).has_run and (stage.start_from or "").partition("/")[0] in unfinished:
            raise ModelError(
                f"{out / stage.name}: its run started from {stage.start_from}, whose training is not finished; "
                "delete the folder to train the stage again, or use another folder or the same options"
            )
        if not _is_finished(recipe, stage, out, data):
            unfinished.append(stage.name)
            for name in stage.data:
                _check_source(data / name, wanted[name])
            _check_best(recipe, stage)
    with locked(out, LOCK), stopped_by_signals(lambda: "what is finished is kept, and the same command continues"):
        for stage in recipe.stages:
            if stage.name not in unfinished:
                console.print(f"{stage.name}: finished")
                continue
            for name in dict.fromkeys(stage.data):
                _complete_dataset(data / name, wanted[name], console)
            began = time.monotonic()
            run = _train_stage(recipe, stage, out, data=data, device=chosen, minutes=minutes, console=console)
            minutes = None if minutes is None else minutes - (time.monotonic() - began) / 60
            if run.step < stage.options.steps:
                console.print(f"{stage.name}: stopped at step {run.step}; the same command continues")
                if run.stopped_by is not None:
                    raise typer.Exit(128 + run.stopped_by)
                return None
        checkpoint = out / recipe.ships
        folder = model_folder(out / "onnx", load_checkpoint(checkpoint).form)
        with Progress("exporting and verifying the graphs", console) as progress:
            return export_checkpoint(checkpoint, folder, progress=progress.say)


def _is_finished(recipe: Recipe, stage: StageRecipe, out: Path, data: Path) -> bool:
    """Return whether a stage is trained; refuse a run on other data or from other weights than are there now."""
    run, known = RunFolder(out / stage.name), dict[str, Any]()
    if not run.has_run:
        return False
    folders = [data / name for name in stage.data]
    if all((folder / MANIFEST).exists() for folder in folders):
        known["data"] = describe([Dataset(folder, "train") for folder in folders])
    start = _start_path(recipe, stage, out)
    if start is None or start.exists():
        known["start_from"] = None if start is None else load_weights(start).digest
    return run.is_finished(stage.options, **known)


def _train_stage(
    recipe: Recipe,
    stage: StageRecipe,
    out: Path,
    *,
    data: Path,
    device: torch.device,
    minutes: float | None,
    console: Console,
) -> Run:
    start = _start_path(recipe, stage, out)
    with Progress(f"{stage.name}: reading data", console) as progress:
        run = Run(
            build_stage(
                stage,
                [data / name for name in stage.data],
                start_from=None if start is None else load_weights(start),
                device=device,
                progress=progress.count,
            ),
            out / stage.name,
        )
    console.print(f"{stage.name}: {len(run.stage)} examples, step {run.step} of {stage.options.steps}")
    with Progress(stage.name, console) as progress:
        progress.count(run.step, stage.options.steps)

        def report(now: TrainingProgress) -> None:
            if now.losses:
                rate = f"{now.seconds_a_step:.2f} s a step, {now.waited_for_data:.0%} for data"
                progress.say(f"{stage.name}, loss {now.losses['loss']:.4f}, {rate}")
            progress.count(now.step, now.steps)
            if now.scores == {}:
                console.print(f"{stage.name}: nothing is held out: no scores, no best.pt")
            if now.scores:
                figures = ", ".join(f"{name} {value:.4f}" for name, value in now.scores.items())
                best = ", best so far" if now.best else ""
                console.print(f"step {now.step}: held out: {figures}{best}", soft_wrap=True)

        run.train(report=report, minutes=minutes)
    return run


def _start_path(recipe: Recipe, stage: StageRecipe, out: Path) -> Path | None:
    """Return where a stage's weights start; refuse what is not there before any work."""
    if stage.start_from is None:
        return None
    name, _, rest = stage.start_from.partition("/")
    if name in [other.name for other in recipe.stages[: recipe.stages.index(stage)]]:
        return out / stage.start_from
    path = SHIPPED / rest if name == "shipped" else recipe.path.parent / stage.start_from
    if not path.exists():
        raise OptionError(
            f"{recipe.path}: stage {stage.name}: start_from is {stage.start_from!r}, but there is no {path}; give a "
            "stage before it (NAME/model.pt), shipped/NAME, or the path of a checkpoint or model folder"
        )
    return path


def _generation(recipe: Recipe, name: str, data: Path) -> GenerateOptions | None:
    """Return the options that generate a dataset of the recipe; None if it states none."""
    values, where = recipe.data[name], f"{recipe.path}: data {name}"
    if not values:
        return None
    unknown = sorted(set(values) - {option.name for option in fields(GenerateOptions)})
    if unknown:
        raise OptionError(f"{where}: there is no option {unknown[0]}")
    options = read_options(GenerateOptions, values, where)
    if options.split != "train":
        raise OptionError(f"{where}: split is {options.split!r}; stages learn from the split train: leave it out")
    return options if options.panoramas is None else replace(options, panoramas=data / options.panoramas)


def _is_complete(folder: Path, options: GenerateOptions | None) -> bool:
    return (folder / MANIFEST).exists() and (options is None or len(Dataset(folder, "train")) >= options.sequences)


def _check_source(folder: Path, options: GenerateOptions | None) -> None:
    """Refuse a dataset that is missing and cannot be generated before any work."""
    if _is_complete(folder, options):
        return
    if options is None:
        raise DatasetError(f"{folder}: is no dataset, and the recipe does not say how to generate it")
    if options.panoramas is not None and not options.panoramas.is_dir():
        raise DatasetError(f"{options.panoramas}: is no folder; the dataset {folder.name} needs HDR panoramas there")


def _check_best(recipe: Recipe, stage: StageRecipe) -> None:
    """Refuse a recipe that uses the best weights of a stage that scores none."""
    best = f"{stage.name}/best.pt"
    used = best in (recipe.ships, *(other.start_from for other in recipe.stages))
    if used and isinstance(stage.options, SingleViewOptions) and stage.options.held_out == 0:
        raise OptionError(
            f"{recipe.path}: {best} is used, but stage {stage.name} would score no weights: held_out is 0; raise it, "
            f"or use {stage.name}/model.pt"
        )


def _complete_dataset(folder: Path, options: GenerateOptions | None, console: Console) -> None:
    """Generate a dataset, or the rest of it; a dataset with enough sequences is used as it is."""
    if options is None or _is_complete(folder, options):
        return
    console.print(f"{folder}: generating {options.sequences} sequences", soft_wrap=True)
    with Progress("generating", console) as progress:
        generate(folder, options, progress=show_generation(progress))


def _choose_device(device: str) -> torch.device:
    available = torch.cuda.is_available()
    if device == "cuda" and not available:
        raise OptionError("device is 'cuda', but PyTorch finds no GPU; use 'cpu'")
    return torch.device("cuda" if device != "cpu" and available else "cpu")


def _keep_freed_memory() -> None:
    """Have the C library (glibc) keep freed buffers: the system would clear every page of them again."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 32 << 20)  # glibc's maximum; a step's largest buffers are 7 MB
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
