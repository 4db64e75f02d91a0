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
from functools import cache
from pathlib import Path
from typing import Any

import jaxtyping
import pytest
from filelock import FileLock
from hypothesis import HealthCheck, given, settings
from hypothesis.strategies import none
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

import shape_checks
from tiny_networks import FOLDER

# A busy machine makes examples too slowly for Hypothesis's limit on it.
_PATIENT = settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", _PATIENT, print_blob=True)
settings.register_profile("default", _PATIENT, max_examples=30)
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


def _compile_once() -> None:
    """Let workers compile each kernel once: the others wait for the first one's cache instead of doing the same."""
    locks, compile_alone = _ROOT / ".pytest_cache" / "kernels", Dispatcher.compile
    locks.mkdir(parents=True, exist_ok=True)

    @cache
    def lock(name: str) -> FileLock:
        return FileLock(locks / f"{name}.lock")

    def compile_once(self: Dispatcher, signature: Any) -> object:
        function = self.py_func
        # kernels call each other in one direction only: no two workers wait for each other
        with global_compiler_lock, lock(f"{function.__module__}.{function.__qualname__}"):
            return compile_alone(self, signature)

    pytest.MonkeyPatch().setattr(Dispatcher, "compile", compile_once)


_compile_once()

from roomlight.threads import core_count  # noqa: E402 - after the hook


def pytest_xdist_auto_num_workers() -> int:
    """Start a worker more than there are cores: for a fifth of the time tests wait, for sockets and for kernels."""
    return core_count() + 1


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Import without looking for garbage again and again among objects that stay: a seventh of a worker's start."""
    gc.disable()
    _nothing()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(100_000, 50, 100)  # tests leave little garbage: a twentieth of the whole run
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_report_teststatus(report: pytest.TestReport, config: pytest.Config) -> Generator[None, Any, Any]:
    """Name a failed test at once: a run that is ended from outside prints no summary."""
    category, letter, word = yield
    if report.failed and config.get_verbosity() < 1 and letter:
        crash = getattr(report.longrepr, "reprcrash", None)
        reason = " ".join((crash.message if crash else report.longreprtext).split())
        letter = f"\n{letter} {report.nodeid}: {reason[:400]}\n"
    return category, letter, word


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
def tiny_video() -> Path:
    """The model folder of `tiny_networks`; tests must not change it."""
    return FOLDER


@pytest.fixture
def untrained_video(tiny_video: Path, tmp_path: Path) -> Path:
    """A copy of the folder of `tiny_video` whose card says that its weights were never trained."""
    folder = shutil.copytree(tiny_video, tmp_path / "untrained")
    description = json.loads((folder / "model.json").read_text())
    description["card"]["steps"] = 0
    (folder / "model.json").write_text(json.dumps(description))
    return folder
