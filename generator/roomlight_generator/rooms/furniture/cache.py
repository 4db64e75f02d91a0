"""One compact file with all usable models of some libraries: read fast, copied to another machine whole.

Layout: 8 bytes of magic with the version, the header's length (u32) and SHA-256, the header (JSON, zlib), then the
pieces it lists by offset, length and CRC-32: packed meshes (`packing`) and JPEG textures. Meshes are read and decoded
one by one when first asked for; the header alone tells the planner all it needs.
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
from roomlight_generator.rooms.furniture.packing import pack_mesh, unpack_mesh
from roomlight_generator.rooms.furniture.surfaces import Surface, SurfaceKind
from roomlight_generator.rooms.furniture_model import FurnitureModel, LightSource
from roomlight_generator.rooms.scene import Mesh, Texture

VERSION: Final = 3

_MAGIC: Final = b"RLFURN%02d" % VERSION
_FAMILY: Final = b"RLFURN"
_HEAD: Final = struct.Struct("<I32s")
_QUALITY: Final = 84
"""JPEG quality: the largest third of the file is textures, which are seen from metres away."""

_MAX_FILE_BYTES: Final = 1 << 30


@dataclass(frozen=True, eq=False)
class StoredModel:
    """A model of a cache: `model.split` is not decided yet (it depends on what else there is)."""

    model: FurnitureModel
    shared: tuple[str, ...]


@dataclass(eq=False)
class CacheWriter:
    """Collects models and surfaces, then writes them as one file."""

    _pieces: list[bytes] = field(default_factory=list[bytes])
    _textures: dict[bytes, int] = field(default_factory=dict[bytes, int])
    _numbers: dict[int, tuple[Texture, int]] = field(default_factory=dict[int, tuple[Texture, int]])
    _models: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    _surfaces: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])

    def add(self, model: FurnitureModel, mesh: Mesh, shared: tuple[str, ...]) -> None:
        """A model; `shared` are digests of its geometry and textures (`splits.assign_splits`)."""
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

    def add_surface(self, surface: Surface) -> None:
        """A wall or floor texture."""
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
        """The file, whole or not at all (two processes may write it at once). OutputError where it cannot be."""
        table: list[list[int]] = []
        offset = 0
        for piece in self._pieces:
            table.append([offset, len(piece), zlib.crc32(piece)])
            offset += len(piece)
        header = {"pieces": table, "bytes": offset, "models": self._models, "surfaces": self._surfaces}
        text = zlib.compress(json.dumps(header, separators=(",", ":")).encode(), 9)
        head = _MAGIC + _HEAD.pack(len(text), hashlib.sha256(text).digest())
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(b"".join([head, text, *self._pieces]))
            temporary.replace(path)
        except OSError as error:
            with contextlib.suppress(OSError):  # it may never have been made
                temporary.unlink()
            raise OutputError(f"{path}: the furniture cache cannot be written ({error.strerror or error})") from error

    def _append(self, piece: bytes) -> int:
        self._pieces.append(piece)
        return len(self._pieces) - 1

    def _texture_number(self, texture: Texture) -> int:
        # The texture itself is kept too, so that its id stays its own.
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
    piece: int

    def __call__(self) -> Mesh:
        """The mesh. FurnitureError when the file has been damaged since it was opened."""
        return self.cache.mesh(self.piece)


class Cache:
    """An open cache file; its header is in memory, its pieces are read as they are asked for."""

    def __init__(self, path: Path) -> None:
        """FurnitureError, naming the file, when it is missing, foreign, of another version or damaged."""
        self.path: Final = path
        try:
            with path.open("rb") as file:
                head = file.read(len(_MAGIC) + _HEAD.size)
                if not head.startswith(_MAGIC):
                    raise FurnitureError(_foreign(path, head))
                if len(head) < len(_MAGIC) + _HEAD.size:
                    raise FurnitureError(f"{path}: the furniture cache is cut short; delete it to have it made anew")
                length, digest = _HEAD.unpack_from(head, len(_MAGIC))
                text = file.read(min(length, _MAX_FILE_BYTES))
            size = path.stat().st_size
        except OSError as error:
            raise FurnitureError(f"{path}: cannot be read ({error.strerror or error})") from error
        if hashlib.sha256(text).digest() != digest:
            raise FurnitureError(f"{path}: the furniture cache is damaged; delete it to have it made anew")
        header = cast(dict[str, Any], json.loads(zlib.decompress(text)))
        self._start = len(head) + length
        self._pieces = cast(list[list[int]], header["pieces"])
        if size != self._start + header["bytes"]:
            raise FurnitureError(f"{path}: the furniture cache is cut short; delete it to have it made anew")
        self._models = cast(list[dict[str, Any]], header["models"])
        self._surfaces = cast(list[dict[str, Any]], header["surfaces"])
        self._textures: WeakValueDictionary[int, Texture] = WeakValueDictionary()

    def models(self) -> list[StoredModel]:
        """All models, in the order in which they were stored."""
        return [
            StoredModel(_model(record, StoredMesh(self, int(record["at"]))), tuple(record["shared"]))
            for record in self._models
        ]

    def surfaces(self) -> list[Surface]:
        """All wall and floor textures; decodes them."""
        return [
            Surface(
                record["id"],
                cast(SurfaceKind, record["kind"]),
                Texture(self.texture(record["texture"]).image, (float(record["size"][0]), float(record["size"][1]))),
                record["by"],
            )
            for record in self._surfaces
        ]

    def mesh(self, piece: int) -> Mesh:
        """A model's mesh by the number of its piece."""
        return unpack_mesh(self._read(piece), self.texture, f"{self.path}: piece {piece}")

    def texture(self, piece: int) -> Texture:
        """A texture by the number of its piece; the same object as long as anyone holds it."""
        found = self._textures.get(piece)
        if found is None:
            pixels = cv2.imdecode(np.frombuffer(self._read(piece), np.uint8), cv2.IMREAD_COLOR)
            if pixels is None:
                raise FurnitureError(f"{self.path}: piece {piece} is no picture; delete the cache to have it made anew")
            found = self._textures[piece] = Texture(np.ascontiguousarray(np.asarray(pixels, np.uint8)[..., ::-1]))
        return found

    def __getstate__(self) -> Mapping[str, Any]:
        """Without its textures: they are read anew in another process."""
        return {**self.__dict__, "_textures": None}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """As it was, with no texture read yet."""
        self.__dict__.update(state)
        self._textures = WeakValueDictionary()

    def _read(self, piece: int) -> bytes:
        offset, length, checksum = self._pieces[piece]
        try:
            with self.path.open("rb") as file:
                file.seek(self._start + offset)
                data = file.read(length)
        except OSError as error:
            raise FurnitureError(f"{self.path}: cannot be read ({error.strerror or error})") from error
        if zlib.crc32(data) != checksum:
            raise FurnitureError(
                f"{self.path}: piece {piece} of the furniture cache is damaged; delete it to have it made anew"
            )
        return data


def is_cache(path: Path) -> bool:
    """Whether the file begins as a furniture cache of any version does."""
    try:
        with path.open("rb") as file:
            return file.read(len(_FAMILY)) == _FAMILY
    except OSError:
        return False


def _foreign(path: Path, head: bytes) -> str:
    if head.startswith(_FAMILY):
        version = head[len(_FAMILY) : len(_MAGIC)].decode("ascii", "replace")
        return f"{path}: a furniture cache of version {version}, this reads version {VERSION:02d}; make it anew"
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
