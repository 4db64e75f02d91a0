"""What the planner asks of a collection of furniture."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture_model import FurnitureModel


@runtime_checkable
class Chooser(Protocol):
    """Gives models by role."""

    def choose(
        self, role: str, split: Split, rng: np.random.Generator, *, fits: Callable[[FurnitureModel], bool] | None = None
    ) -> FurnitureModel | None:
        """A model of that role for rooms of that split, of those that `fits` accepts; None: there is none."""
        ...
