"""The furniture models available to rooms, by role and split."""

import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from roomlight.dataset.recording import Split
from roomlight.errors import FurnitureError, OutputError
from roomlight_generator.rooms.furniture.build import SUFFIX, build_cache
from roomlight_generator.rooms.furniture.cache import VERSION, Cache, is_cache
from roomlight_generator.rooms.furniture.files.sh3f import WarningCallback
from roomlight_generator.rooms.furniture.splits import assign_splits
from roomlight_generator.rooms.furniture_model import FurnitureModel

ENVIRONMENT_VARIABLE: Final = "ROOMLIGHT_FURNITURE"
"""Environment variable with a cache file, a library or a folder of libraries, used if no path is given."""

INSTALLED_FOLDER: Final = Path("/usr/share/sweethome3d")
"""Folder where Debian's package sweethome3d-furniture installs its libraries."""


@dataclass(frozen=True, eq=False)
class Catalogue:
    """Models by role and split; the `fallbacks` are used where the library has none that fits."""

    library: tuple[FurnitureModel, ...] = ()
    fallbacks: tuple[FurnitureModel, ...] = ()
    _by_role: dict[tuple[str, Split], tuple[list[FurnitureModel], list[FurnitureModel]]] = field(
        init=False,
        repr=False,
        default_factory=dict[tuple[str, Split], tuple[list[FurnitureModel], list[FurnitureModel]]],
    )

    def __post_init__(self) -> None:
        for place, models in enumerate((self.library, self.fallbacks)):
            for model in models:
                self._by_role.setdefault((model.role, model.split), ([], []))[place].append(model)

    def choose(
        self, role: str, split: Split, rng: np.random.Generator, *, fits: Callable[[FurnitureModel], bool] | None = None
    ) -> FurnitureModel | None:
        """Choose a model that `fits` accepts (None: any); a fallback only without such a model of the library.

        The number of random values drawn does not depend on which models fit. None is returned if no model fits.
        """
        library, fallbacks = (
            [model for model in models if fits is None or fits(model)]
            for models in self._by_role.get((role, split), ([], []))
        )
        place = rng.random()
        chosen = library or fallbacks
        return chosen[min(int(place * len(chosen)), len(chosen) - 1)] if chosen else None


def load_catalogue(path: Path | None = None, *, warn: WarningCallback) -> Catalogue:
    """Load the furniture library from a cache file, a `.sh3f` file, or a folder of them.

    Without a path, the variable ROOMLIGHT_FURNITURE names the library; if it is unset, Debian's installed libraries are
    used. Libraries are converted once to a cache file in the user's cache folder; a damaged cache is rebuilt with a
    warning. If nothing is installed the catalogue is empty, and `warn` is called with instructions.

    Raises:
        FurnitureError: the given or named library cannot be used.
    """
    named = path if path is not None else named_library()
    if named is not None and is_cache(named):
        return _divided(Cache(named))
    sources = library_files(named) if named is not None else installed_libraries()
    if not sources:
        warn(
            "no furniture library is installed: rooms have a few plain pieces of furniture only. "
            "`apt install sweethome3d-furniture` brings 820 models (or set "
            f"{ENVIRONMENT_VARIABLE} to a .sh3f file, a folder of them or a furniture cache)"
        )
        return Catalogue()
    return _divided(_open_or_build_cache(sources, warn))


def _divided(cache: Cache) -> Catalogue:
    """Return all models of a cache, divided into splits."""
    stored = cache.models()
    splits = assign_splits(
        {model.id: model.role for model, _ in stored}, {model.id: shared for model, shared in stored}
    )
    return Catalogue(library=tuple(replace(model, split=splits[model.id]) for model, _ in stored))


def library_files(path: Path) -> list[Path]:
    """Return the path itself, or the libraries in the folder.

    Raises:
        FurnitureError: the path does not exist, or the folder has no libraries.
    """
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() == SUFFIX)
        if not files:
            raise FurnitureError(f"{path}: has no furniture library in it (*{SUFFIX})")
        return files
    if not path.exists():
        raise FurnitureError(f"{path}: no such file or folder")
    return [path]


def named_library() -> Path | None:
    """Return the path in the variable ROOMLIGHT_FURNITURE, if it is set."""
    named = os.environ.get(ENVIRONMENT_VARIABLE)
    return Path(named) if named else None


def installed_libraries() -> list[Path]:
    """Return the libraries of Debian's packages."""
    return sorted((INSTALLED_FOLDER / "furniture").glob("*.sh3f"))


def _open_or_build_cache(sources: Sequence[Path], warn: WarningCallback) -> Cache:
    path = cache_folder() / f"furniture-{_key(sources)}.rlf"
    if path.exists():
        try:
            return Cache(path)
        except FurnitureError as error:
            warn(f"{error}; rebuilding it")
    try:
        build_cache(sources, path, warn=warn)
    except OutputError as error:
        path = Path(tempfile.mkdtemp(prefix="roomlight-furniture-")) / path.name
        warn(f"{error}; writing it to {path} instead")
        build_cache(sources, path, warn=warn)
    return Cache(path)


def cache_folder() -> Path:
    """Return the cache folder: `roomlight` in XDG_CACHE_HOME or ~/.cache."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "roomlight"


def _key(sources: Sequence[Path]) -> str:
    """Return a key that changes with the files and with the cache version."""
    parts = [f"{VERSION}"]
    for source in sources:
        try:
            status = source.stat()
        except OSError as error:
            raise FurnitureError(f"{source}: cannot be read ({error.strerror or error})") from error
        parts.append(f"{source.resolve()} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
