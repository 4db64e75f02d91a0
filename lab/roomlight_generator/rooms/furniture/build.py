"""Build a furniture cache from libraries: models read, classified, simplified, measured; damaged ones left out."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from roomlight.errors import FurnitureError
from roomlight_generator.rooms.furniture.assemble import build_mesh
from roomlight_generator.rooms.furniture.cache import CacheWriter
from roomlight_generator.rooms.furniture.classify import elevation_m, has_surface, role_of
from roomlight_generator.rooms.furniture.exceptions import LIGHT_OFFSETS_M
from roomlight_generator.rooms.furniture.files.archive import Archive
from roomlight_generator.rooms.furniture.files.sh3f import LibraryEntry, WarningCallback, read_entries
from roomlight_generator.rooms.furniture.support_height import measure_top_m
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.scene import Mesh

ProgressCallback = Callable[[int, int], None]
"""Called with the number of finished models and their total number."""

SUFFIX: Final = ".sh3f"
"""Of furniture libraries."""


def build_cache(
    sources: Sequence[Path], out: Path, *, warn: WarningCallback, progress: ProgressCallback | None = None
) -> None:
    """Write a cache file from libraries (one to two minutes for the five of Debian, on one core).

    A model that cannot be read, or whose id was in an earlier library, is left out with a warning.

    Raises:
        FurnitureError: a source is not a library, or the sources contain no models.
        OutputError: `out` cannot be written.
    """
    writer = CacheWriter()
    entries: list[tuple[Path, LibraryEntry, str]] = []
    known: set[str] = set()
    for source in sources:
        with Archive(source) as archive:
            for entry in read_entries(archive, warn):
                role = role_of(entry)
                if entry.id in known:
                    warn(f"{source}: model {entry.id!r} is also in an earlier library; left out")
                elif role is not None:
                    entries.append((source, entry, role))
                known.add(entry.id)
    if not entries:
        raise FurnitureError(f"no furniture in {', '.join(map(str, sources)) or 'no files'}")
    done = 0
    for source in sources:
        chosen = [(entry, role) for path, entry, role in entries if path == source]
        if not chosen:
            continue
        with Archive(source) as archive:
            for entry, role in chosen:
                try:
                    _add(writer, archive, entry, role, warn)
                except FurnitureError as error:
                    warn(f"{error}; model {entry.id!r} is left out")
                done += 1
                if progress is not None:
                    progress(done, len(entries))
    writer.write(out)


def _add(writer: CacheWriter, archive: Archive, entry: LibraryEntry, role: str, warn: WarningCallback) -> None:
    mesh = build_mesh(archive, entry, role=role, warn=warn)
    extent = mesh.bounds()[1] - mesh.bounds()[0]
    way = np.array(LIGHT_OFFSETS_M.get(entry.id, (0, 0, 0)), np.float32)
    model = FurnitureModel(
        id=entry.id,
        name=entry.name,
        role=role,
        split="train",
        width_m=float(extent[0]),
        height_m=entry.height_m,
        depth_m=float(extent[2]),
        load=lambda: mesh,
        elevation_m=elevation_m(role, entry),
        top_m=measure_top_m(mesh, listed_m=entry.drop_top_m) if has_surface(role, entry) else None,
        lights=tuple(replace(light, position=light.position + way) for light in entry.lights),
        attribution=entry.attribution,
    )
    writer.add(model, mesh, _digests(archive, entry, mesh))


def _digests(archive: Archive, entry: LibraryEntry, mesh: Mesh) -> tuple[str, ...]:
    """Return digests of what a model may share with others: its geometry file and its images."""
    images = {hashlib.sha256(m.texture.image.tobytes()).hexdigest()[:12] for m in mesh.materials if m.texture}
    return (hashlib.sha256(archive.read(entry.member)).hexdigest()[:12], *sorted(images))
