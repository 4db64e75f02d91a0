"""The test run checks the shapes of arrays: a wrong one fails where it is passed."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from roomlight.conventions import direction_to_uv
from roomlight_bench.stages.peak import MatrixProduct
from roomlight_evaluation.baselines import MeanColour


def test_a_wrong_shape_is_an_error_in_every_layer():
    with pytest.raises(TypeCheckError):
        direction_to_uv(np.zeros((4, 2), np.float32))
    with pytest.raises(TypeCheckError):
        MeanColour().light_at("somewhere")  # type: ignore[arg-type]
    with pytest.raises(TypeCheckError):
        MatrixProduct(edge="large")  # type: ignore[arg-type]
