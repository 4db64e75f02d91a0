"""`roomlight eval walks` and `benchmark`: light scored in generated rooms that no network was trained on."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Ge

from roomlight.dataset.loader import Dataset, DepthKind
from roomlight.dataset.recording import Split
from roomlight.errors import OptionError
from roomlight_cli.console import say, show_scores
from roomlight_cli.generation import show_generation
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import (
    ScoredLight,
    ScoredNetworks,
    ScoresJson,
    note_unused_objects,
    scoring_progress,
)
from roomlight_evaluation.benchmark import benchmark_options, evaluate_benchmark, rooms_digest
from roomlight_evaluation.captures.tables import capture_tables
from roomlight_evaluation.drift import drift_models
from roomlight_evaluation.walks import evaluate_walks, image_models, recurrent_models
from roomlight_generator.generate import generate


def walks(
    data: tuple[Path, ...],
    light: ScoredNetworks,
    *,
    images: bool = False,
    drift: bool = False,
    split: Split = "test",
    limit: Annotated[int, Ge(1)] | None = None,
    json: ScoresJson = None,
) -> None:
    """Score the networks on walks through rooms that no network was trained on.

    The table compares the recurrent networks with each frame alone, a simple average, the single-view form, the
    classical model and baselines, with late probes and with depth as a phone measures it.

    Args:
        data: Dataset folders (roomlight dataset generate --split test).
        light: How to estimate the light.
        images: Score the single-view networks on the first frame of each walk instead.
        drift: Score the default model with exposure and white balance that drift, and without, instead.
        split: Which rooms; no network is trained on those of test.
        limit: Score this many walks of each, evenly spread.
    """
    if images and drift:
        raise OptionError("drift needs whole walks: leave out `images`")
    compared = drift_models if drift else image_models if images else recurrent_models
    note_unused_objects(light)
    models = compared(light)
    with scoring_progress() as progress:
        folders = [Dataset(folder, split) for folder in data]
        scores = evaluate_walks(folders, models, limit=limit, progress=progress.count)
    show_scores(scores, json, *capture_tables(scores))


@dataclass(frozen=True)
class BenchmarkOptions:
    """Which rooms.

    Attributes:
        rooms: How many.
        seed: The same seed gives the same rooms, with the same furniture installed.
        depth: Depth as it is (exact), or as a phone measures it (arkit).
        workers: Processes that generate; default: one per core.
    """

    rooms: Annotated[int, Ge(1)] = 50
    seed: Annotated[int, Ge(0)] = 0
    depth: DepthKind = "exact"
    workers: Annotated[int, Ge(1)] | None = None


def benchmark(data: Path, options: BenchmarkOptions, light: ScoredLight, *, json: ScoresJson = None) -> None:
    """Generate test rooms by their seed, and score spheres in their light after one image and after a walk.

    The tables compare mean colour, warp-and-fill, the classical and the chosen model by RMSE, scale-invariant RMSE and
    angular error of a mirror, a matte and a diffuse sphere. Stopped, the same command continues.

    Args:
        data: Folder of the rooms: a new one, or one that this command made.
        options: Which rooms.
        light: How to estimate the light.
    """
    wanted = benchmark_options(rooms=options.rooms, seed=options.seed)
    with Progress("generating") as progress:
        generate(data, wanted, workers=options.workers, progress=show_generation(progress))
    folder = Dataset(data, "test")
    with scoring_progress() as progress:
        scores = evaluate_benchmark(folder, light, rooms=options.rooms, depth=options.depth, progress=progress.count)
    show_scores(scores, json, *scores.tables(title=f"{options.depth} depth, seed {options.seed}"))
    say(f"SHA-256 of the rooms: {rooms_digest(data, options.rooms)}")
