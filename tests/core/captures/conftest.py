"""Captures that a test may damage."""

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


@pytest.fixture(params=BUILDERS)
def built(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, Path]:
    return request.param, BUILDERS[request.param](tmp_path / "capture", formats.scene())
