"""Writing of files: complete or not at all."""

import contextlib
import json
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


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write plain JSON values, indented, as `write_atomic` does.

    Raises:
        OutputError: the file cannot be written.
    """
    write_atomic(path, (json.dumps(values, indent=1) + "\n").encode())
