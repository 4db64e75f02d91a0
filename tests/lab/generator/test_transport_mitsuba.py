"""The light of a small room beside that of Mitsuba 3, an unbiased path tracer."""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from plain_shapes import rectangle, room_sides

from roomlight.camera import Intrinsics
from roomlight_generator.rooms.scene import Item, Material, Mesh, Scene, Sky
from roomlight_generator.rooms.shapes import block, with_material
from roomlight_generator.transport import RoomLight, Tracer

CAMERA = Intrinsics(30.0, 30.0, 20.0, 6.0, 40, 32)
BLOCK = 4
WHITE = Material("wall", (0.6, 0.5, 0.4))
NIGHT = Sky(np.zeros((4, 8, 3), np.float32))


def box_room() -> list[Mesh]:
    """4 x 2.6 x 4 m about the y axis: its floor is coated, its far wall holds a mirror, a panel lights it."""
    coated = Material("floor", (0.4, 0.3, 0.2), roughness=0.2)
    sides = room_sides(4, 2.6, 4, step=5)
    panel = with_material(block(0.8, 0.03, 0.8), Material("panel", (0.8, 0.8, 0.8), emission=(5.0, 4.0, 3.0)))
    return [
        *(with_material(side, coated if name == "floor" else WHITE) for name, side in sides.items()),
        with_material(rectangle((0.6, 0.9, -1.99), (0.6, 0, 0), (0, 0.8, 0), step=5), Material("mirror", mirror=0.9)),
        panel.placed(0.0, 2.5, 0.2),
    ]


def mitsuba_shape(mi: ModuleType, mesh: Mesh, path: Path) -> dict[str, Any]:
    """The mesh as Mitsuba describes it, by way of a PLY file."""
    shape = mi.Mesh("mesh", len(mesh.vertices), len(mesh.faces))
    values = mi.traverse(shape)
    values["vertex_positions"], values["faces"] = mesh.vertices.ravel(), mesh.faces.ravel().astype(np.uint32)
    values.update()
    shape.write_ply(str(path))
    (material,) = mesh.materials
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": rgb(material.albedo)}
    if material.mirror > 0:
        bsdf = {"type": "conductor", "material": "none", "specular_reflectance": rgb((material.mirror,) * 3)}
    elif material.roughness is not None:
        bsdf = {"type": "roughplastic", "distribution": "ggx", "alpha": material.roughness, "int_ior": 1.5}
        bsdf |= {"nonlinear": False, "diffuse_reflectance": rgb(material.albedo)}
    described = {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": {"type": "twosided", "b": bsdf}}
    return described | (
        {"emitter": {"type": "area", "radiance": rgb(material.emission)}} if any(material.emission) else {}
    )


def rgb(value: tuple[float, ...]) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


@pytest.mark.slow
@pytest.mark.statistical
def test_a_room_has_the_light_that_mitsuba_gives_it(tmp_path: Path) -> None:
    """Blocks of 4 x 4 pixels of a frame with diffuse and coated surfaces and a mirror."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    meshes, pose = box_room(), np.eye(4)
    pose[:3, 3] = 0.2, 1.2, 1.2
    sensor = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(CAMERA.width / 2 / CAMERA.fx))),
        "principal_point_offset_y": 0.5 - CAMERA.cy / CAMERA.height,
        "to_world": mi.ScalarTransform4f((pose @ np.diag([-1.0, 1, -1, 1])).tolist()),
        "film": {"type": "hdrfilm", "width": CAMERA.width, "height": CAMERA.height, "rfilter": {"type": "box"}},
    }
    shapes = {f"m{k}": mitsuba_shape(mi, mesh, tmp_path / f"{k}.ply") for k, mesh in enumerate(meshes)}
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 40}, "sensor": sensor, **shapes})
    theirs = blocks(np.array(mi.render(scene, spp=256, seed=1))[..., :3])
    items = tuple(Item(str(k), "wall", mesh) for k, mesh in enumerate(meshes))
    ours = blocks(RoomLight.solve(Tracer(Scene(items, (), NIGHT)), 0).frame(CAMERA, pose, seed=0).radiance)
    error = np.abs(ours / theirs - 1)
    # measured: 0.04 and 0.988
    assert np.median(error) < 0.08
    assert abs(ours.sum() / theirs.sum() - 1) < 0.05


def blocks(image: np.ndarray) -> np.ndarray:
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    return image.reshape(rows, BLOCK, columns, BLOCK, 3).mean((1, 3))
