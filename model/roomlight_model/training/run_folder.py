"""A run on disk: the options that all stages share, and the files of a run's folder.

    options.json      the options, the data, the digest of the weights to start from; the same in a resumed run
    last.pt           the state to resume from: written atomically every few minutes
    model.pt          the averaged (EMA) weights as a checkpoint that `roomlight export` reads, and their scores
    best.pt           likewise, with the lowest score on held-out examples
    log.jsonl         one line for every reported step and every validation
    tensorboard/      the same curves
    pictures/         panoramas of held-out rooms during training, of the stages that draw them

`loop.Run` writes them.
"""

import json
import zipfile
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final
from zlib import crc32

import numpy as np
import torch
from annotated_types import Ge, Interval
from pydantic import ConfigDict, TypeAdapter

from roomlight.errors import ModelError, OutputError
from roomlight.files import write_atomic
from roomlight.rules import check_options
from roomlight_model.checkpoint import Network, load_checkpoint, save_checkpoint

FORMAT: Final = 3
"""Version of a run's folder."""
LAST: Final = "last.pt"
OPTIONS: Final = "options.json"
LOG: Final = "log.jsonl"
_MAY_CHANGE: Final = ("steps", "validate_steps")
"""Options that a resumed run may change; the learning rate follows the new length."""


@dataclass(frozen=True)
class RunOptions:
    """What all stages share. A run's length is in steps: hours depend on the machine, results must not.

    Attributes:
        stage: The stage of training.
        steps: Optimiser steps.
        batch: Examples in a batch.
        learning_rate: Largest learning rate, after the warm-up; a cosine lowers it to a hundredth.
        warm_up: Steps of the linear warm-up.
        weight_decay: AdamW's weight decay.
        ema: Decay of the averaged weights.
        validate_steps: Steps between two validations on held-out examples.
        seed: Seed of all random choices.

    Raises:
        OptionError: A value is out of range.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    stage: str = ""
    steps: Annotated[int, Ge(1)] = 20_000
    batch: Annotated[int, Ge(1)] = 4
    learning_rate: Annotated[float, Interval(gt=0, le=1)] = 1e-3
    warm_up: Annotated[int, Ge(0)] = 200
    weight_decay: Annotated[float, Ge(0)] = 1e-2
    ema: Annotated[float, Interval(ge=0, le=1)] = 0.999
    validate_steps: Annotated[int, Ge(1)] = 1000
    seed: Annotated[int, Ge(0)] = 0

    def __post_init__(self) -> None:
        check_options(self)

    def rng(self, *keys: int) -> np.random.Generator:
        """Return the random stream of this run for some keys, where zeros at the end do not count.

        It is the same in a resumed run. A batch's own keys are (step, `batch`), after those of its examples.
        """
        return np.random.default_rng([self.seed, crc32(self.stage.encode()), *keys])

    def draw_examples(self, count: int, step: int) -> Iterator[tuple[int, np.random.Generator]]:
        """Yield the numbers of a step's examples, each with its random stream; an epoch has every example once."""
        orders = dict[int, Any]()
        for slot in range(self.batch):
            epoch, place = divmod(step * self.batch + slot, count)
            if epoch not in orders:
                orders[epoch] = self.rng(epoch).permutation(count)
            yield int(orders[epoch][place]), self.rng(step, slot)

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return TypeAdapter(type(self)).dump_python(self, mode="json")


class RunFolder:
    """The files of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self, options: Mapping[str, Any]) -> None:
        """Write the options of a new run, or check that the folder's run has the same ones.

        Raises:
            ModelError: The folder's run has other options, data or weights to start from, or is of another version.
            OutputError: The folder holds other files, or cannot be written.
        """
        path = self.path / OPTIONS
        if not path.exists() and self.path.exists() and any(self.path.iterdir()):
            raise OutputError(f"{self.path}: holds other files and no training run; give an empty folder")
        if path.exists():
            self._check(options)
        write_atomic(path, (json.dumps({"format": FORMAT, **options}, indent=1) + "\n").encode())

    @property
    def has_run(self) -> bool:
        """Whether a run began in the folder."""
        return (self.path / OPTIONS).exists()

    def is_finished(self, options: RunOptions, **known: Any) -> bool:
        """Return whether the folder's run has made all steps and scored its weights.

        Args:
            known: `data` and `start_from` as `open` takes them; what is left out is not compared.

        Raises:
            ModelError: The folder's run has other options or made more steps, is damaged, or is of another version.
        """
        if not self.has_run:
            return False
        # the widths of a model are those of the weights to start from
        self._check({**options.to_dict(), **known}, ignored={"model", "data", "start_from"} - set(known))
        state = self.load_state(torch.device("cpu"))
        done = 0 if state is None else state.get("step", 0)
        if done > options.steps:
            raise ModelError(
                f"{self.path}: its run has made {done} steps, and steps is {options.steps}; give steps={done} or more, "
                "or use another folder"
            )
        return state is not None and state.get("scores") is not None and done == options.steps

    def _check(self, options: Mapping[str, Any], ignored: Set[str] = frozenset()) -> None:
        theirs = _read_options(self.path / OPTIONS)
        names = {*options, *theirs} - {"format", *_MAY_CHANGE, *ignored}
        changed = sorted(name for name in names if options.get(name) != theirs.get(name))
        if changed:
            other = "started from other weights" if changed == ["start_from"] else "has other options"
            raise ModelError(
                f"{self.path}: its run {other} ({', '.join(changed)}); delete the folder to train the stage again, or "
                "use another folder or the same options"
            )

    def load_state(self, device: torch.device) -> dict[str, Any] | None:
        """Return the state to resume from; None in a new run.

        Raises:
            ModelError: The file is damaged.
        """
        path = self.path / LAST
        if not path.exists():
            return None
        if not zipfile.is_zipfile(path):
            raise self.cannot_resume(ValueError("it is cut off, or no state of PyTorch"))
        try:
            return dict(torch.load(path, map_location=device, weights_only=True))
        except Exception as error:  # the unpickler raises any type for damaged bytes
            raise self.cannot_resume(error) from error

    def cannot_resume(self, error: Exception) -> ModelError:
        """Return the error that names the state and the remedy."""
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        return ModelError(f"{self.path / LAST}: cannot be resumed from ({reason}); delete it to start again")

    def save_state(self, state: Mapping[str, Any]) -> None:
        """Write the state to resume from."""
        buffer = BytesIO()
        torch.save(dict(state), buffer)
        write_atomic(self.path / LAST, buffer.getvalue())

    def save_weights(self, network: Network, card: Mapping[str, Any]) -> None:
        """Write model.pt."""
        save_checkpoint(self.path / "model.pt", network, card=card)

    def keep_best(self, network: Network, card: Mapping[str, Any]) -> bool:
        """Write best.pt if the score is finite and no earlier one was as low; return whether it was written."""
        best = self.path / "best.pt"
        if not np.isfinite(card["scores"]["loss"]):
            return False
        if best.exists() and load_checkpoint(best).card["scores"]["loss"] <= card["scores"]["loss"]:
            return False
        save_checkpoint(best, network, card=card)
        return True

    def log(self, values: Mapping[str, Any]) -> None:
        """Add a line to the log."""
        with (self.path / LOG).open("a", encoding="utf-8") as log:
            log.write(json.dumps(dict(values)) + "\n")

    def cut_log(self, step: int) -> None:
        """Remove lines after a step: they were logged after the saved state and will be logged again."""
        log = self.path / LOG
        if not log.exists():
            return
        kept: list[str] = []
        for line in log.read_text(encoding="utf-8").splitlines():
            try:
                if json.loads(line)["step"] <= step:
                    kept.append(line)
            except (ValueError, KeyError, TypeError):
                break  # a line that was cut off when the process was killed
        write_atomic(log, "".join(line + "\n" for line in kept).encode())


def _read_options(path: Path) -> dict[str, Any]:
    try:
        options = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ModelError(f"{path}: is damaged ({error}); use another folder") from error
    if not isinstance(options, dict) or options.get("format") != FORMAT:
        raise ModelError(
            f"{path}: is no run of this version of RoomLight (format {FORMAT}); finish it with the version that began "
            "it, or use another folder"
        )
    return options
