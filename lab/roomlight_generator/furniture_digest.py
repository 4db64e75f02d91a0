"""The furniture's digest, which identifies the models with which a dataset was made."""

import hashlib
from pathlib import Path

from roomlight.errors import DatasetError
from roomlight_generator.rooms.furniture.catalogue import installed_libraries, named_library


def furniture_digest(furniture: Path | None) -> str | None:
    """Return the SHA-256 of the furniture: of a file, or of all files of a folder with their names.

    Without a path, of the library that `rooms.furniture.load_catalogue` would load, or None if there is none.

    Raises:
        DatasetError: if the file does not exist, the folder holds no file, or they cannot be read.
    """
    root = furniture if furniture is not None else named_library()
    try:
        if root is None:
            return _digest_of({path.name: path for path in installed_libraries()})
        if root.is_file():
            return hashlib.sha256(root.read_bytes()).hexdigest()
        combined = _digest_of({str(path.relative_to(root)): path for path in root.rglob("*") if path.is_file()})
    except OSError as error:
        raise DatasetError(f"{root or 'furniture'}: cannot be read ({error.strerror or error})") from error
    if combined is None:
        raise DatasetError(f"{root}: there is no such file, or no file in it; name a furniture library or cache")
    return combined


def _digest_of(files: dict[str, Path]) -> str | None:
    if not files:
        return None
    sha = hashlib.sha256()
    for name, path in sorted(files.items()):
        sha.update(f"{name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return sha.hexdigest()
