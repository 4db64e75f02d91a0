"""Public functions, and classes that users make, have an example in their docstrings, and the examples run."""

import doctest
import inspect

import pytest

import roomlight as rl

FUNCTIONS = [name for name in rl.__all__ if inspect.isfunction(getattr(rl, name))]
CLASSES = ["Compositor", "CubeMap", "Frame", "Intrinsics", "Light", "MainLight", "Session", "SphericalHarmonics"]


@pytest.mark.parametrize("name", [*FUNCTIONS, *CLASSES])
def test_the_example_runs(name):
    public = getattr(rl, name)
    (example,) = doctest.DocTestFinder(recurse=False).find(public, name, globs={})
    assert example.examples, f"{name} has no example"
    report: list[str] = []
    result = doctest.DocTestRunner().run(example, out=report.append)
    assert result.failed == 0, "".join(report)
