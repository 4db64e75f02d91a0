"""Small furniture libraries for tests: zip files with a catalogue file, OBJ, MTL and PNG."""

import zipfile
from pathlib import Path

import cv2
import numpy as np

CATALOGUE_FILE = "PluginFurnitureCatalog.properties"

BOX_FACES = ((3, 4, 2, 1), (6, 8, 7, 5), (2, 6, 5, 1), (7, 8, 4, 3), (5, 7, 3, 1), (4, 8, 6, 2))


def box_obj(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, 1.0), *, material="wood", library="m.mtl", first=1) -> str:
    """Return a box as an OBJ with texture coordinates; bits 0 to 2 of a vertex number choose low or high x, y, z."""
    lines = [f"mtllib {library}"] if library else []
    for k in range(8):
        corner = [(high if k >> axis & 1 else low)[axis] for axis in range(3)]
        lines.append("v " + " ".join(f"{value:.6f}" for value in corner))
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", f"usemtl {material}"]
    for face in BOX_FACES:
        lines.append("f " + " ".join(f"{v + first - 1}/{k + 1}" for k, v in enumerate(face)))
    return "\n".join(lines) + "\n"


def sphere_obj(rings: int, segments: int) -> str:
    """Return a sphere of quads and triangles without texture coordinates."""
    lines = []
    for i in range(rings + 1):
        for j in range(segments):
            t, p = np.pi * i / rings, 2 * np.pi * j / segments
            lines.append(f"v {np.sin(t) * np.cos(p):.6f} {np.cos(t):.6f} {np.sin(t) * np.sin(p):.6f}")
    for i in range(rings):
        for j in range(segments):
            k = (j + 1) % segments
            a, b, c, d = (i * segments + j, i * segments + k, (i + 1) * segments + k, (i + 1) * segments + j)
            lines.append(f"f {a + 1} {b + 1} {c + 1} {d + 1}")
    return "\n".join(lines) + "\n"


def png(image: np.ndarray) -> bytes:
    """Encode an RGB or RGBA image as PNG."""
    order = [2, 1, 0, 3] if image.shape[2] == 4 else [2, 1, 0]
    return cv2.imencode(".png", np.ascontiguousarray(image[..., order]))[1].tobytes()


MTL = "newmtl wood\nKd 0.6 0.4 0.2\n"


def entry(number: int, identity: str, **properties: object) -> str:
    """Return a model's entry in a catalogue file; centimetres. Properties that are None are left out."""
    values: dict[str, object] = {
        "id": identity,
        "name": "Chair",
        "tags": "Seat",
        "category": "Living room",
        "model": f"/{identity}/{identity}.obj",
        "width": 50,
        "depth": 60,
        "height": 90,
        "movable": "true",
        "doorOrWindow": "false",
        "creator": "Ann Onymous",
        **properties,
    }
    return "".join(f"{key}#{number}={value}\n" for key, value in values.items() if value is not None)


def write_library(path: Path, catalogue: str | None, files: dict[str, str | bytes]) -> Path:
    """Write a `.sh3f` file."""
    head = "id=Test#Library\nname=Test\nversion=1.0\nlicense=CC-BY 3.0\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        if catalogue is not None:
            archive.writestr(CATALOGUE_FILE, head + catalogue)
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def simple_library(path: Path, identities=("a", "b", "c"), **properties: object) -> Path:
    """Write a library of slightly different boxes."""
    catalogue = "".join(entry(k + 1, identity, **properties) for k, identity in enumerate(identities))
    files: dict[str, str | bytes] = {}
    for k, identity in enumerate(identities):
        files[f"{identity}/{identity}.obj"] = box_obj(high=(1, 1, 1 + 0.1 * k))
        files[f"{identity}/m.mtl"] = MTL
    return write_library(path, catalogue, files)
