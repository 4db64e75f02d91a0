"""A value that may be None, and is not."""

from typing import TypeVar

T = TypeVar("T")


def present(value: T | None) -> T:
    """Return the value; the test fails if it is None."""
    assert value is not None
    return value
