"""Calls, from Python, of functions that kernels alone call."""

from collections.abc import Callable
from functools import cache
from typing import Any

from numba import njit


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a kernel that does nothing but call a function that has no entry for Python."""
    return njit(lambda *arguments: function(*arguments))
