import numpy as np

from roomlight.monocular.kernels.adjustment import add_reduced
from roomlight.monocular.kernels.reference import reduced_reference


def test_the_kernel_agrees_with_its_reference() -> None:
    draw = np.random.default_rng(0)
    unknowns = 30
    first = np.array([0, 3, 3, 4, 9, 11])  # the second landmark has no sighting
    columns = np.stack([draw.permutation(unknowns)[:7] for _ in range(first[-1])])
    jacobian = draw.normal(size=(*columns.shape[:1], 2, 7))
    arguments = (
        first, columns, jacobian, draw.normal(size=columns.shape), draw.uniform(1, 3, len(first) - 1),
        draw.normal(size=(first[-1], 2)), draw.normal(size=len(first) - 1),
    )  # fmt: skip
    system, right = np.ones((unknowns, unknowns)), np.ones(unknowns)
    add_reduced(*arguments, system, right)
    expected_system, expected_right = reduced_reference(*arguments, unknowns)
    np.testing.assert_allclose(system, 1 + expected_system, atol=1e-12)
    np.testing.assert_allclose(right, 1 + expected_right, atol=1e-12)
