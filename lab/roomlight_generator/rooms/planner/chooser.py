"""Interface through which the planner chooses furniture models."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture_model import FurnitureModel


@runtime_checkable
class Chooser(Protocol):
    """A collection of furniture models that can be sampled by role."""

    def choose(
        self, role: str, split: Split, rng: np.random.Generator, *, fits: Callable[[FurnitureModel], bool] | None = None
    ) -> FurnitureModel | None:
        """Choose a model of that role for rooms of that split among those that `fits` accepts; None if there is
        none."""
        ...
