"""`roomlight eval`: the engine as one of the methods that `evaluate` scores, and what the command prints."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

from roomlight.baselines import MeanColour, WarpAndFill
from roomlight.captures import CaptureOptions
from roomlight.conventions import Position
from roomlight.engine.graphs import LightingGraphs
from roomlight.engine.session import Session, SessionOptions, choose_graphs, warm_up
from roomlight.frame import Frame
from roomlight_evaluation.evaluate import Estimator, evaluate
from roomlight_evaluation.tables import evaluation_tables, print_whole


class EngineEstimator:
    """A session as an estimator: positions are tracked from the first time they are asked for, unless `late`."""

    def __init__(self, options: SessionOptions, graphs: LightingGraphs | None, *, late: bool = False) -> None:
        """A fresh session; `graphs` as `choose_graphs` gave them for these options.

        `late`: every question is a position's first, answered from the keyframes alone.
        """
        self._session = Session(options, graphs=graphs)
        self._late = late
        self._handles: dict[Position, int] = {}
        self.name = self._session.model + (", asked late" if late else "")

    def push(self, frame: Frame) -> None:
        """Take the next frame."""
        self._session.push(frame)

    def light_at(self, position: Position) -> Float[np.ndarray, "h w 3"]:
        """The light after the frames so far."""
        if self._late:
            return self._session.light_at(position).panorama
        if position not in self._handles:
            self._handles[position] = self._session.track(position)
        return self._session.light(self._handles[position]).panorama


def run_evaluation(
    captures: Sequence[Path],
    *,
    predictions: Path | None,
    late: bool,
    json_out: Path | None,
    console: Console,
    session: SessionOptions,
    capture: CaptureOptions,
) -> None:
    """Evaluate, print the tables, write the JSON. Raises RoomLightError."""
    graphs = choose_graphs(session) if predictions is None else None

    def estimators() -> list[Estimator]:
        baselines: list[Estimator] = [MeanColour(), WarpAndFill()]
        if predictions is not None:
            return baselines
        asked_late = [EngineEstimator(session, graphs, late=True)] if late else []
        return [*baselines, EngineEstimator(session, graphs), *asked_late]

    with Progress(console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("compiling kernels (first run only)", total=None)
        warm_up()

        def show(name: str, done: int, total: int) -> None:
            bars.update(task, description=escape(f"scoring {name}"), completed=done, total=total)

        evaluation = evaluate(captures, estimators, options=capture, predictions=predictions, progress=show)
    for table in evaluation_tables(evaluation, per_capture=True):
        print_whole(console, table)
    if json_out:
        evaluation.write(json_out)
        console.print(f"scores written to {json_out}", soft_wrap=True, markup=False)
