"""Create a model folder atomically: it is written under a hidden name beside its place, then renamed."""

import json
import shutil
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from roomlight.engine.networks.graphs import DESCRIPTION
from roomlight.errors import OutputError


def check_target(out: Path) -> None:
    """Check, before any work, that a model folder can be written here: only an empty or a model folder is replaced.

    Raises:
        OutputError: The path is a file, or a folder with other content.
    """
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out}: is a file; give the name of a folder for the model")
    if out.is_dir() and any(out.iterdir()) and not _is_model(out):
        raise OutputError(f"{out}: holds other files than a model's; choose a new folder")


@contextmanager
def new_folder(out: Path) -> Generator[Path]:
    """Yield a temporary folder beside `out` that replaces it at the end of the block; an exception removes it.

    Raises:
        OutputError: The folder cannot be written, or `out` has become a folder with other content.
    """
    target = out.absolute()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror or error})") from error
    try:
        yield temporary
        temporary.chmod(0o755)  # mkdtemp's folder is for its owner only; a server may be another user
        _take_place(temporary, target)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _take_place(temporary: Path, target: Path) -> None:
    if not target.exists():
        temporary.rename(target)
        return
    check_target(target)  # it may have changed in the meantime
    old = temporary.with_suffix(".old")
    target.rename(old)
    try:
        temporary.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _is_model(folder: Path) -> bool:
    try:
        described = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(described, dict) and "graphs" in described
