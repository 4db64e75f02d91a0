"""The run loop of every stage, from top to bottom: batches prepared ahead, step, average, validation, checkpoint.

A stage is its data, its forward pass and its loss: `single_view`, `video`, `clipping`, `objects`, `depth`. All random
choices follow from (seed, step), so that a resumed run repeats the loss curve of an uninterrupted one.
"""

import copy
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from roomlight.errors import ModelError
from roomlight_model.checkpoint import Checkpoint, Network
from roomlight_model.training.batches import Tensors
from roomlight_model.training.losses import BatchGradients, Losses
from roomlight_model.training.run_folder import RunFolder, RunOptions

_AHEAD: Final = 3
"""Batches prepared in advance."""
REPORT_STEPS: Final = 20
"""Steps between two reports of losses."""
CHECKPOINT_S: Final = 300.0
"""Seconds between two saved states: what a killed run repeats at most."""


@runtime_checkable
class Stage(Protocol):
    """What a run trains: data, forward pass, loss and scores."""

    @property
    def options(self) -> RunOptions:
        """The options of the run."""
        ...

    @property
    def device(self) -> torch.device:
        """Where the network runs."""
        ...

    @property
    def piece_size(self) -> int:
        """Examples in one forward pass on a CPU."""
        ...

    @property
    def data(self) -> list[dict[str, Any]]:
        """A description of the datasets in JSON values, for the card."""
        ...

    @property
    def start_from(self) -> Checkpoint | None:
        """The weights that the stage starts from; None for fresh ones."""
        ...

    def __len__(self) -> int: ...

    def network(self) -> Network:
        """Build the network that training starts with, on `device`; what is trained requires a gradient."""
        ...

    def batch(self, step: int, /) -> Tensors:
        """Prepare the batch of a step; runs on a thread of its own, ahead of the step."""
        ...

    def losses(self, network: Any, batch: Any, generator: torch.Generator, /) -> Losses:
        """Return the mean losses of a batch; the gradient of "loss" trains."""
        ...

    def scores(self, network: Any, /) -> Mapping[str, float]:
        """Score held-out examples; the best weights have the lowest "loss". Empty if nothing is held out."""
        ...

    def draw(self, network: Any, path: Path, /) -> None:
        """Write a picture of held-out examples, if the stage has one."""
        ...


@dataclass(frozen=True)
class TrainingProgress:
    """Progress of a run, reported after each step and each validation.

    Attributes:
        losses: Means over `REPORT_STEPS` steps or up to the last step; empty in between and after a validation.
        learning_rate: Of the last step.
        seconds_a_step: Mean time.
        waited_for_data: Share of the time.
        scores: Scores of held-out examples, after a validation.
        best: Whether they are the best so far.
    """

    step: int
    steps: int
    losses: Mapping[str, float]
    learning_rate: float = 0.0
    seconds_a_step: float = 0.0
    waited_for_data: float = 0.0
    scores: Mapping[str, float] | None = None
    best: bool = False


class Run:
    """One stage of training in one folder.

    Examples:
        run = Run(stage, Path("runs/objects"))
        run.train(minutes=30)  # or until the last step, Ctrl-C or SIGTERM; the same lines continue
        print(run.card()["scores"])
    """

    def __init__(self, stage: Stage, out: Path) -> None:
        """Start a run in an empty folder, or resume the folder's run.

        Raises:
            ModelError: The folder's run has other options, data or weights to start from (`steps` may differ) or is
                damaged, or there are fewer examples than a batch needs.
            OutputError: The folder holds other files, or cannot be written.
        """
        options = stage.options
        if len(stage) < options.batch:
            raise ModelError(
                f"{out}: stage {options.stage} has {len(stage)} examples, fewer than its batch of {options.batch}; "
                "give more data, or a smaller `batch`"
            )
        self.stage, self.folder = stage, RunFolder(out)
        self.network = stage.network()
        self._parameters = [weight for weight in self.network.parameters() if weight.requires_grad]
        self._gradients = BatchGradients(
            partial(stage.losses, self.network),
            self._parameters,
            options,
            device=stage.device,
            piece_size=stage.piece_size,
        )
        self._optimizer = torch.optim.AdamW(
            self._parameters,
            lr=options.learning_rate,
            weight_decay=options.weight_decay,
            fused=True,  # 1.5 ms a step where the plain loop takes 7.7
        )
        self.average = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self.step, self.seconds = 0, 0.0
        self.stopped_by: int | None = None
        self._losses: dict[str, float] = {}  # sums since the last report
        self._scores: dict[str, float] | None = None  # of the present step
        start = None if stage.start_from is None else stage.start_from.digest
        self.folder.open({**options.to_dict(), "data": stage.data, "start_from": start})
        self._resume()

    def train(
        self,
        *,
        report: Callable[[TrainingProgress], object] = lambda _: None,
        minutes: float | None = None,
        stop: Callable[[], bool] = lambda: False,
        checkpoint_s: float = CHECKPOINT_S,
    ) -> None:
        """Train until the last step, for `minutes`, until `stop`, Ctrl-C or SIGTERM; then save and validate.

        Raises:
            ModelError: The loss or its gradient is not finite.
            OutputError: The folder cannot be written.
        """
        options, began, before = self.stage.options, time.monotonic(), self.seconds
        saved = since = began
        ends = began + 60 * minutes if minutes is not None else float("inf")
        waited, counted = 0.0, 0
        curves = SummaryWriter(str(self.folder.path / "tensorboard"), purge_step=self.step + 1)
        with batches_ahead(self.stage, self.step) as batches, _signals() as signals:
            self.network.train()
            while self.step < options.steps and not signals and time.monotonic() < ends and not stop():
                requested = time.monotonic()
                batch = next(batches)
                waited += time.monotonic() - requested
                self.advance(batch)
                counted += 1
                now = time.monotonic()
                self.seconds = before + now - began
                last = self.step == options.steps
                if self.step % REPORT_STEPS == 0 or last:
                    progress = TrainingProgress(
                        step=self.step,
                        steps=options.steps,
                        losses=self._mean_losses(),
                        learning_rate=learning_rate(options, self.step - 1),
                        seconds_a_step=(now - since) / counted,
                        waited_for_data=waited / max(now - since, 1e-9),
                    )
                    self._log(progress, curves)
                    report(progress)
                    waited, counted, since = 0.0, 0, now
                else:
                    report(TrainingProgress(self.step, options.steps, {}))
                if self.step % options.validate_steps == 0 and not last:
                    report(self._validate(curves))
                    waited, counted, since = 0.0, 0, time.monotonic()
                if time.monotonic() - saved > checkpoint_s:
                    self.save()
                    saved = time.monotonic()
            self.stopped_by = signals[0] if signals else None
        self.save()
        if self._scores is None:
            report(self._validate(curves))
            self.save()
        curves.close()

    def advance(self, batch: Tensors) -> dict[str, float]:
        """Make one step: gradients, AdamW, average. Returns the losses.

        Raises:
            ModelError: The loss or its gradient is not finite.
        """
        options = self.stage.options
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate(options, self.step)
        losses = self._gradients.of(batch, self.step)
        norm = float(torch.nn.utils.clip_grad_norm_(self._parameters, 1.0))
        for name, value in (("loss", losses["loss"]), ("gradient's norm", norm)):
            if not np.isfinite(value):
                raise ModelError(
                    f"{self.folder.path}: the {name} is {value} at step {self.step}; use a lower learning rate"
                )
        self._optimizer.step()
        decay = min(options.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, value in self.network.state_dict().items():
                self.average[name].lerp_(value, 1 - decay)
        self.step += 1
        self._scores = None
        for name, value in losses.items():
            self._losses[name] = self._losses.get(name, 0.0) + value
        return losses

    def averaged(self) -> Network:
        """Return a copy of the network with the averaged weights, in evaluation mode."""
        network = copy.deepcopy(self.network)
        network.load_state_dict(self.average)
        return network.eval()

    def save(self) -> None:
        """Write last.pt and model.pt, each atomically."""
        self.folder.save_state(
            {
                "step": self.step,
                "seconds": self.seconds,
                "losses": self._losses,
                "scores": self._scores if self._is_due else None,
                "network": self.network.state_dict(),
                "average": self.average,
                "optimizer": self._optimizer.state_dict(),
            }
        )
        self.folder.save_weights(self.averaged(), self.card())

    def card(self) -> dict[str, Any]:
        """Return the record of this stage for its weights; `before` is the record of those it started from."""
        return {
            "stage": self.stage.options.stage,
            "steps": self.step,
            "hours": round(self.seconds / 3600, 3),
            "seed": self.stage.options.seed,
            "examples": len(self.stage),
            "data": self.stage.data,
            "date": datetime.now(UTC).date().isoformat(),
            "options": self.stage.options.to_dict(),
            **({} if self._scores is None else {"scores": self._scores}),
            **({} if self.stage.start_from is None else {"before": self.stage.start_from.card}),
        }

    @property
    def _is_due(self) -> bool:
        """Whether a run that is not interrupted validates after this step."""
        options = self.stage.options
        return self.step > 0 and (self.step % options.validate_steps == 0 or self.step == options.steps)

    def _validate(self, curves: SummaryWriter) -> TrainingProgress:
        """Score the averaged weights; write model.pt, a picture, and best.pt if no earlier score was as low.

        Where a run stops in between, best.pt stays: it must not depend on interruptions.
        """
        network, best = self.averaged(), False
        self._scores = dict(self.stage.scores(network))
        if self._scores:
            self.folder.save_weights(network, self.card())
            if self._is_due:
                best = self.folder.keep_best(network, self.card())
            self.stage.draw(network, self.folder.path / "pictures" / f"{self.step:07d}.png")
            self.folder.log({"step": self.step, "scores": self._scores})
            for name, value in self._scores.items():
                curves.add_scalar(f"held out/{name}", value, self.step)
        return TrainingProgress(self.step, self.stage.options.steps, {}, scores=self._scores, best=best)

    def _mean_losses(self) -> dict[str, float]:
        count = (self.step - 1) % REPORT_STEPS + 1
        means = {name: value / count for name, value in self._losses.items()}
        if self.step % REPORT_STEPS == 0:  # a run that ended in between may be made longer
            self._losses = {}
        return means

    def _log(self, progress: TrainingProgress, curves: SummaryWriter) -> None:
        figures = {
            **progress.losses,
            "learning_rate": progress.learning_rate,
            "seconds_a_step": progress.seconds_a_step,
            "waited_for_data": progress.waited_for_data,
        }
        self.folder.log({"step": self.step, **figures})
        for name, value in figures.items():
            curves.add_scalar(f"train/{name}", value, self.step)

    def _resume(self) -> None:
        state = self.folder.load_state(self.stage.device)
        if state is not None:
            try:
                self.network.load_state_dict(state["network"])
                self._optimizer.load_state_dict(state["optimizer"])
                self.average, self._losses, self._scores = state["average"], state["losses"], state["scores"]
                self.step, self.seconds = state["step"], state["seconds"]
            except (RuntimeError, KeyError, ValueError) as error:
                raise self.folder.cannot_resume(error) from error
        self.folder.cut_log(self.step)


def learning_rate(options: RunOptions, step: int) -> float:
    """Return the learning rate of a step: linear warm-up, then a cosine down to a hundredth."""
    if step < options.warm_up:
        return options.learning_rate * (step + 1) / options.warm_up
    done = (step - options.warm_up) / max(1, options.steps - options.warm_up)
    return options.learning_rate * (0.01 + 0.99 * 0.5 * (1 + float(np.cos(np.pi * min(done, 1.0)))))


@contextmanager
def batches_ahead(stage: Stage, step: int) -> Generator[Iterator[Tensors]]:
    """Yield an iterator over the batches from a step on, prepared in advance by two threads."""
    with ThreadPoolExecutor(2, thread_name_prefix="examples") as pool:
        waiting: list[Future[Tensors]] = []

        def batches() -> Iterator[Tensors]:
            following = step
            while True:
                while len(waiting) < _AHEAD:
                    waiting.append(pool.submit(stage.batch, following))
                    following += 1
                yield waiting.pop(0).result()

        try:
            yield batches()
        finally:
            for future in waiting:
                future.cancel()


@contextmanager
def _signals() -> Generator[list[int]]:
    """Yield a list that receives SIGINT and SIGTERM instead of ending the process; only the main thread has signals."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    before = {
        number: signal.signal(number, lambda number, _: received.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
