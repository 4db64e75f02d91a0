"""The test run checks array shapes: every annotated function of the project is wrapped by jaxtyping and beartype.

Installed before any import of the project. Packages called `kernels` are left out, because numba compiles their
functions from their own source and takes no wrapper. And networks that are tiny.
"""

import gc
import json
import os
import shutil
import sys
from collections.abc import Generator
from pathlib import Path

import jaxtyping
import pytest
from hypothesis import given, settings
from hypothesis.strategies import none

import shape_checks
from kept_exports import kept_export

settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.register_profile("default", deadline=None, derandomize=True, max_examples=30)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))

# The test networks are too small to share between threads, which wait for each other: 10 times the CPU time under load.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# `auto` would measure the runtimes, and results would depend on the machine's speed.
os.environ.setdefault("ROOMLIGHT_PROVIDER", "cpu")
# Some tests import ONNX Runtime themselves; see `roomlight.engine.networks.runtime`.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"

_ROOT = Path(__file__).parent.parent
# Containers often write no bytecode: each worker would compile tests and shape checks anew, 12 s of CPU time.
if sys.dont_write_bytecode:
    sys.dont_write_bytecode, sys.pycache_prefix = False, str(_ROOT / ".pytest_cache" / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
_SOURCES = [_ROOT / folder for folder in ("core", "model", "export", "server", "client", "lab", "cli")]


def _modules() -> list[str]:
    names: list[str] = []
    for source in _SOURCES:
        for path in sorted(source.rglob("*.py")):
            parts = path.relative_to(source).with_suffix("").parts
            if path.name != "__init__.py" and "kernels" not in parts:
                names.append(".".join(parts))
    return names


jaxtyping.jaxtyped = lambda *, typechecker: shape_checks.checked  # what the hook decorates with  # noqa: ARG005
jaxtyping.install_import_hook(_modules(), "shape_checks.checked")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Import without looking for garbage again and again among objects that stay: a seventh of a worker's start."""
    gc.disable()
    _nothing()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files whose tests state a time limit of their own: a long one at the end would run alone."""
    limits: dict[Path, float] = {}
    for item in items:
        mark = item.get_closest_marker("timeout")
        limits[item.path] = max(limits.get(item.path, 0.0), float(mark.args[0]) if mark else 0.0)
    items.sort(key=lambda item: -limits[item.path])


@given(none())
def _nothing(_: None) -> None:
    """Let Hypothesis register its random numbers, whose holders it does not find once they are frozen."""


@pytest.fixture(scope="session")
def tiny_video() -> tuple[Path, Path]:
    """A small video model (checkpoint, model folder).

    Its card states one step of training. It holds the single-view graphs too: volumes of 16 x 15 x 21 voxels, panoramas
    of 32 rows.
    """
    folder = kept_export("tiny-video", _export_tiny_video)
    return folder / "video.pt", folder / "video"


def _export_tiny_video(folder: Path) -> None:
    from roomlight_export.exporting import export_checkpoint
    from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
    from untrained import save_untrained

    config = ModelConfig(
        sg=SGConfig(volume_shape=(16, 15, 21), channels=4, full_channels=4),
        blend=BlendConfig(height=32, channels=4, full_channels=4),
    )
    save_untrained(folder / "video.pt", "video", config, seed=3)
    export_checkpoint(folder / "video.pt", folder / "video", ort=False)
    _state_steps(folder / "video", 1)


@pytest.fixture
def untrained_video(tiny_video: tuple[Path, Path], tmp_path: Path) -> Path:
    """A copy of the folder of `tiny_video` whose card says that its weights were never trained."""
    folder = shutil.copytree(tiny_video[1], tmp_path / "untrained")
    _state_steps(folder, 0)
    return folder


def _state_steps(folder: Path, steps: int) -> None:
    description = json.loads((folder / "model.json").read_text())
    description["card"]["steps"] = steps
    (folder / "model.json").write_text(json.dumps(description))
