"""The checker of annotations in the test run: beartype, made for a function at its first call.

Beartype writes code for each function. The project has four thousand, twice each under jaxtyping, and a worker calls
few of them: made when they are decorated, the checks took two fifths of a worker's start.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from beartype import beartype

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def checked_when_called(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return the function with its annotations checked by beartype."""
    checked: Callable[Parameters, Result] | None = None

    @functools.wraps(function)
    def wrapper(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        nonlocal checked
        if checked is None:
            checked = beartype(function)
        return checked(*args, **kwargs)

    return wrapper
