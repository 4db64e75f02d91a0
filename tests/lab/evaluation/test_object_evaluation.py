"""Spheres and shadows under estimated light: what the errors measure, and rooms from captures and datasets."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

import stub_rooms
from fixture_rooms import FOLDER
from roomlight.conventions import panorama_directions
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError
from roomlight.files import json_text
from roomlight_evaluation.baselines import MeanColour
from roomlight_evaluation.composites.methods import HARMONICS, WARPED
from roomlight_evaluation.objects.evaluation import COMPOSITED, TRUTH, _of_capture, evaluate_objects
from roomlight_evaluation.objects.lit_objects import (
    BRIGHTNESS,
    LOOKS,
    MEASURES,
    SHADOW,
    SPHERES,
    LitObjects,
    shadow_of_sphere,
    unseen_look,
)
from roomlight_evaluation.objects.tables import object_tables
from rooms import BoxRoom, camera_at
from written_captures import write_capture

ROWS = 40
DIRECTIONS = panorama_directions(ROWS)
AHEAD = (0.0, 0.0, -1.0)
PROBES = ((0.3, 1.0, -0.5), (-0.4, 0.8, -0.2))


def lamp(direction, radiance=50.0, ambient=0.0):
    inside = DIRECTIONS @ (np.array(direction) / np.linalg.norm(direction)) > np.cos(np.radians(8))
    return np.repeat(np.where(inside, np.float32(radiance), np.float32(ambient))[..., None], 3, axis=2)


def write_room(path, *, probes=True):
    room = BoxRoom(size_m=(5.0, 2.6, 4.5), lamp=((0.5, 2.6, 0.3), 0.3))
    frames = [room.frame(camera_at((0.2, 1.4, 1.0), 4.0 * number), width=64, height=48) for number in range(9)]
    truths = [(position, room.panorama(np.array(position), height=ROWS)[0]) for position in PROBES if probes]
    return write_capture(path, frames, probes=truths)


def test_the_shadow_lies_where_the_sphere_hides_the_light():
    from_above = shadow_of_sphere(lamp((0, 1, 0)))
    assert from_above.min() < 0.01
    assert (from_above > 0.99).mean() > 0.8  # beyond the sphere's outline there is no shadow
    assert (
        shadow_of_sphere(np.ones((ROWS, 2 * ROWS, 3), np.float32)) < 1
    ).all()  # an even sky: a soft shadow all round
    low = shadow_of_sphere(lamp((1, 0.4, 0)))
    assert (low < 0.5).sum() > (from_above < 0.5).sum()  # long


def test_the_shadow_does_not_depend_on_the_exposure_and_is_none_in_the_dark():
    light = lamp((1, 2, 0), ambient=0.2)
    assert_allclose(shadow_of_sphere(7 * light), shadow_of_sphere(light), atol=1e-5)
    assert (shadow_of_sphere(np.zeros((ROWS, 2 * ROWS, 3), np.float32)) == 1).all()


def test_errors_are_none_under_the_truth_and_grow_with_the_error():
    objects = LitObjects(lamp((1, 2, 0), 20.0, ambient=0.1), AHEAD)
    assert set(objects.errors(lamp((1, 2, 0), 20.0, ambient=0.1)).values()) == {0.0}
    near, far = (objects.errors(lamp(toward, 20.0, ambient=0.1)) for toward in ((1, 2, 0.4), (-1, 2, 0)))
    for look in (*SPHERES, SHADOW):
        assert 0 < near[look] < far[look], look
    twice, half = (objects.errors(factor * lamp((1, 2, 0), 20.0, ambient=0.1)) for factor in (2.0, 0.5))
    assert_allclose([twice[BRIGHTNESS], half[BRIGHTNESS]], np.log(2), rtol=1e-5)


def test_a_place_without_a_shadow_has_no_error_of_it():
    errors = LitObjects(np.zeros((ROWS, 2 * ROWS, 3), np.float32), AHEAD).errors(lamp((0, 1, 0)))
    assert np.isnan(errors[SHADOW])
    assert errors["diffuse"] > 0


@pytest.fixture(scope="module")
def scores(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms")
    reported = []
    (write_room(folder / "b") / "facts.json").write_text('{"light": {"building": "hall"}}')
    found = evaluate_objects(
        [write_room(folder / "a"), folder / "b"],
        SessionOptions(model="classical"),
        frames=3,
        progress=lambda *at: reported.append(at),
    )
    assert reported == [("a", 0, 2), ("b", 1, 2)]
    return found


def test_every_method_is_scored_in_every_room(scores):
    assert scores.methods == (MeanColour.name, HARMONICS, WARPED, "classical", f"classical, {COMPOSITED}")
    assert [(room.room, room.probes, room.of_room) for room in scores.rooms] == [("a", 2, None), ("b", 2, "hall")]
    assert scores.ratio(HARMONICS, "diffuse").mean == scores.worst(HARMONICS, "diffuse") == 1
    assert scores.ratio("classical", "mirror").mean < scores.ratio(MeanColour.name, "mirror").mean


def test_as_many_frames_as_asked_are_shown_where_some_cannot_be_read(tmp_path):
    path = write_room(tmp_path / "room")
    sorted(path.rglob("*.png"))[-1].write_bytes(b"damaged")
    shown, truths, _ = _of_capture(path, 3)
    assert [frame.index for frame in shown] == [0, 3, 7]
    assert len(truths) == len(PROBES)


def test_walks_of_a_dataset_are_rooms_too():
    found = evaluate_objects([FOLDER], SessionOptions(model="classical"), split="test", limit=1)
    assert [room.room for room in found.rooms] == [f"{FOLDER.name} 0"]
    assert np.isfinite([found.mean("classical", look).mean for look in LOOKS]).all()


def test_tables_and_json_show_every_method(scores):
    *errors, unseen = object_tables(scores)
    for table in errors:
        assert list(table.columns[0].cells) == list(scores.methods)
    assert list(unseen.columns[0].cells) == [MeanColour.name, HARMONICS, WARPED, "classical", TRUTH]
    assert json.loads(json_text(scores.to_json()))[0]["errors"][HARMONICS].keys() == set(LOOKS)


def test_unseen_directions_are_as_coloured_and_uneven_as_they_are():
    seen = np.zeros((ROWS, 2 * ROWS), np.float32)
    seen[:, ROWS:] = 1
    panorama = np.full((ROWS, 2 * ROWS, 3), 0.2, np.float32)
    panorama[:, ROWS:] = np.random.default_rng(0).random((ROWS, ROWS, 3))  # what was seen does not count
    assert unseen_look(panorama, seen) == pytest.approx(dict.fromkeys(MEASURES, 0.0), abs=1e-6)
    panorama[:, : ROWS // 2, 0] *= 2
    coloured = unseen_look(panorama, seen)
    assert coloured[MEASURES[0]] == pytest.approx(0.25, rel=1e-3)
    assert coloured[MEASURES[1]] > 0
    panorama *= 100  # white cuts it
    assert unseen_look(panorama, seen) == pytest.approx(dict.fromkeys(MEASURES, 0.0), abs=1e-6)
    assert all(np.isnan(value) for value in unseen_look(panorama, np.ones_like(seen)).values())


def test_recordings_without_ground_truth_are_refused(tmp_path):
    with pytest.raises(CaptureError, match="no ground-truth probes"):
        evaluate_objects([write_room(tmp_path / "bare", probes=False)], SessionOptions(model="classical"))
    views = stub_rooms.make_dataset(tmp_path / "views", 2, split="test", renderer=stub_rooms.VIEWS)
    for sources in ([], [views.folder]):
        with pytest.raises(CaptureError, match="no room to score"):
            evaluate_objects(sources, SessionOptions(model="classical"))
