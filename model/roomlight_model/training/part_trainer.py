"""The loop that trains the small networks that serve every model: clipped radiance and panorama completion.

A run is a folder, as of the other stages: options.json, last.pt (to resume from), model.pt (averaged weights and their
scores), best.pt (those with the lowest held-out loss), log.jsonl. All random choices follow from (seed, step).
"""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from roomlight.engine.networks.graphs import PartForm
from roomlight.errors import ModelError, OptionError, OutputError
from roomlight.files import write_atomic
from roomlight_model.part_checkpoint import load_part_checkpoint, save_part_checkpoint
from roomlight_model.training.options import OPTIONS
from roomlight_model.training.trainer import LAST

_REPORT_STEPS: Final = 20
LOG: Final = "log.jsonl"


@runtime_checkable
class PartStage(Protocol):
    """What is trained: examples, a network, its loss and its scores."""

    @property
    def form(self) -> PartForm:
        """The form of the network."""
        ...

    def network(self) -> nn.Module:
        """Build the network."""
        ...

    def __len__(self) -> int:
        """Return the number of training examples."""
        ...

    def loss(self, network: nn.Module, chosen: list[int], rng: np.random.Generator) -> Float[Tensor, ""]:
        """Return the loss of a batch of examples."""
        ...

    def scores(self, network: nn.Module) -> Mapping[str, float]:
        """Score held-out examples; `loss` is the one that the best weights minimise."""
        ...


@dataclass(frozen=True)
class PartOptions:
    """Options of a run.

    Attributes:
        steps: Optimiser steps.
        batch: Examples a step.
        learning_rate: The highest, after 100 steps of warm-up; a cosine lowers it to a hundredth.
        ema: Decay of the averaged weights.
        seed: Seed of all random choices.

    Raises:
        OptionError: A value is out of range.
    """

    steps: int = 3000
    batch: int = 16
    learning_rate: float = 1e-3
    ema: float = 0.998
    seed: int = 0

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 1 or not 0 < self.learning_rate <= 1 or not 0 <= self.ema <= 1:
            raise OptionError(
                f"steps {self.steps} and batch {self.batch} must be 1 or more, learning_rate {self.learning_rate} "
                f"above 0 and ema {self.ema} within [0, 1]"
            )


@dataclass(frozen=True)
class PartProgress:
    """Progress of a run: mean loss since the last report; `scores` after a validation."""

    step: int
    steps: int
    loss: float
    seconds_a_step: float
    scores: Mapping[str, float] | None = None


class PartTrainer:
    """One run in one folder."""

    def __init__(
        self,
        stage: PartStage,
        options: PartOptions,
        out: Path,
        *,
        data: list[dict[str, Any]] | None = None,
        start_from: Path | None = None,
    ) -> None:
        """Start a run in an empty folder, or resume the folder's run.

        Raises:
            ModelError: The folder's run has other options (`steps` may differ) or is damaged, there are fewer examples
                than a batch needs, or `start_from` holds another network.
            OutputError: The folder holds other files.
        """
        if len(stage) < options.batch:
            raise ModelError(f"{len(stage)} examples are fewer than a batch of {options.batch}")
        self.stage, self.options, self.out, self._data = stage, options, out, data or []
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(options.seed)
            self.network = stage.network()
        if start_from is not None:
            found = load_part_checkpoint(start_from)
            if found.form != stage.form:
                raise ModelError(f"{start_from}: holds a {found.form} network; this stage trains {stage.form}")
            self.network.load_state_dict(found.network.state_dict())
        self.average = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self._optimizer = torch.optim.AdamW(self.network.parameters(), options.learning_rate, weight_decay=0.02)
        self.step, self.seconds = 0, 0.0
        self._open()

    def train(
        self,
        *,
        report: Callable[[PartProgress], object],
        every_steps: int = 250,
        checkpoint_s: float = 600.0,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Train to the last step, or until `stop`; validate every `every_steps` steps and where it ends.

        Raises:
            ModelError: The loss is not finite.
            OutputError: The folder cannot be written.
        """
        began = saved = time.monotonic()
        before, losses, scored = self.seconds, list[float](), self.step
        while self.step < self.options.steps and not stop():
            losses.append(self._one_step())
            self.step += 1
            now = time.monotonic()
            self.seconds = before + now - began
            last = self.step == self.options.steps
            scores = self.keep_scored() if last or self.step % every_steps == 0 else None
            scored = scored if scores is None else self.step
            if scores is not None or self.step % _REPORT_STEPS == 0:
                mean = float(np.mean(losses))
                losses.clear()
                speed = self.seconds / self.step
                self._log({"step": self.step, "loss": mean, **({} if scores is None else {"scores": dict(scores)})})
                report(PartProgress(self.step, self.options.steps, mean, speed, scores))
            if now - saved > checkpoint_s:
                self.save()
                saved = now
        self.save()
        if scored < self.step:  # stopped
            self.keep_scored()

    def averaged(self) -> nn.Module:
        """Return a network with the averaged weights."""
        network = self.stage.network()
        network.load_state_dict(self.average)
        return network.eval()

    def keep_scored(self) -> Mapping[str, float]:
        """Score the averaged weights; write model.pt, and best.pt if no earlier score was as low."""
        averaged = self.averaged()
        scores = self.stage.scores(averaged)
        card = {**self.card(), "scores": dict(scores)}
        save_part_checkpoint(self.out / "model.pt", self.stage.form, averaged, card=card)
        best = self.out / "best.pt"
        if not best.exists() or scores["loss"] < load_part_checkpoint(best).card["scores"]["loss"]:
            save_part_checkpoint(best, self.stage.form, averaged, card=card)
        return scores

    def card(self) -> dict[str, Any]:
        """Return the record of the run for its weights."""
        return {
            "stage": self.stage.form,
            "steps": self.step,
            "hours": round(self.seconds / 3600, 3),
            "seed": self.options.seed,
            "examples": len(self.stage),
            "data": self._data,
            "date": datetime.now(UTC).date().isoformat(),
            "options": asdict(self.options),
        }

    def save(self) -> None:
        """Write last.pt, atomically."""
        buffer = BytesIO()
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "network": self.network.state_dict(),
            "average": self.average,
            "optimizer": self._optimizer.state_dict(),
        }
        torch.save(state, buffer)
        write_atomic(self.out / LAST, buffer.getvalue())

    def _one_step(self) -> float:
        options = self.options
        warm = min(1.0, (self.step + 1) / 100)
        rate = options.learning_rate * warm * (0.01 + 0.495 * (1 + np.cos(np.pi * self.step / options.steps)))
        for group in self._optimizer.param_groups:
            group["lr"] = float(rate)
        rng = np.random.default_rng([options.seed, self.step])
        self.network.train()
        loss = self.stage.loss(self.network, rng.integers(len(self.stage), size=options.batch).tolist(), rng)
        if not torch.isfinite(loss):
            raise ModelError(
                f"{self.out}: the loss is {float(loss.detach())} at step {self.step}; use a lower learning rate"
            )
        self._optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self._optimizer.step()
        keep = min(options.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, value in self.network.state_dict().items():
                self.average[name].lerp_(value, 1 - keep)
        return float(loss.detach())

    def _open(self) -> None:
        path, ours = self.out / OPTIONS, {"stage": self.stage.form, **asdict(self.options)}
        if not path.exists() and self.out.exists() and any(self.out.iterdir()):
            raise OutputError(f"{self.out}: holds other files and no training run; give an empty folder")
        if path.exists():
            theirs = _read_options(path)
            changed = [name for name in ours if name != "steps" and theirs.get(name) != ours[name]]
            if changed:
                raise ModelError(
                    f"{self.out}: its run has other options ({', '.join(changed)}); use another folder or the same "
                    "options"
                )
        self.out.mkdir(parents=True, exist_ok=True)
        write_atomic(path, (json.dumps(ours, indent=1) + "\n").encode())
        last = self.out / LAST
        if last.exists():
            try:
                state = torch.load(last, map_location="cpu", weights_only=True)
                self.network.load_state_dict(state["network"])
                self._optimizer.load_state_dict(state["optimizer"])
                self.average, self.step, self.seconds = state["average"], state["step"], state["seconds"]
            except Exception as error:  # the unpickler raises any type for damaged bytes
                reason = str(error).strip().split("\n")[0] or type(error).__name__
                raise ModelError(f"{last}: cannot be resumed from ({reason}); delete it to start again") from error
        self._cut_log()

    def _cut_log(self) -> None:
        """Leave out what was logged after the state that the run resumes from."""
        log = self.out / LOG
        if log.exists():
            lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= self.step]
            write_atomic(log, "".join(kept).encode())

    def _log(self, entry: Mapping[str, Any]) -> None:
        with (self.out / LOG).open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")


def _read_options(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ModelError(f"{path}: is damaged ({error}); use another folder") from error
    if not isinstance(found, dict):
        raise ModelError(f"{path}: holds no options; use another folder")
    return found
