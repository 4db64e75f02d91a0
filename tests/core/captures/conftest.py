"""Captures that a test may damage, and those that it may not."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import formats
import pytest
from builders import BUILDERS


@pytest.fixture
def transforms(tmp_path: Path) -> Path:
    return formats.nerfstudio(tmp_path / "capture", formats.scene())


@pytest.fixture
def native(tmp_path: Path) -> Path:
    return formats.roomlight(tmp_path / "capture", formats.scene())


@pytest.fixture
def stray(tmp_path: Path) -> Path:
    return formats.stray_scanner(tmp_path / "capture", formats.scene())


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Build a capture of a layout, once: to be read, or to be copied."""
    root = tmp_path_factory.mktemp("whole")
    return cache(lambda name: BUILDERS[name](root / name / "capture", formats.scene()))


@pytest.fixture(params=BUILDERS)
def built(request: pytest.FixtureRequest, whole: Callable[[str], Path]) -> tuple[str, Path]:
    """A layout's name and a capture of it, to be read alone."""
    return request.param, whole(request.param)
