"""`roomlight eval captures`: light scored on recordings; `depth` and `poses`: what is estimated for those without."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Ge

from roomlight.captures import CaptureOptions
from roomlight.dataset.recording import Split
from roomlight.errors import OptionError
from roomlight_cli.console import show_scores
from roomlight_cli.options import Without
from roomlight_cli.shared_options import ScoredLight, ScoresJson, note_unused_objects, scoring_progress
from roomlight_evaluation.captures.depth import evaluate_depth
from roomlight_evaluation.captures.evaluation import evaluate_engine
from roomlight_evaluation.captures.main_light import evaluate_main_lights, main_light_table
from roomlight_evaluation.captures.poses import evaluate_poses
from roomlight_evaluation.captures.tables import capture_tables


@dataclass(frozen=True)
class ScoreOptions:
    """What is scored.

    Attributes:
        predictions: Also score panoramas in files, PREDICTIONS/CAPTURE/probe-00/light.000000.exr: of another method,
            or of `roomlight replay --probes-from-capture --use reflection`.
        main_light: Score the direction of the main light instead; captures need no ground truth.

    Raises:
        OptionError: Two of them exclude each other.
    """

    predictions: Path | None = None
    main_light: bool = False

    def __post_init__(self) -> None:
        if self.main_light and self.predictions is not None:
            raise OptionError("main_light scores tracked probes: leave out `predictions`")


def captures(
    captures: tuple[Path, ...],
    options: ScoreOptions,
    light: ScoredLight,
    reading: CaptureOptions,
    *,
    json: ScoresJson = None,
) -> None:
    """Score light against the ground-truth probes of recordings.

    The tables have the paper's intervals of frames as columns. Beside the model are the classical one, by ratios too,
    and two baselines: mean colour, and warp-and-fill. With --predictions, every frame that is read (--every,
    --max-frames) needs one for each probe. Captures of one room, which `facts.json` in each states ({"room": "attic"}),
    count together in intervals.

    Args:
        captures: Captures that have ground-truth probes.
        options: What to score.
        light: How to estimate the light.
        reading: How to read the captures.
    """
    if not options.main_light:
        note_unused_objects(light)
    with scoring_progress() as progress:
        if options.main_light:
            scores = evaluate_main_lights(captures, light, options=reading, progress=progress.count_of)
            tables = [main_light_table(scores)]
        else:
            scores = evaluate_engine(
                captures, light, predictions=options.predictions, options=reading, progress=progress.count_of
            )
            tables = capture_tables(scores, per_capture=True)
    show_scores(scores, json, *tables)


def depth(
    sources: tuple[Path, ...],
    light: ScoredLight,
    reading: Annotated[CaptureOptions, Without("depth")],
    *,
    split: Split = "test",
    limit: Annotated[int, Ge(1)] | None = None,
    json: ScoresJson = None,
) -> None:
    """Score estimated depth on recordings whose own depth is hidden from it, and the light that follows.

    Compared are 2.5 m everywhere, each frame alone, the stream with its poses, and that at each frame's best scale.

    Args:
        sources: Captures with depth, and dataset folders.
        light: How to estimate the light.
        reading: How to read the captures.
        split: Of dataset folders; no network is trained on test.
        limit: Use this many walks of each dataset.
    """
    note_unused_objects(light)
    with scoring_progress() as progress:
        scores = evaluate_depth(sources, light, reading, split=split, limit=limit, progress=progress.count_of)
    show_scores(scores, json, scores.table())


def poses(
    captures: tuple[Path, ...],
    light: ScoredLight,
    reading: Annotated[CaptureOptions, Without("depth")],
    *,
    json: ScoresJson = None,
) -> None:
    """Score estimated camera poses on recordings whose pictures become a video without anything else.

    Args:
        captures: Captures with poses and depth.
        light: How to estimate the light.
        reading: How to read the captures; --fov and --depth-model are for the videos.
    """
    note_unused_objects(light)
    with scoring_progress() as progress:
        scores = evaluate_poses(captures, light, reading, progress=progress.count_of)
    show_scores(scores, json, scores.table())
