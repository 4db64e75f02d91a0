"""What the planner asks of a collection of furniture."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from roomlight_model.rooms.model import Model, Split


@runtime_checkable
class Chooser(Protocol):
    """Gives models by role."""

    def choose(
        self, role: str, split: Split, rng: np.random.Generator, *, fits: Callable[[Model], bool] | None = None
    ) -> Model | None:
        """A model of that role for rooms of that split, of those that `fits` accepts; None: there is none."""
        ...
