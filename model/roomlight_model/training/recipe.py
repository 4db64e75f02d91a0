"""Recipes: a TOML file that states the data and the stages from which weights come.

    ships = "joint/best.pt"        # the weights that are exported at the end

    [data.rooms]                   # options of `roomlight dataset generate`: `rooms` is generated if it is missing
    sequences = 2000
    frames = 1

    [[stages]]
    name = "sglv"                  # the folder of its run
    stage = "single-sglv"
    data = ["rooms"]               # a dataset listed several times counts as often
    steps = 17_500                 # and any other option of the stage's dataclass

    [[stages]]
    name = "joint"
    stage = "single-joint"
    data = ["rooms"]
    start_from = "sglv/model.pt"   # a file of a stage before, `shipped/NAME`, or a path beside the recipe

`recipes/` holds one for each network that RoomLight ships. Options are checked when the file is read.
"""

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

import torch
from pydantic import ConfigDict, TypeAdapter, ValidationError

from roomlight.dataset.loader import Dataset
from roomlight.errors import DatasetError, OptionError, RoomLightError
from roomlight.rules import rules_of
from roomlight_model.checkpoint import Checkpoint
from roomlight_model.depth.stage import DepthFrames, DepthOptions, DepthStage
from roomlight_model.training.clipping import ClippingFrames, ClippingOptions, ClippingStage
from roomlight_model.training.loop import Stage
from roomlight_model.training.objects import ObjectsOptions, ObjectsStage, ProbePanels
from roomlight_model.training.run_folder import RunOptions
from roomlight_model.training.single_view import SingleViewOptions, SingleViewStage
from roomlight_model.training.subsets import ProgressCallback, describe, test_split, train_val_split
from roomlight_model.training.video import VideoOptions, VideoStage

RECIPES: Final = Path(__file__).parent / "recipes"
"""The recipes of the shipped networks."""
_OPTIONS: Final[Mapping[str, type[RunOptions]]] = {
    stage: options
    for options in (SingleViewOptions, VideoOptions, ClippingOptions, ObjectsOptions, DepthOptions)
    for stage in rules_of(options)["stage"].choices
}
STAGES: Final = tuple(_OPTIONS)
_STAGE_KEYS: Final = ("name", "data", "start_from")


@dataclass(frozen=True)
class StageRecipe:
    """One stage of a recipe.

    Attributes:
        name: The folder of its run.
        options: Its options, of the stage's own class.
        data: Names of its datasets.
        start_from: Where its weights start: "NAME/model.pt" or "NAME/best.pt" of a stage before, "shipped/NAME", or a
            path of a checkpoint or a model folder; None starts with fresh weights.
    """

    name: str
    options: RunOptions
    data: tuple[str, ...]
    start_from: str | None = None


@dataclass(frozen=True)
class Recipe:
    """A recipe.

    Attributes:
        ships: The weights to export, a file of a stage's run: "NAME/best.pt" or "NAME/model.pt".
        data: For each dataset the options that generate it; empty if only a folder of this name is used.

    Examples:
        recipe = read_recipe("objects")
        recipe.stages[0].options.steps  # 6000
        quick = recipe.changed({"steps": 10})
    """

    path: Path
    ships: str
    data: Mapping[str, Mapping[str, Any]]
    stages: tuple[StageRecipe, ...]

    def changed(self, values: Mapping[str, Any]) -> "Recipe":
        """Return the recipe with other options in every stage that has them.

        Raises:
            OptionError: No stage has an option of this name, or a value is out of range or of the wrong type.
        """
        for name in values:
            if not any(name in _names(stage.options) for stage in self.stages):
                known = sorted({name for stage in self.stages for name in _names(stage.options)})
                raise OptionError(f"{self.path}: no stage has an option {name}; the options are {', '.join(known)}")
        stages = [
            replace(
                stage,
                options=_options(
                    {**stage.options.to_dict(), **{k: v for k, v in values.items() if k in _names(stage.options)}},
                    f"{self.path}: stage {stage.name}",
                ),
            )
            for stage in self.stages
        ]
        return replace(self, stages=tuple(stages))


@dataclass(frozen=True)
class _File:
    """The layout of a recipe's file."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    ships: str
    stages: list[dict[str, Any]]
    data: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])


def read_recipe(name_or_path: str) -> Recipe:
    """Read a shipped recipe by name (`single`, `video`, `clipping`, `objects`, `depth`), or a recipe's file.

    Raises:
        OptionError: The file is missing, is not TOML, or states an unknown or invalid option; the message names it.
    """
    path = Path(name_or_path) if name_or_path.endswith(".toml") else RECIPES / f"{name_or_path}.toml"
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        known = ", ".join(sorted(recipe.stem for recipe in RECIPES.glob("*.toml")))
        raise OptionError(
            f"{path}: cannot be read ({error.strerror or error}); give a recipe's file (.toml), or one of {known}"
        ) from error
    except ValueError as error:
        raise OptionError(f"{path}: is not TOML ({error})") from error
    file = read_options(_File, table, str(path))
    stages: list[StageRecipe] = []
    for number, values in enumerate(file.stages, 1):
        stages.append(_stage(values, f"{path}: stage {values.get('name', number)}", list(file.data), stages))
    weights = [f"{stage.name}/{name}" for stage in stages for name in ("best.pt", "model.pt")]
    if file.ships not in weights:
        raise OptionError(f"{path}: ships is {file.ships!r}; it must be one of {', '.join(weights)}")
    return Recipe(path, file.ships, file.data, tuple(stages))


def read_options(kind: type[Any], values: Mapping[str, Any], where: str) -> Any:
    """Read plain values into a dataclass.

    Args:
        values: Its fields, as in TOML.
        where: The file and the table, for messages.

    Raises:
        OptionError: A field is missing, of the wrong type or out of range; the message names it and its value.
    """
    try:
        return TypeAdapter(kind).validate_json(json.dumps(dict(values), default=str), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        fault = first.get("ctx", {}).get("error")
        key = ".".join(str(part) for part in first["loc"])
        raise OptionError(
            f"{where}: {fault}" if fault else f"{where}: {key} is {first['input']!r}: {first['msg']}"
        ) from error
    except RoomLightError as error:  # of the dataclass itself
        raise OptionError(f"{where}: {error}") from error


def build_stage(
    recipe: StageRecipe,
    folders: Sequence[Path],
    *,
    start_from: Checkpoint | None,
    device: torch.device,
    progress: ProgressCallback | None = None,
) -> Stage:
    """Open the data of a stage and build it.

    Args:
        folders: The folders of `recipe.data`, in order.
        start_from: The weights of `recipe.start_from`.
        device: Where the networks run; those of clipped radiance and of the light of objects run on the CPU.
        progress: Receives (done, total) while examples are read.

    Raises:
        DatasetError: A folder is not a dataset, or holds nothing to learn from.
        ModelError: The weights to start from do not fit the stage.
    """
    opened = {folder: Dataset(folder, "train") for folder in folders}
    datasets, options = [opened[folder] for folder in folders], recipe.options
    lights = isinstance(options, SingleViewOptions | ObjectsOptions)
    for folder, dataset in opened.items():
        if not len(dataset):
            raise DatasetError(f"{folder}: has no sequence of the split train, which stages learn from; generate some")
        if isinstance(options, VideoOptions) and dataset.manifest.settings.frames < 2:
            raise DatasetError(f"{folder}: its walks have 1 frame; stage {options.stage} needs 2 or more")
        if lights and not len(dataset.read(0, frames=[0]).probe_positions):
            raise DatasetError(
                f"{folder}: has no probes, whose light stage {options.stage} learns; generate it without any_view"
            )
    data = describe(datasets)
    if isinstance(options, SingleViewOptions):
        training, held_out = train_val_split(datasets, options.held_out)
        if options.surround_max:
            training = training.without_bright_surroundings(options.surround_max, progress)
        if isinstance(options, VideoOptions):
            return VideoStage(options, training, held_out, device=device, start_from=start_from, data=data)
        return SingleViewStage(options, training, held_out, device=device, start_from=start_from, data=data)
    test = test_split(datasets)
    training, held_out = (datasets, test) if test else ([part] for part in train_val_split(datasets))
    stage, read = _small_stage(options)
    return stage(
        options,
        read(training, progress=progress),
        read(held_out),
        start_from=start_from,
        data=data,
        device=device if isinstance(options, DepthOptions) else torch.device("cpu"),
    )


def _small_stage(options: RunOptions) -> tuple[Any, Any]:
    """Return the stage of a small network, and the function that reads its examples."""
    if isinstance(options, DepthOptions):
        return DepthStage, DepthFrames.read
    if isinstance(options, ClippingOptions):
        return ClippingStage, partial(ClippingFrames.read, seed=options.seed)
    return ObjectsStage, partial(ProbePanels.read, seed=options.seed)


def _stage(
    values: Mapping[str, Any], where: str, datasets: Sequence[str], before: Sequence[StageRecipe]
) -> StageRecipe:
    """Check one table of `stages`."""
    name, data, start_from = values.get("name"), values.get("data"), values.get("start_from")
    if not isinstance(name, str) or not name or Path(name).name != name:
        raise OptionError(f"{where}: name is {name!r}; it must be the name of a folder")
    if name in [stage.name for stage in before]:
        raise OptionError(f"{where}: two stages have this name")
    if not isinstance(data, list) or not data or not all(isinstance(entry, str) for entry in data):
        raise OptionError(f"{where}: data is {data!r}; it must be a list of names of datasets")
    unknown = sorted(set(data) - set(datasets))
    if unknown:
        raise OptionError(f"{where}: no [data.{unknown[0]}] in the file; its datasets are {', '.join(datasets)}")
    if start_from is not None and not isinstance(start_from, str):
        raise OptionError(f"{where}: start_from is {start_from!r}; it must be a text")
    options = _options({key: value for key, value in values.items() if key not in _STAGE_KEYS}, where)
    return StageRecipe(name, options, tuple(data), start_from)


def _options(values: Mapping[str, Any], where: str) -> RunOptions:
    options = _OPTIONS.get(str(values.get("stage")))
    if options is None:
        raise OptionError(f"{where}: stage is {values.get('stage')!r}; it must be one of {', '.join(STAGES)}")
    return read_options(options, values, where)


def _names(options: RunOptions) -> list[str]:
    return [entry.name for entry in fields(options) if entry.name != "stage"]
