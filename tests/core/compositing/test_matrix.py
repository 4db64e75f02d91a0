"""Shapes and GLB files at every quality: finite, no light above the room's, no seams, and contact with the floor."""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from gltf_files import GltfFile

from roomlight.captures import open_capture
from roomlight.compositing.compositor import Compositor
from roomlight.compositing.loading import load_object
from roomlight.compositing.objects.materials import diffuse, glossy, mirror
from roomlight.compositing.objects.primitives import chair, cube, plane, sphere, vase
from roomlight.compositing.objects.teapot import teapot
from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.compositing.picture.layers import Composite
from roomlight.compositing.placement.scene import AtPixel, AtPosition, SceneObject
from roomlight.engine.session import Session
from roomlight.sample import sample_capture
from rooms import BoxRoom, camera_at
from sessions import session_of

QUALITIES = ("preview", "good", "final")
MARKED = [QUALITIES[0], *(pytest.param(quality, marks=pytest.mark.slow) for quality in QUALITIES[1:])]
WHITE = 1.0
"""The brightest wall of the room has 0.9."""
ROOM = BoxRoom(block=((-1.3, 0.0, -1.4), (-0.5, 0.6, -0.8)))
SHAPES = {
    "sphere": (sphere(0.15, glossy()), (-0.7, 0.6, -0.9)),  # on the block, beside the chair
    "chair": (chair(0.85), (-0.15, 0.0, -1.0)),
    "cube": (cube(0.3, diffuse()), (0.45, 0.0, -0.7)),
    "plane": (plane(0.4, 0.4, diffuse()), (1.1, 0.0, -0.9)),
    "vase": (vase(0.4, diffuse((0.7, 0.3, 0.2))), (0.9, 0.0, -1.3)),
    "teapot": (teapot(0.3).with_material(mirror()), (0.1, 0.0, -0.2)),
}
OBJECTS = [SceneObject(name, geometry, AtPosition(place)) for name, (geometry, place) in SHAPES.items()]
EYE = (0.0, 1.3, 1.3)
VIEW = ROOM.frame(camera_at(EYE, 0, -32), index=20, width=240, height=180)


@pytest.fixture(scope="module")
def session() -> Session:
    around = [ROOM.frame(camera_at(EYE, 45 * index, (index % 2) * 60 - 35), index=index) for index in range(8)]
    return session_of([*around, VIEW], height=32)


@pytest.fixture(scope="module", params=MARKED)
def compositor(request: pytest.FixtureRequest, session: Session) -> Iterator[Compositor]:
    made = Compositor(session, OBJECTS, quality=request.param)
    yield made
    made.close()


def test_shapes_are_lit_by_the_room_without_seams_and_stand_on_the_floor(compositor: Compositor) -> None:
    picture = compositor.composite(VIEW)
    check_light(picture)
    assert set(np.unique(picture.object_id)) == set(range(-1, len(OBJECTS)))
    for name in ("cube", "plane", "chair"):
        assert largest_step(picture.objects[..., 1], picture.object_id == list(SHAPES).index(name)) < 0.15
    for name in ("cube", "chair", "vase"):
        assert contact(picture.shadow.mean(axis=-1), picture.object_id == list(SHAPES).index(name)) < 0.8


TOP, LEGS = (0.5, 0.03, 0.35), [(x, z) for x in (-0.21, 0.21) for z in (-0.14, 0.14)]
LEG_M = 0.025
TABLES = {
    "plain": (-0.75, 0.0, -0.2),
    "emissive": (0.0, 0.0, -0.2),
    "texture transform": (0.75, 0.0, -0.2),
    "vertex colours": (0.05, 0.0, -1.9),
    "skin": (0.7, 0.0, -1.9),
    "double sided": (1.35, 0.0, -1.9),
    "draco": (1.95, 0.0, -1.9),
}


def table(kind: str) -> VirtualObject:
    """Return a table on four thin legs, from a GLB file with one of the ways in which files state things."""
    box, _ = cube(1.0).parts[0]
    unit = box.vertices - box.vertices.mean(axis=0)
    parts = [((0, 0.45, 0), TOP), *(((x, 0.22, z), (LEG_M, 0.44, LEG_M)) for x, z in LEGS)]
    points = np.concatenate([unit * np.array(size, np.float32) + np.array(at, np.float32) for at, size in parts])
    faces = np.concatenate([box.faces + number * len(unit) for number in range(len(parts))])
    normals, uvs = (np.tile(values, (len(parts), 1)) for values in (box.normals, box.uvs))
    file = GltfFile()
    pbr: dict[str, Any] = {"baseColorFactor": [0.5, 0.35, 0.2, 1], "metallicFactor": 0, "roughnessFactor": 0.9}
    material: dict[str, Any] = {"pbrMetallicRoughness": pbr, "doubleSided": kind == "double sided"}
    if kind == "emissive":  # bright in its factor, and nearly black in its texture
        spots = np.zeros((64, 64, 3), np.uint8)
        spots[0, :2] = 255
        material |= {"emissiveFactor": [0.5, 0.5, 0.5], "emissiveTexture": {"index": file.image(spots)}}
    if kind == "texture transform":
        stripes = np.tile(np.array([[[90] * 3, [200] * 3]], np.uint8), (8, 4, 1))
        moved = {"KHR_texture_transform": {"scale": [3, 3], "rotation": 0.5}}
        pbr["baseColorTexture"] = {"index": file.image(stripes), "extensions": moved}
    number, more = file.material(**material), {}
    if kind == "draco":
        file.draco(points, faces, material=number)
    else:
        file.mesh(points, faces, uvs=uvs, normals=normals, material=number)
    if kind == "vertex colours":
        colours = np.linspace(0.2, 0.8, 3 * len(points), dtype=np.float32).reshape(-1, 3)
        file.attribute("COLOR_0", colours, "VEC3")
    if kind == "skin":  # a joint that shrinks what its bind pose enlarges
        file.attribute("JOINTS_0", np.zeros((len(points), 4), np.uint8), "VEC4", 5121)
        file.attribute("WEIGHTS_0", np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1)), "VEC4")
        bind = np.diag([100.0, 100, 100, 1]).astype(np.float32).reshape(1, 16)
        file.tree["skins"] = [{"joints": [1], "inverseBindMatrices": file.accessor(bind, "MAT4", 5126)}]
        more = {"skin": 0}
    file.node(root=True, mesh=0, **more)
    if kind == "skin":
        file.node(scale=[0.01] * 3)
    return load_object(file.glb())


@pytest.mark.parametrize("quality", MARKED)
def test_files_are_lit_by_the_room_without_seams_and_stand_on_every_foot(session: Session, quality: str) -> None:
    scene = [SceneObject(kind, table(kind), AtPosition(place)) for kind, place in TABLES.items()]
    made = Compositor(session, scene, quality=quality)
    picture = made.composite(ROOM.frame(VIEW.camera_to_world, index=20, width=400, height=300))
    made.close()
    check_light(picture)
    for number, (x, y, z) in enumerate(TABLES.values()):
        assert largest_step(picture.objects[..., 1], picture.object_id == number) < 0.15
        feet = [contact_of_foot(picture, np.array([x + aside, y, z + along])) for aside, along in LEGS]
        assert max(feet) < 0.7  # those at the far end of the room are 1.6 pixels wide
        assert np.mean(feet) < (0.65 if quality == "preview" else 0.6)


@pytest.mark.slow
def test_objects_in_the_frames_of_a_recording_have_no_seams_and_cast_no_light() -> None:
    frames = list(open_capture(sample_capture()))[::10]
    session = session_of(frames, model="auto", height=60)
    floor = AtPixel(160.0, 200.0, frames[0].index)
    for quality in QUALITIES:
        made = Compositor(session, [SceneObject("table", table("texture transform"), floor)], quality=quality)
        for frame in frames:
            picture = made.composite(frame)
            assert np.isfinite(picture.radiance).all()
            assert picture.shadow.max() < 1.35
            assert largest_step(picture.objects[..., 1], picture.object_id == 0) < 0.2
        made.close()
    assert len(frames) > 2


def check_light(picture: Composite) -> None:
    for layer in (picture.objects, picture.alpha, picture.shadow):
        assert np.isfinite(layer).all()
    assert picture.radiance.max() < WHITE  # no lamp is in the room
    assert picture.shadow.max() < 1.35  # light that white objects give


def contact_of_foot(picture: Composite, foot: np.ndarray) -> float:
    """Return the darkest shadow on the visible floor within three pixels of a foot."""
    camera, inverse = picture.frame.intrinsics, np.linalg.inv(picture.frame.camera_to_world)
    ((column, row),), _ = camera.project((inverse[:3, :3] @ foot + inverse[:3, 3])[None])
    near = np.s_[int(row) - 3 : int(row) + 5, int(column) - 3 : int(column) + 5]
    floor = picture.alpha[near] < 0.1
    return float(picture.shadow[near].mean(axis=-1)[floor].min(initial=1))


def largest_step(radiance: np.ndarray, of_object: np.ndarray) -> float:
    """Return the largest step between pixels two apart inside flat parts, by the median of their rows and columns.

    Edges between faces are steps too: they are left out as the ridges of the gradient, one pixel wide.
    """
    smooth = cv2.medianBlur(radiance.astype(np.float32), 5)
    inside = cv2.erode(of_object.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    steps = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1)) + np.abs(cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1))
    return float(np.percentile(steps[inside], 95)) if inside.any() else 0.0


def contact(ratio: np.ndarray, of_object: np.ndarray) -> float:
    """Return the darkest shadow within three pixels of an object's lower outline."""
    below = np.zeros_like(of_object)
    for rows in range(1, 4):
        below[rows:] |= of_object[:-rows]
    below &= ~of_object
    return float(ratio[below].min())
