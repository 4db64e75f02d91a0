"""Captures that a test may damage."""

from pathlib import Path

import formats
import pytest


@pytest.fixture
def transforms(tmp_path: Path) -> Path:
    return formats.nerfstudio(tmp_path / "capture", formats.scene())


@pytest.fixture
def native(tmp_path: Path) -> Path:
    return formats.roomlight(tmp_path / "capture", formats.scene())


@pytest.fixture
def stray(tmp_path: Path) -> Path:
    return formats.stray_scanner(tmp_path / "capture", formats.scene())


@pytest.fixture(params=formats.BUILDERS)
def built(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, Path]:
    return request.param, formats.BUILDERS[request.param](tmp_path / "capture", formats.scene())
