"""`roomlight eval composite` and `objects`: virtual objects scored beside the same objects under the true light."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Ge

from roomlight.captures import CaptureOptions
from roomlight.dataset.recording import Split
from roomlight_cli.console import print_tables, say, show_scores
from roomlight_cli.options import Without
from roomlight_cli.shared_options import ScoredLight, ScoresJson, scoring_progress
from roomlight_evaluation.composites.evaluation import evaluate_composites
from roomlight_evaluation.composites.tables import composite_tables, summary
from roomlight_evaluation.objects.evaluation import evaluate_objects
from roomlight_evaluation.objects.tables import object_tables


@dataclass(frozen=True)
class CompositeScoreOptions:
    """Which scenes are scored, and what is written.

    Attributes:
        scenes: Rooms, each with one object.
        seed: Of rooms, walks and objects.
        keep: Folder of rendered scenes, to score several models on the same ones.
        pictures: Also write a PNG of each scene: truth, ours, true panorama, SH + directional.
    """

    scenes: Annotated[int, Ge(1)] = 40
    seed: Annotated[int, Ge(0)] = 0
    keep: Path | None = None
    pictures: Path | None = None


def composite(out: Path, options: CompositeScoreOptions, light: ScoredLight) -> None:
    """Compare virtual objects in pictures with the same rooms with the object really in them.

    A scene takes about a minute of processor time: the light of its room is solved three times.

    Args:
        out: File of results, a JSON line a scene; a run continues where it ended.
        options: What to score.
        light: How to estimate the light.
    """
    with scoring_progress() as progress:
        scores = evaluate_composites(
            options.scenes,
            out,
            seed=options.seed,
            options=light,
            keep=options.keep,
            pictures=options.pictures,
            progress=lambda done, total, note: progress.count_of(note, done, total),
        )
    print_tables(*composite_tables(scores))
    for line in summary(scores):
        say(line)


def objects(
    sources: tuple[Path, ...],
    light: ScoredLight,
    reading: Annotated[CaptureOptions, Without("every", "max_frames")],
    *,
    frames: Annotated[int, Ge(1)] = 6,
    split: Split = "test",
    limit: Annotated[int, Ge(1)] | None = None,
    json: ScoresJson = None,
) -> None:
    """Score spheres and a sphere's shadow in the light after a few frames, in many rooms with ground truth.

    The table compares the model, as it is and as composites change it, with SH + directional light
    and other simple lights. Half a second to two seconds a room.

    Args:
        sources: Captures with ground-truth probes, and dataset folders.
        light: How to estimate the light.
        reading: How to read the captures.
        frames: Show this many frames of each recording, evenly spread.
        split: Of dataset folders; no network is trained on test.
        limit: Use this many walks of each dataset.
    """
    with scoring_progress() as progress:
        scores = evaluate_objects(
            sources, light, reading=reading, frames=frames, split=split, limit=limit, progress=progress.count_of
        )
    show_scores(scores, json, *object_tables(scores))
