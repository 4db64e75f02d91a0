"""What the stages of the small networks share: examples in memory, a network of a fixed width, weights to start from.

A stage adds its batches, its losses and its scores: `clipping`, `objects`, `depth.stage`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import torch
from annotated_types import Ge, Interval

from roomlight.errors import ModelError
from roomlight_model.checkpoint import Checkpoint, build_network
from roomlight_model.config import ModelConfig
from roomlight_model.training.batches import Tensors
from roomlight_model.training.run_folder import RunOptions


@dataclass(frozen=True)
class SmallOptions(RunOptions):
    """Options whose defaults suit a network of a few hundred thousand weights."""

    batch: Annotated[int, Ge(1)] = 16
    warm_up: Annotated[int, Ge(0)] = 100
    weight_decay: Annotated[float, Ge(0)] = 0.02
    ema: Annotated[float, Interval(ge=0, le=1)] = 0.998
    validate_steps: Annotated[int, Ge(1)] = 250


OptionsT = TypeVar("OptionsT", bound=RunOptions)
ExamplesT = TypeVar("ExamplesT", bound=Tensors)


class SmallStage(Generic[OptionsT, ExamplesT]):
    """A stage whose name is the form of the network that it trains; held-out examples score it."""

    def __init__(
        self,
        options: OptionsT,
        training: ExamplesT,
        held_out: ExamplesT,
        *,
        start_from: Checkpoint | None = None,
        data: list[dict[str, Any]] | None = None,
        device: torch.device = torch.device("cpu"),  # noqa: B008 - a constant
    ) -> None:
        """Take the examples, the weights to start from (None: fresh ones), and where the network runs.

        Raises:
            ModelError: `start_from` holds another network.
        """
        if start_from is not None and start_from.form != options.stage:
            raise ModelError(
                f"stage {options.stage} cannot start from {start_from.form} weights; give `start_from` {options.stage} "
                "ones"
            )
        self.options, self.device, self.data = options, device, data or []
        self.training, self.held_out, self.start_from = training, held_out, start_from

    @property
    def piece_size(self) -> int:
        """A batch is not split: its examples share their work well between threads."""
        return self.options.batch

    def __len__(self) -> int:
        return len(self.training)

    def network(self) -> Any:
        """Build the network."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.options.seed)
            network = build_network(self.options.stage, ModelConfig())
        if self.start_from is not None:
            network.load_state_dict(self.start_from.model.state_dict())
        return network

    def held_out_parts(self, size: int) -> Iterator[ExamplesT]:
        """Yield the held-out examples, `size` at a time."""
        for first in range(0, len(self.held_out), size):
            yield self.held_out.take(range(first, min(first + size, len(self.held_out))))

    def draw(self, network: Any, path: Path) -> None:
        """Draw nothing: the scores say all."""
