"""Writing of files: complete or not at all."""

import contextlib
import json
import os
from pathlib import Path
from typing import Any

from roomlight.errors import OutputError


def write_atomic(path: Path, data: bytes) -> None:
    """Write bytes under a temporary name, then rename: a reader never sees half a file. Makes missing folders.

    Raises:
        OutputError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):  # the temporary file may not exist
            temporary.unlink()
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error


def write_durable(path: Path, data: bytes) -> None:
    """Write bytes that survive a loss of power, readable by this user only (0600); otherwise as `write_atomic`.

    The folder must exist.

    Raises:
        OutputError: the file cannot be written; a file that was there is unchanged.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.unlink(missing_ok=True)
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):  # the temporary file may not exist
            temporary.unlink()
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error


def sync_folder(folder: Path) -> None:
    """Write a folder's list of names to the disk; does nothing on Windows, which cannot."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write plain JSON values, indented, as `write_atomic` does.

    Raises:
        OutputError: the file cannot be written.
    """
    write_atomic(path, (json.dumps(values, indent=1) + "\n").encode())
