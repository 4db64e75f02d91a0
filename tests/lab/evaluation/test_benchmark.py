"""The benchmark: which light each sphere gets, at which moments; rooms that a seed gives."""

import json

import numpy as np
import pytest

from recordings import BoxWalks
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import DatasetError
from roomlight.files import json_text
from roomlight.metrics import SPHERES, SphereScorer
from roomlight.spheres import SphereRenderer, view_toward
from roomlight_evaluation.benchmark import (
    ERRORS,
    SINGLE_IMAGE,
    _Judge,
    benchmark_options,
    evaluate_benchmark,
    rooms_digest,
    tone_mapped,
)
from roomlight_evaluation.walks import walk_frames

HEIGHT = 32
OPTIONS = SessionOptions(model="classical", height=HEIGHT)
LAST = "3 frames"


@pytest.fixture(scope="module")
def scores():
    reported = []
    found = evaluate_benchmark(BoxWalks(3, height=HEIGHT), OPTIONS, rooms=2, progress=lambda *at: reported.append(at))
    assert reported == [(1, 2), (2, 2)]
    return found


def test_methods_are_scored_after_the_first_and_the_last_frame(scores):
    methods = ("mean colour", "warp and fill", "classical")
    assert set(scores.errors) == {(method, moment) for method in methods for moment in (SINGLE_IMAGE, LAST)}
    for errors in scores.errors.values():
        assert set(errors) == {f"{error}_{sphere}" for error in ERRORS for sphere in SPHERES}
        assert all(len(values) == 2 and min(values) > 0 for values in errors.values())


def test_the_mirror_shows_reflection_and_the_others_are_lit_by_lighting(scores):
    recording = BoxWalks(1, height=HEIGHT)[0]
    session = Session(OPTIONS)
    positions = [(float(x), float(y), float(z)) for x, y, z in recording.probe_positions]
    for position in positions:
        session.track(position)
    frames = list(walk_frames(recording, "exact"))
    for frame in frames:
        session.push(frame)
    expected = {sphere: [] for sphere in SPHERES}
    for position, light, truth in zip(positions, session.lights(), recording.true_panoramas(), strict=True):
        judge = SphereScorer(truth, SphereRenderer(view_toward(frames[0].camera_to_world, position)))
        for sphere in SPHERES:
            shown = light.reflection if sphere == "mirror" else light.panorama
            expected[sphere].append(judge.errors(shown, sphere)["rmse"])
    for sphere in SPHERES:
        found = scores.errors["classical", LAST][f"rmse_{sphere}"][0]
        assert found == pytest.approx(np.mean(expected[sphere]), rel=1e-6)


def test_tone_mapped_light_has_its_median_at_a_half_and_keeps_its_order():
    light = np.random.default_rng(0).lognormal(size=(8, 16, 3)).astype(np.float32)
    light[0, :3] = 0.0
    light[1, 1] = -1.0
    toned = tone_mapped(light)
    assert np.median(toned[toned > 0]) == pytest.approx(0.5)
    np.testing.assert_allclose(tone_mapped(7 * light), toned, rtol=1e-5)
    bright, dim = light[2, 2, 0], light[3, 3, 0]
    assert toned[2, 2, 0] / toned[3, 3, 0] == pytest.approx((bright / dim) ** (1 / 2.4), rel=1e-5)
    assert not tone_mapped(np.zeros((4, 8, 3), np.float32)).any()


def test_tone_mapped_errors_do_not_know_brightness_and_sum_over_channels():
    judge = _Judge(np.full((16, 32, 3), 2.0, np.float32), SphereRenderer((0.0, 0.0, -1.0)))
    same = judge.errors(np.full((16, 32, 3), 9.0, np.float32), "diffuse")
    assert (same["toned_rmse"], same["toned_si_rmse"]) == pytest.approx((0, 0), abs=1e-5)
    red = np.full((16, 32, 3), 1.0, np.float32)
    red[..., 0] = 2.0**2.4
    for sphere, reflected in (("diffuse", 1.0), ("mirror", 0.8)):  # 1, 0.5, 0.5 for 0.5 each
        assert judge.errors(red, sphere)["toned_rmse"] == pytest.approx(0.5 * reflected, rel=1e-3)


def test_tables_and_json_hold_every_room(scores):
    assert [table.row_count for table in scores.tables(title="boxes")] == [6] * 6
    written = json.loads(json_text(scores.to_json()))
    assert len(written["rooms"]) == 2
    first = written["scores"][0]
    assert first["errors"] == scores.errors[first["method"], first["moment"]]


def test_too_few_walks_are_refused():
    with pytest.raises(DatasetError, match="boxes: has 3 walks, not 4; generate more"):
        evaluate_benchmark(BoxWalks(3, height=HEIGHT), OPTIONS, rooms=4)


def test_rooms_are_of_a_seed_a_walk_each():
    options = benchmark_options(rooms=2, seed=7)
    assert (options.sequences, options.seed, options.split, options.frames) == (2, 7, "test", 31)
    assert options.sequences_per_room == options.shard_size == 1  # so that two rooms are the first of three


def test_rooms_are_named_by_their_bytes(tmp_path):
    for number in range(3):
        (tmp_path / f"test-{number:05d}.tar").write_bytes(b"room %d" % number)
    whole, first = rooms_digest(tmp_path, 3), rooms_digest(tmp_path, 2)
    (tmp_path / "test-00002.tar").write_bytes(b"another")
    assert rooms_digest(tmp_path, 3) != whole
    assert rooms_digest(tmp_path, 2) == first
