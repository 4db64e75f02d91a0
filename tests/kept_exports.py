"""Models that tests export: once for all workers, and kept for later runs while the sources that make them stay."""

import hashlib
import inspect
import shutil
import threading
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path

from filelock import FileLock

ROOT = Path(__file__).parent.parent
SOURCES = ("core/roomlight/engine/networks", "export/roomlight_export", "model/roomlight_model")
BUILTINS = threading.Lock()
"""Held while PyTorch exports, which replaces `max` and `min` in the whole process, and while a server's threads compile
kernels, which would fail for good with those."""


def kept_export(name: str, build: Callable[[Path], object] | partial[object]) -> Path:
    """Return the folder that `build` fills; tests must not change it."""
    folder = ROOT / ".pytest_cache" / "exports" / f"{name}-{_digest(build)}"
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(folder.with_name(f"{name}.lock")):
        if not folder.exists():
            for old in folder.parent.glob(f"{name}-*"):
                shutil.rmtree(old)
            unfinished = folder.with_name(f"{name}-unfinished")
            unfinished.mkdir()
            with BUILTINS:
                build(unfinished)
            unfinished.rename(folder)
    return folder


def _digest(build: Callable[[Path], object] | partial[object]) -> str:
    digest = hashlib.sha256(f"{version('torch')} {version('onnx')} {version('onnxscript')}".encode())
    for path in sorted(path for source in SOURCES for path in (ROOT / source).rglob("*.py")):
        digest.update(path.read_bytes())
    maker = build.func if isinstance(build, partial) else build
    digest.update(Path(inspect.getfile(maker)).read_bytes())
    return digest.hexdigest()[:16]
