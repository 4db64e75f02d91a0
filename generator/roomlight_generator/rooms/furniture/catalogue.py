"""The furniture that rooms are made of, by role and split, from wherever it is found."""

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
from roomlight_generator.rooms.furniture.build import SUFFIXES, Progress, build_cache
from roomlight_generator.rooms.furniture.cache import VERSION, Cache, is_cache
from roomlight_generator.rooms.furniture.sh3f import Warn
from roomlight_generator.rooms.furniture.splits import assign_splits
from roomlight_generator.rooms.furniture.surfaces import Surface, SurfaceKind
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.scene import Texture

ENVIRONMENT: Final = "ROOMLIGHT_FURNITURE"
"""Names a cache file, a library or a folder of them, used where no path is given."""

INSTALLED: Final = Path("/usr/share/sweethome3d")
"""Where Debian's packages sweethome3d-furniture and sweethome3d put their libraries and textures."""

PROCEDURAL_SHARE: Final = 0.2
"""How often a procedural model is taken though the library has fitting ones: mixing widens what networks see."""


@dataclass(frozen=True, eq=False)
class Catalogue:
    """Models by role and split; `extra` are procedural ones, which fill gaps and are mixed in now and then."""

    library: tuple[FurnitureModel, ...] = ()
    library_surfaces: tuple[tuple[Surface, Split], ...] = ()
    extra: tuple[FurnitureModel, ...] = ()
    _by_role: dict[tuple[str, Split], tuple[list[FurnitureModel], list[FurnitureModel]]] = field(
        init=False,
        repr=False,
        default_factory=dict[tuple[str, Split], tuple[list[FurnitureModel], list[FurnitureModel]]],
    )

    def __post_init__(self) -> None:
        """Sort the models into their drawers."""
        for place, models in enumerate((self.library, self.extra)):
            for model in models:
                self._by_role.setdefault((model.role, model.split), ([], []))[place].append(model)

    def models(self, role: str, split: Split) -> list[FurnitureModel]:
        """All models of a role that rooms of this split may use, the library's first."""
        library, extra = self._by_role.get((role, split), ([], []))
        return [*library, *extra]

    def choose(
        self,
        role: str,
        split: Split,
        rng: np.random.Generator,
        *,
        fits: Callable[[FurnitureModel], bool] | None = None,
        max_width_m: float = np.inf,
        procedural: float = PROCEDURAL_SHARE,
    ) -> FurnitureModel | None:
        """A model of that role that fits, or None. `procedural` is the chance that a procedural one is preferred.

        The same number of random values is drawn whatever fits.
        """
        library, extra = (
            [model for model in models if model.width_m <= max_width_m and (fits is None or fits(model))]
            for models in self._by_role.get((role, split), ([], []))
        )
        prefer_extra, place = rng.random(2)
        chosen = extra if (extra and prefer_extra < procedural) or not library else library
        return chosen[min(int(place * len(chosen)), len(chosen) - 1)] if chosen else None

    def surfaces(self, kind: SurfaceKind, split: Split) -> list[Texture]:
        """Wall or floor textures of the library with their physical size; none where there is no texture library."""
        return [surface.texture for surface, own in self.library_surfaces if surface.kind == kind and own == split]

    @property
    def attributions(self) -> list[str]:
        """Who made the models and the surfaces, each once."""
        found = {model.attribution for model in (*self.library, *self.extra)}
        found |= {surface.attribution for surface, _ in self.library_surfaces}
        return sorted(text for text in found if text)

    def joined(self, models: Sequence[FurnitureModel]) -> "Catalogue":
        """This catalogue with procedural models besides those it has."""
        return Catalogue(self.library, self.library_surfaces, (*self.extra, *models))


def load_catalogue(path: Path | None = None, *, warn: Warn, progress: Progress | None = None) -> Catalogue:
    """The furniture library: of a cache file, a `.sh3f` file, or a folder of such.

    Without a path, what the variable ROOMLIGHT_FURNITURE names, or else Debian's installed libraries. Libraries are
    made into a cache file in the user's cache folder once; a damaged one is made anew with a warning. Where nothing is
    installed the catalogue is empty, and `warn` is told what to do about it. FurnitureError where what was named
    cannot be used.
    """
    named = path if path is not None else named_library()
    if named is not None and is_cache(named):
        return catalogue_of(Cache(named))
    sources = library_files(named) if named is not None else installed_libraries()
    if not sources:
        warn(
            "no furniture library is installed: rooms are furnished with procedural models only. "
            "`apt install sweethome3d-furniture` brings 820 models (or set "
            f"{ENVIRONMENT} to a .sh3f file, a folder of them or a furniture cache)"
        )
        return Catalogue()
    return catalogue_of(_cached(sources, warn, progress))


def catalogue_of(cache: Cache) -> Catalogue:
    """All models of a cache, divided into splits."""
    stored = cache.models()
    splits = assign_splits(
        {one.model.id: one.model.role for one in stored}, {one.model.id: one.shared for one in stored}
    )
    surfaces = cache.surfaces()
    by_id = assign_splits({surface.id: surface.kind for surface in surfaces}, {})
    return Catalogue(
        library=tuple(replace(one.model, split=splits[one.model.id]) for one in stored),
        library_surfaces=tuple((surface, by_id[surface.id]) for surface in surfaces),
    )


def library_files(path: Path) -> list[Path]:
    """The libraries that a path names: itself, or those in the folder. FurnitureError where there are none."""
    if path.is_dir():
        found = sorted(one for one in path.iterdir() if one.suffix.lower() in SUFFIXES)
        if not found:
            raise FurnitureError(f"{path}: has no furniture library in it ({', '.join(SUFFIXES)})")
        return found
    if not path.exists():
        raise FurnitureError(f"{path}: there is no such file or folder")
    return [path]


def named_library() -> Path | None:
    """What the variable ROOMLIGHT_FURNITURE names, if it is set."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else None


def installed_libraries(root: Path | None = None) -> list[Path]:
    """The libraries of Debian's packages, and Sweet Home 3D's own textures where they are installed too."""
    root = root or INSTALLED
    found = sorted((root / "furniture").glob("*.sh3f"))
    jar = root / "sweethome3d.jar"
    return [*found, jar] if found and jar.exists() else found


def _cached(sources: Sequence[Path], warn: Warn, progress: Progress | None) -> Cache:
    path = cache_folder() / f"furniture-{_key(sources)}.rlf"
    if path.exists():
        try:
            return Cache(path)
        except FurnitureError as error:
            warn(f"{error}; making it anew")
    try:
        build_cache(sources, path, warn=warn, progress=progress)
    except OutputError as error:
        path = Path(tempfile.mkdtemp(prefix="roomlight-furniture-")) / path.name
        warn(f"{error}; it goes to {path} instead")
        build_cache(sources, path, warn=warn, progress=progress)
    return Cache(path)


def cache_folder() -> Path:
    """Where caches are kept: `roomlight` in XDG_CACHE_HOME or ~/.cache."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "roomlight"


def _key(sources: Sequence[Path]) -> str:
    """Changes with the files and with how they are read."""
    parts = [f"{VERSION}"]
    for source in sources:
        try:
            status = source.stat()
        except OSError as error:
            raise FurnitureError(f"{source}: cannot be read ({error.strerror or error})") from error
        parts.append(f"{source.resolve()} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
