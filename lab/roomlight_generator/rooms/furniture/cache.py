"""One compact file with all usable models of some libraries: fast to read, and portable between machines.

A compressed NumPy archive (.npz): `models`, JSON of all models, then the arrays of each model's mesh, and textures as
JPEG. Meshes are read and decoded one by one on first access; the planner needs `models` only. Positions and texture
coordinates have 16 bits over their range (a 2 m sofa to 0.03 mm), normals 8 bits a component.
"""

import json
import os
import zipfile
import zlib
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, Final
from weakref import WeakValueDictionary

import cv2
import numpy as np
from jaxtyping import Float, UInt16

from roomlight.errors import FurnitureError
from roomlight.files import write_atomic
from roomlight_generator.rooms.furniture_model import FurnitureModel, LightSource
from roomlight_generator.rooms.scene import Material, Mesh, Rgb, Texture

VERSION: Final = 4

_INDEX: Final = "models"
_QUALITY: Final = 84
"""JPEG quality: textures are a large part of the file, and are seen from metres away."""
_STEPS: Final = 65535
_FIELDS: Final = ("id", "name", "role", "width_m", "height_m", "depth_m", "elevation_m", "top_m", "attribution")
"""Fields of a model that are stored as they are."""
_DAMAGE: Final = (OSError, zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError, RuntimeError)

Box = list[list[float]]
"""Least and greatest values of columns."""


@dataclass(eq=False)
class CacheWriter:
    """Collects models, then writes them as one file."""

    _arrays: dict[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    _models: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    _textures: dict[bytes, int] = field(default_factory=dict[bytes, int])

    def add(self, model: FurnitureModel, mesh: Mesh, shared: tuple[str, ...]) -> None:
        """Add a model with its mesh and the digests of its geometry and textures (`splits.assign_splits`)."""
        (vertices, box), (uvs, uv_box) = _quantised(mesh.vertices), _quantised(mesh.uvs)
        arrays = {
            "vertices": vertices,
            "uvs": uvs,
            "normals": np.rint(127 * mesh.normals).astype(np.int8),
            "faces": mesh.faces,
            "face_materials": mesh.face_materials,
        }
        self._arrays |= {f"{len(self._models)}/{name}": array for name, array in arrays.items()}
        lights = [{**vars(light), "position": light.position.tolist()} for light in model.lights]
        materials = [{**vars(material), "texture": self._number(material.texture)} for material in mesh.materials]
        self._models.append(
            {name: getattr(model, name) for name in _FIELDS}
            | {"lights": lights, "shared": shared, "box": box, "uv_box": uv_box, "materials": materials}
        )

    def write(self, path: Path) -> None:
        """Write the file atomically (two processes may write it at once).

        Raises:
            OutputError: the file cannot be written.
        """
        textures = {f"texture {number}": np.frombuffer(data, np.uint8) for data, number in self._textures.items()}
        text = json.dumps({"version": VERSION, "models": self._models}).encode()
        file = BytesIO()
        arrays: dict[str, Any] = {_INDEX: np.frombuffer(text, np.uint8), **self._arrays, **textures}
        np.savez_compressed(file, **arrays)
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        write_atomic(temporary, file.getvalue())
        temporary.replace(path)

    def _number(self, texture: Texture | None) -> int | None:
        if texture is None:
            return None
        bgr = np.ascontiguousarray(texture.image[..., ::-1])
        data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        return self._textures.setdefault(data, len(self._textures))


class Cache:
    """An open cache file; its index is in memory, arrays are read on access."""

    def __init__(self, path: Path) -> None:
        """Read the index.

        Raises:
            FurnitureError: the file is missing, damaged, of another version, or not a furniture cache.
        """
        self.path: Final = path
        try:
            self._archive = zipfile.ZipFile(path)
            index = json.loads(self._read(_INDEX).tobytes())
        except _DAMAGE as error:
            raise FurnitureError(f"{path}: is not a furniture cache, or is damaged ({error})") from error
        if index["version"] != VERSION:
            raise FurnitureError(
                f"{path}: has furniture cache version {index['version']}, but this release reads version {VERSION}; "
                "rebuild it"
            )
        self._models: list[dict[str, Any]] = index["models"]
        self._textures: WeakValueDictionary[int, Texture] = WeakValueDictionary()

    def models(self) -> list[tuple[FurnitureModel, tuple[str, ...]]]:
        """Return all models, in the order in which they were stored, with their digests (`CacheWriter.add`).

        Their split is a placeholder: it depends on all loaded models.
        """
        return [
            (
                FurnitureModel(
                    **{name: record[name] for name in _FIELDS},
                    split="train",
                    load=partial(self.mesh, number),
                    lights=tuple(
                        LightSource(np.array(light["position"], np.float32), light["diameter_m"], _rgb(light["colour"]))
                        for light in record["lights"]
                    ),
                ),
                tuple(record["shared"]),
            )
            for number, record in enumerate(self._models)
        ]

    def mesh(self, number: int) -> Mesh:
        """Return the mesh of a model.

        Raises:
            FurnitureError: the file is damaged.
        """
        record = self._models[number]
        vertices, uvs, normals, faces, owners = (
            self._array(f"{number}/{name}") for name in ("vertices", "uvs", "normals", "faces", "face_materials")
        )
        way = normals.astype(np.float32)
        return Mesh(
            vertices=_restored(vertices, record["box"]),
            normals=way / np.linalg.norm(way, axis=1, keepdims=True),
            uvs=_restored(uvs, record["uv_box"]),
            faces=faces,
            face_materials=owners,
            materials=tuple(self._material(material) for material in record["materials"]),
        )

    def _material(self, record: dict[str, Any]) -> Material:
        number = record["texture"]
        values: dict[str, Any] = {name: _rgb(record[name]) for name in ("albedo", "emission")}
        values["texture"] = None if number is None else self._texture(number)
        return Material(**{**record, **values})

    def _texture(self, number: int) -> Texture:
        """Return a texture; the same object while it is referenced elsewhere."""
        texture = self._textures.get(number)
        if texture is None:
            pixels = cv2.imdecode(self._array(f"texture {number}"), cv2.IMREAD_COLOR)
            if pixels is None:
                raise FurnitureError(f"{self.path}: texture {number} is not an image; delete the cache to rebuild it")
            texture = self._textures[number] = Texture(np.ascontiguousarray(np.asarray(pixels, np.uint8)[..., ::-1]))
        return texture

    def _array(self, name: str) -> np.ndarray:
        try:
            return self._read(name)
        except _DAMAGE as error:
            raise FurnitureError(
                f"{self.path}: {name} of the furniture cache is damaged ({error}); delete it to rebuild it"
            ) from error

    def _read(self, name: str) -> np.ndarray:
        return np.load(BytesIO(self._archive.read(f"{name}.npy")))


def is_cache(path: Path) -> bool:
    """Return whether the file is a furniture cache of any version."""
    try:
        with zipfile.ZipFile(path) as archive:
            return f"{_INDEX}.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def _quantised(values: Float[np.ndarray, "n c"]) -> tuple[UInt16[np.ndarray, "n c"], Box]:
    low, high = values.min(0).astype(np.float64), values.max(0).astype(np.float64)
    steps = np.rint((values - low) / np.maximum(high - low, 1e-12) * _STEPS).astype(np.uint16)
    return steps, [low.tolist(), high.tolist()]


def _restored(steps: UInt16[np.ndarray, "n c"], box: Box) -> Float[np.ndarray, "n c"]:
    low, high = np.array(box[0]), np.array(box[1])
    return (low + steps * ((high - low) / _STEPS)).astype(np.float32)


def _rgb(values: list[float]) -> Rgb:
    red, green, blue = values
    return red, green, blue
