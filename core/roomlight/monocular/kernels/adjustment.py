# pyright: reportMissingParameterType=false
"""Normal equations of a bundle adjustment; a readable twin is in `reference`."""

from numba import njit

from roomlight.kernels.common import KERNEL


@njit(**KERNEL)
def add_reduced(first, columns, jacobian, coupling, curvature, error, pull, system, right):
    """Add sightings to the normal equations, and take away what the landmarks' own steps explain (Schur complement).

    Args:
        first: First sighting of each landmark, and the number of sightings [k + 1].
        columns: Unknowns on which each sighting depends [m, c].
        jacobian: Derivatives of its pixel by them [m, 2, c].
        coupling: Second derivatives of the cost by them and by its landmark [m, c].
        curvature: Of the cost, by each landmark [k].
        error: Of each sighting's pixel [m, 2].
        pull: Negative derivative of the cost by each landmark [k].
        system, right: Changed [p, p], [p].
    """
    count = columns.shape[1]
    for mark in range(len(curvature)):
        # 1. What a step of this landmark makes up for, by the unit of its coupling
        eased = 1 / curvature[mark]
        for own in range(first[mark], first[mark + 1]):
            for i in range(count):
                row, share = columns[own, i], coupling[own, i] * eased
                right[row] -= jacobian[own, 0, i] * error[own, 0] + jacobian[own, 1, i] * error[own, 1]
                right[row] -= share * pull[mark]
                # 2. The sighting's own products
                for j in range(count):
                    product = jacobian[own, 0, i] * jacobian[own, 0, j] + jacobian[own, 1, i] * jacobian[own, 1, j]
                    system[row, columns[own, j]] += product
                # 3. Less those of all sightings of the landmark
                for other in range(first[mark], first[mark + 1]):
                    for j in range(count):
                        system[row, columns[other, j]] -= share * coupling[other, j]
