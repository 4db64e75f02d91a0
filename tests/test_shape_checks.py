"""The test run checks the shapes of arrays: a wrong one fails where it is passed."""

import inspect
from dataclasses import dataclass, field

import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError

from roomlight.conventions import direction_to_uv
from roomlight_bench.timing import Timing
from roomlight_evaluation.baselines import MeanColour
from shape_checks import checked


def test_a_wrong_shape_is_an_error_in_every_layer():
    for wrapper, arguments in (
        (direction_to_uv, (np.zeros((4, 2), np.float32),)),
        (MeanColour.light_at, (MeanColour(), "somewhere")),
        (Timing.__init__, (object.__new__(Timing), "fast", 1.0, 1)),
    ):
        anew = checked(inspect.unwrap(wrapper))  # earlier tests may have used up its checked calls
        with pytest.raises(TypeCheckError):
            anew(*arguments)


def pairs(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, " n"], rows: int = 2) -> Float[np.ndarray, "n 2"]:
    assert rows >= 0
    return a[:, :rows] + b[:, None]


def grid(rows: int) -> Float[np.ndarray, "{rows} 2*{rows}"]:
    return np.zeros((rows, 4))


@checked
@dataclass(frozen=True)
class Rows:
    values: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"] = field(default_factory=lambda: np.ones(2))


def test_sizes_are_the_same_in_all_arguments_and_the_result():
    three, two = np.zeros((5, 3)), checked(grid)(2)
    assert checked(pairs)(three, np.zeros(5)).shape == (5, 2)
    assert Rows(three[:2]).weights.sum() == 2
    for work in (
        lambda: checked(pairs)(three, np.zeros(4)),
        lambda: checked(pairs)(three, np.zeros(5, int)),
        lambda: checked(pairs)(three, np.zeros(5), rows=1),
        lambda: checked(pairs)(three, np.zeros(5), rows=two),
        lambda: checked(grid)(3),
        lambda: Rows(three, np.ones(4)),
        lambda: Rows(three[:, :2]),
    ):
        with pytest.raises(TypeCheckError):
            work()
