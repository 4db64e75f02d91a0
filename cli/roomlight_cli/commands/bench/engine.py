"""`roomlight bench stages` and `composite`: the engine's stages, and virtual objects in frames, part by part."""

from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Interval

from roomlight.errors import OptionError
from roomlight_bench.compositing.composite import run_composite
from roomlight_bench.stages.stages import run_against, run_stages
from roomlight_cli.console import show_scores
from roomlight_cli.progress import Progress
from roomlight_cli.shared_options import FiguresJson


def stages(
    *,
    repeats: Annotated[int, Ge(1)] = 7,
    weights: Path | None = None,
    against: Path | None = None,
    json: FiguresJson = None,
) -> None:
    """Time each stage beside its reference and plain PyTorch; networks also against this machine's peak.

    Args:
        repeats: Interleaved repeats of each stage.
        weights: A model folder of `roomlight export`. Default: the single-view networks inside the package.
        against: Instead: whole frames and late points in turns with those of this other checkout of RoomLight.
    """
    if against is not None and weights is not None:
        raise OptionError("each checkout is timed with its own networks: leave out `weights` with `against`")
    with Progress("measuring") as progress:
        if against is None:
            report = run_stages(repeats=repeats, model=weights, progress=progress.say)
        else:
            report = run_against(against, rounds=repeats, progress=progress.say)
    show_scores(report, json, *report.tables())


def composite(
    *,
    frames: Annotated[int, Interval(ge=1, le=1000)] = 30,
    final: bool = False,
    json: FiguresJson = None,
) -> None:
    """Measure what virtual objects in a frame cost by part.

    Args:
        frames: Measured frames of a preview; good takes a quarter, final a tenth.
        final: Also measure the quality final (minutes).
    """
    with Progress("measuring") as progress:
        report = run_composite(frames=frames, final=final, progress=progress.say)
    show_scores(report, json, *report.tables())
