"""One compact file with all usable models of some libraries: fast to read, and portable between machines.

Format: 8 bytes of magic with the version, the header's length (u32) and SHA-256, the header (JSON, zlib), then the
blobs it lists by offset, length and CRC-32: packed meshes (`packing`) and JPEG textures. Meshes are read and decoded
one by one on first access; the planner needs only the header.
"""

import contextlib
import hashlib
import json
import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, cast
from weakref import WeakValueDictionary

import cv2
import numpy as np

from roomlight.errors import FurnitureError, OutputError
from roomlight_generator.rooms.furniture.files.packing import pack_mesh, unpack_mesh
from roomlight_generator.rooms.furniture.files.surfaces import SurfaceKind, SurfaceTexture
from roomlight_generator.rooms.furniture_model import FurnitureModel, LightSource
from roomlight_generator.rooms.scene import Mesh, Texture

VERSION: Final = 3

_MAGIC: Final = b"RLFURN%02d" % VERSION
_FAMILY: Final = b"RLFURN"
_HEAD: Final = struct.Struct("<I32s")
_QUALITY: Final = 84
"""JPEG quality: textures are the largest third of the file, and are seen from metres away."""

_MAX_FILE_BYTES: Final = 1 << 30


@dataclass(frozen=True, eq=False)
class StoredModel:
    """A model of a cache. Its `model.split` is a placeholder: the split depends on all loaded models."""

    model: FurnitureModel
    shared: tuple[str, ...]


@dataclass(eq=False)
class CacheWriter:
    """Collects models and surface textures, then writes them as one file."""

    _blobs: list[bytes] = field(default_factory=list[bytes])
    _textures: dict[bytes, int] = field(default_factory=dict[bytes, int])
    _numbers: dict[int, tuple[Texture, int]] = field(default_factory=dict[int, tuple[Texture, int]])
    _models: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    _surfaces: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])

    def add(self, model: FurnitureModel, mesh: Mesh, shared: tuple[str, ...]) -> None:
        """Add a model.

        Args:
            model: The model.
            mesh: Its mesh.
            shared: Digests of its geometry and textures (`splits.assign_splits`).
        """
        self._models.append(
            {
                "id": model.id,
                "name": model.name,
                "role": model.role,
                "size": [round(value, 4) for value in (model.width_m, model.height_m, model.depth_m)],
                "elevation": round(model.elevation_m, 4),
                "top": None if model.top_m is None else round(model.top_m, 4),
                "lights": [
                    [
                        [round(float(value), 4) for value in light.position],
                        round(light.diameter_m, 4),
                        [round(value, 4) for value in light.colour],
                    ]
                    for light in model.lights
                ],
                "by": model.attribution,
                "shared": list(shared),
                "at": self._append(pack_mesh(mesh, self._texture_number)),
            }
        )

    def add_surface(self, surface: SurfaceTexture) -> None:
        """Add a wall or floor texture."""
        self._surfaces.append(
            {
                "id": surface.id,
                "kind": surface.kind,
                "texture": self._texture_number(surface.texture),
                "size": list(surface.texture.size_m),
                "by": surface.attribution,
            }
        )

    def write(self, path: Path) -> None:
        """Write the file atomically (two processes may write it at once).

        Raises:
            OutputError: the file cannot be written.
        """
        table: list[list[int]] = []
        offset = 0
        for blob in self._blobs:
            table.append([offset, len(blob), zlib.crc32(blob)])
            offset += len(blob)
        header = {"pieces": table, "bytes": offset, "models": self._models, "surfaces": self._surfaces}
        text = zlib.compress(json.dumps(header, separators=(",", ":")).encode(), 9)
        head = _MAGIC + _HEAD.pack(len(text), hashlib.sha256(text).digest())
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(b"".join([head, text, *self._blobs]))
            temporary.replace(path)
        except OSError as error:
            with contextlib.suppress(OSError):  # the file may not exist
                temporary.unlink()
            raise OutputError(f"{path}: the furniture cache cannot be written ({error.strerror or error})") from error

    def _append(self, blob: bytes) -> int:
        self._blobs.append(blob)
        return len(self._blobs) - 1

    def _texture_number(self, texture: Texture) -> int:
        # The texture itself is kept too, so that its id is not reused.
        known = self._numbers.get(id(texture))
        if known is None:
            bgr = np.ascontiguousarray(texture.image[..., ::-1])
            data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
            number = self._textures.get(data)
            if number is None:
                number = self._textures[data] = self._append(data)
            known = self._numbers[id(texture)] = (texture, number)
        return known[1]


@dataclass(frozen=True, eq=False)
class StoredMesh:
    """Reads one model's mesh from its cache when called."""

    cache: "Cache"
    blob: int

    def __call__(self) -> Mesh:
        """Read the mesh.

        Raises:
            FurnitureError: the file was damaged after it was opened.
        """
        return self.cache.mesh(self.blob)


class Cache:
    """An open cache file; its header is in memory, its blobs are read on access."""

    def __init__(self, path: Path) -> None:
        """Read the header.

        Raises:
            FurnitureError: the file is missing, damaged, of another version, or not a furniture cache.
        """
        self.path: Final = path
        try:
            with path.open("rb") as file:
                head = file.read(len(_MAGIC) + _HEAD.size)
                if not head.startswith(_MAGIC):
                    raise FurnitureError(_foreign(path, head))
                if len(head) < len(_MAGIC) + _HEAD.size:
                    raise FurnitureError(f"{path}: the furniture cache is truncated; delete it to rebuild it")
                length, digest = _HEAD.unpack_from(head, len(_MAGIC))
                text = file.read(min(length, _MAX_FILE_BYTES))
            size = path.stat().st_size
        except OSError as error:
            raise FurnitureError(f"{path}: cannot be read ({error.strerror or error})") from error
        if hashlib.sha256(text).digest() != digest:
            raise FurnitureError(f"{path}: the furniture cache is damaged; delete it to rebuild it")
        header = cast(dict[str, Any], json.loads(zlib.decompress(text)))
        self._start = len(head) + length
        self._blobs = cast(list[list[int]], header["pieces"])
        if size != self._start + header["bytes"]:
            raise FurnitureError(f"{path}: the furniture cache is truncated; delete it to rebuild it")
        self._models = cast(list[dict[str, Any]], header["models"])
        self._surfaces = cast(list[dict[str, Any]], header["surfaces"])
        self._textures: WeakValueDictionary[int, Texture] = WeakValueDictionary()

    def models(self) -> list[StoredModel]:
        """Return all models, in the order in which they were stored."""
        return [
            StoredModel(_model(record, StoredMesh(self, int(record["at"]))), tuple(record["shared"]))
            for record in self._models
        ]

    def surfaces(self) -> list[SurfaceTexture]:
        """Decode and return all wall and floor textures."""
        return [
            SurfaceTexture(
                record["id"],
                cast(SurfaceKind, record["kind"]),
                Texture(self.texture(record["texture"]).image, (float(record["size"][0]), float(record["size"][1]))),
                record["by"],
            )
            for record in self._surfaces
        ]

    def mesh(self, blob: int) -> Mesh:
        """Return the mesh in a blob.

        Raises:
            FurnitureError: the file is damaged.
        """
        return unpack_mesh(self._read(blob), self.texture, f"{self.path}: blob {blob}")

    def texture(self, blob: int) -> Texture:
        """Return the texture in a blob; the same object while it is referenced elsewhere.

        Raises:
            FurnitureError: the file is damaged.
        """
        texture = self._textures.get(blob)
        if texture is None:
            pixels = cv2.imdecode(np.frombuffer(self._read(blob), np.uint8), cv2.IMREAD_COLOR)
            if pixels is None:
                raise FurnitureError(f"{self.path}: blob {blob} is not an image; delete the cache to rebuild it")
            texture = self._textures[blob] = Texture(np.ascontiguousarray(np.asarray(pixels, np.uint8)[..., ::-1]))
        return texture

    def __getstate__(self) -> Mapping[str, Any]:
        """Return the state without textures: another process reads them again."""
        return {**self.__dict__, "_textures": None}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Restore the state with no texture loaded."""
        self.__dict__.update(state)
        self._textures = WeakValueDictionary()

    def _read(self, blob: int) -> bytes:
        offset, length, checksum = self._blobs[blob]
        try:
            with self.path.open("rb") as file:
                file.seek(self._start + offset)
                data = file.read(length)
        except OSError as error:
            raise FurnitureError(f"{self.path}: cannot be read ({error.strerror or error})") from error
        if zlib.crc32(data) != checksum:
            raise FurnitureError(f"{self.path}: blob {blob} of the furniture cache is damaged; delete it to rebuild it")
        return data


def is_cache(path: Path) -> bool:
    """Return whether the file starts like a furniture cache of any version."""
    try:
        with path.open("rb") as file:
            return file.read(len(_FAMILY)) == _FAMILY
    except OSError:
        return False


def _foreign(path: Path, head: bytes) -> str:
    if head.startswith(_FAMILY):
        version = head[len(_FAMILY) : len(_MAGIC)].decode("ascii", "replace")
        return (
            f"{path}: has furniture cache version {version}, but this release reads version {VERSION:02d}; rebuild it"
        )
    return f"{path}: is not a furniture cache (it starts with {head[:8].hex() or 'nothing'})"


def _model(record: dict[str, Any], load: StoredMesh) -> FurnitureModel:
    width, height, depth = (float(value) for value in record["size"])
    return FurnitureModel(
        id=record["id"],
        name=record["name"],
        role=record["role"],
        split="train",
        width_m=width,
        height_m=height,
        depth_m=depth,
        load=load,
        elevation_m=float(record["elevation"]),
        top_m=None if record["top"] is None else float(record["top"]),
        lights=tuple(
            LightSource(np.array(position, np.float32), float(diameter), (float(c[0]), float(c[1]), float(c[2])))
            for position, diameter, c in record["lights"]
        ),
        attribution=record["by"],
    )
