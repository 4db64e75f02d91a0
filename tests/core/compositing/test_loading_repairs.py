"""What files state wrongly or loosely and has one meaning is mended, and said."""

import numpy as np
import pytest
from gltf_files import face_normals, ply

from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.virtual_object import TriangleMesh

OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
OUTWARD = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]


def octahedron(kind: str, order: int, normals: float, flipped: slice = slice(None)) -> bytes:
    """A file of an octahedron with stated normals; `order` -1 turns the faces of `flipped` round."""
    faces = [list(face) for face in OUTWARD]
    faces[flipped] = [face[::order] for face in faces[flipped]]
    if kind == "ply":
        names = "".join(f"property float n{axis}\n" for axis in "xyz")
        return ply(OCTAHEDRON + 2, faces, "ascii", names, (OCTAHEDRON * normals).tolist())
    lines = [f"v {x} {y} {z}" for x, y, z in OCTAHEDRON + 2] + [f"vn {x} {y} {z}" for x, y, z in OCTAHEDRON * normals]
    lines += ["f " + " ".join(f"{index + 1}//{index + 1}" for index in face) for face in faces]
    return "\n".join(lines).encode()


def outward(mesh: TriangleMesh) -> bool:
    """Whether the octahedron's faces and normals all look outward."""
    from_centre = mesh.vertices.astype(float) - 2
    of_faces = from_centre[mesh.faces].mean(axis=1)
    return bool(((face_normals(mesh) * of_faces).sum(1) > 0).all() and ((mesh.normals * from_centre).sum(1) > 0).all())


@pytest.mark.parametrize("kind", ["obj", "ply"])
@pytest.mark.parametrize(("order", "normals", "flipped", "turned"), [
    (-1, 1.0, slice(None), "corners"), (1, -1.0, slice(None), "normals"), (-1, 1.0, slice(0, 2), "corners"),
])  # fmt: skip
def test_normals_that_oppose_the_order_of_corners_are_made_to_agree(
    kind: str, order: int, normals: float, flipped: slice, turned: str
) -> None:
    found = load_object(octahedron(kind, order, normals, flipped), kind)  # pyright: ignore[reportArgumentType]
    assert outward(found.parts[0][0])
    (note,) = found.notes
    assert note.effect == f"their {turned} are turned round"
    assert not load_object(octahedron(kind, 1, 1.0), kind).notes  # pyright: ignore[reportArgumentType]
