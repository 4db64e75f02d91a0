"""The furniture's digest, which identifies the models with which a dataset was made."""

import hashlib
from pathlib import Path

from roomlight.errors import DatasetError
from roomlight_generator.panoramas.library import files_digest
from roomlight_generator.rooms.furniture.catalogue import installed_libraries, named_library


def furniture_digest(furniture: Path | None) -> str | None:
    """Return the SHA-256 of the furniture: of a file, or of all files of a folder with their names.

    Without a path, of the library that `rooms.furniture.load_catalogue` would load, or None if there is none.

    Raises:
        DatasetError: if the file does not exist, the folder holds no file, or they cannot be read.
    """
    root = furniture if furniture is not None else named_library()
    if root is None:
        files = {path.name: path for path in installed_libraries()}
        return files_digest(sorted(files.items())) if files else None
    try:
        if root.is_file():
            return hashlib.sha256(root.read_bytes()).hexdigest()
        files = {str(path.relative_to(root)): path for path in root.rglob("*") if path.is_file()}
    except OSError as error:
        raise DatasetError(f"{root}: cannot be read ({error.strerror or error})") from error
    if not files:
        raise DatasetError(f"{root}: there is no such file, or no file in it; name a furniture library or cache")
    return files_digest(sorted(files.items()))
