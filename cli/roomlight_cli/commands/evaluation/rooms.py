"""`roomlight eval dataset` and `walks`: light scored in generated rooms that no network was trained on."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

from annotated_types import Ge, Interval

from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Split
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import SessionOptions, warm_up
from roomlight.errors import OptionError
from roomlight.files import write_atomic, write_json
from roomlight_cli.console import err, print_tables, say
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import ScoredNetworks, ScoresJson
from roomlight_evaluation.baselines import MeanColour, WarpAndFill
from roomlight_evaluation.captures.tables import capture_tables
from roomlight_evaluation.datasets.evaluation import DEPTHS, evaluate_dataset
from roomlight_evaluation.datasets.methods import BLENDED, UNBLENDED, BaselineMethod, EngineMethod, Method
from roomlight_evaluation.datasets.picture import write_picture
from roomlight_evaluation.datasets.tables import dataset_tables
from roomlight_evaluation.datasets.walks import WalkModels, evaluate_walks
from roomlight_evaluation.tables import markdown

_SCORED_ANYWAY: Final = ("mean colour", "warp and fill", "classical", BLENDED, UNBLENDED)


@dataclass(frozen=True)
class DatasetScoreOptions:
    """What is scored, and what is written.

    Attributes:
        split: Which rooms; no network is trained on those of test.
        also: NAME=DIR: score another model folder too. Repeatable. Folders named rgb-alpha and no-rendering-loss are
            compared with the full model.
        depth: Depth as rendered, as a phone measures it, or both.
        limit: Score this many sequences, evenly spread.
        markdown: Also write the tables as Markdown.
        picture: Also write a PNG of some rooms: input, truth, every method.
        pictured: Rooms in --picture.

    Raises:
        OptionError: A model folder has no name, or that of a method that is scored in any case.
    """

    split: Split = "test"
    also: tuple[str, ...] = ()
    depth: Literal["exact", "arkit", "both"] = "both"
    limit: Annotated[int, Ge(1)] | None = None
    markdown: Path | None = None
    picture: Path | None = None
    pictured: Annotated[int, Interval(ge=1, le=50)] = 5

    def __post_init__(self) -> None:
        for text in self.also:
            name, equals, folder = text.partition("=")
            if not equals or not name or not folder:
                raise OptionError(f"also takes NAME=DIR, e.g. rgb-alpha=weights/rgb-alpha; got {text!r}")
            if name in _SCORED_ANYWAY:
                raise OptionError(
                    f"also {text}: choose another name; {', '.join(_SCORED_ANYWAY)} are scored in any case"
                )

    @property
    def folders(self) -> list[tuple[str, Path]]:
        """Name and model folder of the other models."""
        return [(name, Path(folder)) for name, _, folder in (text.partition("=") for text in self.also)]


def dataset(data: Path, options: DatasetScoreOptions, light: ScoredNetworks, *, json: ScoresJson = None) -> None:
    """Score light from single images on a dataset of rooms that no network was trained on.

    The tables show log-L2 and rendering loss, confidence intervals over rooms, and ratios to the targets.

    Args:
        data: A dataset folder (roomlight dataset generate --split test).
        options: What to score.
        light: How to estimate the light.
    """
    methods = _methods(replace(light, model="single" if light.weights is None else "auto"), options.folders)
    with Progress("scoring") as progress:
        scores, rows = evaluate_dataset(
            Dataset(data, options.split),
            methods,
            depths=DEPTHS if options.depth == "both" else (options.depth,),
            limit=options.limit,
            picture_rows=options.pictured if options.picture else 0,
            progress=progress.count,
        )
    tables = dataset_tables(scores)
    print_tables(*tables)
    for reason in scores.skipped[:5]:
        err.print(f"skipped {reason}", soft_wrap=True, markup=False)
    if json:
        write_json(json, scores.to_json())
    if options.markdown:
        write_atomic(options.markdown, markdown(tables).encode())
    if options.picture:
        write_picture(options.picture, rows)
        say(f"Picture: {options.picture}")


def _methods(session: SessionOptions, others: list[tuple[str, Path]]) -> list[Method]:
    warm_up()
    classical = EngineMethod("classical", replace(session, model="classical", weights=None), None)
    methods: list[Method] = [BaselineMethod(MeanColour), BaselineMethod(WarpAndFill), classical]
    graphs = choose_graphs(session)
    if graphs is not None:
        single = replace(session, model="single"), replace(graphs, form="single")
        methods.append(EngineMethod(BLENDED, *single, unblended_name=UNBLENDED))
    for name, folder in others:
        options = replace(session, model="single", weights=folder)
        methods.append(EngineMethod(name, options, choose_graphs(options)))
    return methods


def walks(
    data: tuple[Path, ...],
    light: ScoredNetworks,
    *,
    split: Split = "test",
    limit: Annotated[int, Ge(1)] | None = None,
    json: ScoresJson = None,
) -> None:
    """Score the recurrent networks on walks through rooms that no network was trained on.

    The table compares them with each frame alone, a simple average, the single-view form, the classical model and
    baselines, with late probes and with depth as a phone measures it.

    Args:
        data: Dataset folders (roomlight dataset generate --split test).
        light: How to estimate the light.
        split: Which rooms; no network is trained on those of test.
        limit: Score this many walks of each, evenly spread.
    """
    models = WalkModels.load(replace(light, model="video"))
    with Progress("compiling kernels (first run only)") as progress:
        warm_up()
        progress.say("scoring")
        folders = [Dataset(folder, split) for folder in data]
        scores = evaluate_walks(folders, models, limit=limit, progress=progress.count)
    print_tables(*capture_tables(scores))
    if json:
        scores.write(json)
        say(f"Scores: {json}")
