"""Every shape at every quality: finite, no light above the room's, no seams, and contact with the floor."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from roomlight.compositing.compositor import Compositor
from roomlight.compositing.objects.materials import diffuse, glossy, mirror
from roomlight.compositing.objects.primitives import chair, cube, plane, sphere, vase
from roomlight.compositing.objects.teapot import teapot
from roomlight.compositing.placement.scene import AtPosition, SceneObject
from roomlight.engine.session import Session, SessionOptions
from rooms import BoxRoom, camera_at

QUALITIES = ("preview", "good", "final")
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
    room = Session(SessionOptions(model="classical", height=32))
    for index in range(8):
        room.push(ROOM.frame(camera_at(EYE, 45 * index, (index % 2) * 60 - 35), index=index))
    room.push(VIEW)
    return room


@pytest.fixture(scope="module", params=[*QUALITIES[:-1], pytest.param(QUALITIES[-1], marks=pytest.mark.slow)])
def compositor(request: pytest.FixtureRequest, session: Session) -> Iterator[Compositor]:
    made = Compositor(session, OBJECTS, quality=request.param)
    yield made
    made.close()


def test_shapes_are_lit_by_the_room_without_seams_and_stand_on_the_floor(compositor: Compositor) -> None:
    picture = compositor.composite(VIEW)
    for layer in (picture.objects, picture.alpha, picture.shadow):
        assert np.isfinite(layer).all()
    assert set(np.unique(picture.object_id)) == set(range(-1, len(OBJECTS)))
    assert picture.radiance.max() < WHITE  # no lamp is in the room
    assert picture.shadow.max() < 1.35  # light that white objects give
    for name in ("cube", "plane", "chair"):
        assert largest_step(picture.objects[..., 1], picture.object_id == list(SHAPES).index(name)) < 0.15
    for name in ("cube", "chair", "vase"):
        assert contact(picture.shadow.mean(axis=-1), picture.object_id == list(SHAPES).index(name)) < 0.8


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
