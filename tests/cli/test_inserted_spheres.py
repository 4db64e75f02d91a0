from dataclasses import replace

import numpy as np
import pytest

from present import present
from roomlight.camera import rigid_inverse, transform_points
from roomlight.conventions import linear_to_srgb8
from roomlight.engine.session import Session, SessionOptions
from roomlight_cli.replays.inserted_spheres import ProbeView, insert_spheres
from rooms import BoxRoom, camera_at

ROOM = BoxRoom(block=((-0.9, 0.0, -1.2), (-0.3, 0.6, -0.6)))
EYE = (0.2, 1.4, 1.4)
SEEN = (0.4, 0.6, -0.8)
BEHIND_THE_BLOCK = (-0.75, 0.2, -1.6)
BEHIND_THE_CAMERA = (0.2, 1.4, 2.2)


def view(index: int = 0):
    return ROOM.frame(camera_at(EYE, 0.0, -20), index=index, width=160, height=120)


@pytest.fixture(scope="module")
def session() -> Session:
    held = Session(SessionOptions(model="classical", height=32))
    for index in range(3):
        held.push(view(index))
    return held


def test_only_probes_that_the_frame_shows_count() -> None:
    seen = ProbeView.of(view(), [SEEN, BEHIND_THE_BLOCK, BEHIND_THE_CAMERA])
    assert [mark is not None for mark in seen.marks] == [True, False, False]
    assert seen.score == 1
    unknown = replace(view(), depth_m=np.zeros_like(view().depth_m))
    assert ProbeView.of(unknown, [SEEN, BEHIND_THE_BLOCK, BEHIND_THE_CAMERA]).score == 2


def test_a_sphere_appears_where_the_probe_is(session: Session) -> None:
    before = session.handles
    frame = view()
    inserted = present(insert_spheres(session, ProbeView.of(frame, [SEEN, BEHIND_THE_CAMERA])))
    assert inserted.marks[1] is None
    assert session.handles == before  # what the replay reports are its own probes
    height, width = inserted.image.shape[:2]
    assert width == 960
    pixel, _ = frame.intrinsics.project(transform_points(rigid_inverse(frame.camera_to_world), np.array([SEEN])))
    column, row = (pixel[0] * width / frame.intrinsics.width).tolist()
    plain = np.kron(linear_to_srgb8(frame.image), np.ones((6, 6, 1), np.uint8)).astype(int)
    changed = np.abs(inserted.image.astype(int) - plain).max(axis=-1) > 12
    radius = 0.055 * frame.intrinsics.fx * width / frame.intrinsics.width
    rows, columns = np.mgrid[: len(changed), :width]
    away = np.hypot(columns - column, rows - row) / radius
    assert changed[away < 0.9].mean() > 0.7
    assert changed[(away > 1.3) & (away < 2) & (rows < row)].mean() < 0.1  # above it is the room as it was
    assert inserted.marks[0] is not None
    assert inserted.marks[0][1] * height < row - radius  # the badge is above the sphere


def test_without_a_probe_in_view_nothing_is_inserted(session: Session) -> None:
    assert insert_spheres(session, ProbeView.of(view(), [BEHIND_THE_CAMERA])) is None
    assert insert_spheres(session, ProbeView.of(view(), [])) is None
