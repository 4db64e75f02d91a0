"""Composites against the truth: regions, errors, lights that are compared, results that continue."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from roomlight.compositing.placement.scene import AtPixel, Scene, SceneObject
from roomlight.conventions import linear_to_srgb8, panorama_rays, panorama_solid_angles
from roomlight.engine.session import SessionOptions
from roomlight.errors import OutputError, SceneError
from roomlight_evaluation.composites import evaluation as composite_evaluation
from roomlight_evaluation.composites import scenes
from roomlight_evaluation.composites.methods import HARMONICS, METHODS, OURS, TRUE_LIGHT, harmonics_and_directional
from roomlight_evaluation.composites.regions import (
    ELSEWHERE,
    OBJECT,
    REGIONS,
    SHADOW,
    darker_part,
    regions,
    smoothed_truth,
)
from roomlight_evaluation.composites.scenes import MATERIALS, NAME, CompositeScene, virtual_object
from roomlight_evaluation.composites.scores import (
    CompositeScores,
    SceneScore,
    darkening_of,
    errors_of,
    read_lines,
    write_lines,
)
from roomlight_evaluation.composites.tables import composite_tables, summary
from rooms import BoxRoom, camera_at

FLOOR = np.full((60, 80, 3), 0.5, np.float32)


def drawn():
    """A floor with a black object of 20 x 20 pixels and a shadow of half the light, 10 rows, below it."""
    covered = np.zeros((60, 80), bool)
    covered[20:40, 30:50] = True
    picture = FLOOR.copy()
    picture[40:50, 30:50] *= 0.5
    picture[covered] = 0
    return picture, covered


def score(number, factor, material="mirror"):
    errors = {
        method: {region: {"rmse": own, "srgb": own, "log": own} for region in REGIONS}
        for method in METHODS
        for own in [factor * (0.05 if method in (OURS, TRUE_LIGHT) else 0.1)]
    }
    darkening: dict[str, float] = dict.fromkeys(("truth", *METHODS), -0.5)
    return SceneScore(number, f"room-{number}", "cube", material, dict.fromkeys(REGIONS, 9), errors, darkening, 0.001)


def test_regions_are_disjoint_and_find_the_shadow():
    picture, covered = drawn()
    masks = regions(picture, FLOOR, covered, np.ones((60, 80), np.float32), radius_m=1.0)
    total = np.sum([mask.astype(int) for mask in masks.values()], axis=0)
    assert total.max() == 1
    assert masks[OBJECT].sum() == 16 * 16  # without the rim of two pixels
    assert masks[SHADOW][43:48, 32:48].all()
    assert not masks[SHADOW][:, :24].any()
    assert masks[ELSEWHERE][5, 5]
    far_away = regions(picture, FLOOR, covered, np.full((60, 80), 7.0, np.float32), radius_m=1.0)
    assert not far_away[SHADOW].any()


def test_noise_far_from_the_object_is_no_shadow():
    picture, covered = drawn()
    rng, distance_m = np.random.default_rng(0), np.full((60, 80), 7.0, np.float32)
    distance_m[15:55, 25:55] = 1
    noisy, bare = [image * np.exp(rng.normal(0, 0.1, image.shape)).astype(np.float32) for image in (picture, FLOOR)]
    masks = regions(noisy, bare, covered, distance_m, radius_m=1.0)
    assert masks[SHADOW][43:48, 32:48].mean() > 0.95
    assert masks[SHADOW][:40].sum() < 0.1 * masks[SHADOW].sum()
    truth = smoothed_truth(FLOOR, noisy, (noisy, bare), covered, masks[SHADOW])
    assert (truth[masks[ELSEWHERE]] == FLOOR[masks[ELSEWHERE]]).all()
    assert truth[44:47, 34:46].mean() == pytest.approx(0.25, rel=0.06)
    assert (truth[covered] == noisy[covered]).all()


def test_errors_are_those_of_clipped_light():
    masks = {OBJECT: np.ones((4, 4), bool), SHADOW: np.zeros((4, 4), bool)}
    truth, found = np.full((4, 4, 3), 5.0), np.full((4, 4, 3), 0.5)
    errors = errors_of(found, truth, masks)
    assert errors[OBJECT]["rmse"] == pytest.approx(0.5)
    assert errors[OBJECT]["log"] == pytest.approx(np.log(1.01 / 0.51), rel=1e-5)
    assert np.isnan(errors[SHADOW]["rmse"])
    assert errors_of(truth, truth + 1, masks)[OBJECT]["srgb"] == 0


def test_darkening_is_the_log_of_the_shadow_s_light():
    picture, covered = drawn()
    masks = regions(picture, FLOOR, covered, np.ones((60, 80), np.float32), radius_m=1.0)
    darker = darker_part(picture, FLOOR, covered, masks[SHADOW])
    darker &= picture[..., 0] == 0.25
    assert darkening_of(picture, FLOOR, darker) == pytest.approx(np.log(0.5), rel=1e-4)
    assert np.isnan(darkening_of(picture, FLOOR, np.zeros_like(darker)))


def test_harmonics_and_directional_keep_the_light():
    panorama = np.full((64, 128, 3), 0.2, np.float32)
    rays = panorama_rays(64).reshape(64, 128, 3)
    lamp = rays @ np.array([0.6, 0.8, 0.0]) > np.cos(np.radians(8))
    panorama[lamp] = 20
    made = harmonics_and_directional(panorama)
    solid_angle = panorama_solid_angles(64)[..., None]
    kept = (made * solid_angle).sum() / (panorama * solid_angle).sum()
    assert kept == pytest.approx(1, abs=0.1)  # harmonics that would be negative are cut
    assert made.max() > 20  # all of the lamp is in the small disc
    assert rays[np.unravel_index(made[..., 0].argmax(), (64, 128))] @ np.array([0.6, 0.8, 0.0]) > 0.99


class Unrendered:
    def session(self, *_):
        return None


def test_scores_survive_their_file_and_runs_continue(tmp_path, monkeypatch):
    out, made, options = tmp_path / "scores.jsonl", [], SessionOptions(model="classical")
    settings = composite_evaluation.settings_of(options, 0, None)
    second = replace(score(3, 2.0), settings=settings, darkening={OURS: math.nan})
    write_lines(out, [replace(score(0, 1.0), settings=settings), second])
    assert "NaN" not in out.read_text()
    assert read_lines(out)[1].errors[OURS][OBJECT]["rmse"] == pytest.approx(0.1)
    assert math.isnan(read_lines(out)[1].darkening[OURS])

    def scored(number, *_):
        made.append(number)
        if number == 4:
            raise SceneError("no walk")
        return score(number, 1.0)

    monkeypatch.setattr(composite_evaluation, "kept_scene", lambda *_, **__: Unrendered())
    monkeypatch.setattr(composite_evaluation, "_score", scored)
    scores = composite_evaluation.evaluate_composites(4, out, options=options)
    assert made == [4, 5, 6]
    assert [one.number for one in scores.scenes] == [0, 3, 5, 6]
    assert len(read_lines(out)) == 4
    with pytest.raises(OutputError, match=r"has scores of seed 0 .*, not of seed 9 .*; use another file"):
        composite_evaluation.evaluate_composites(5, out, seed=9, options=options)
    monkeypatch.setattr(composite_evaluation, "_score", lambda *_: scored(4))
    with pytest.raises(SceneError, match="20 rooms one after the other give no scene; the last: no walk"):
        composite_evaluation.evaluate_composites(5, out, options=options)
    prior = tmp_path / "parts" / "prior" / "prior.npz"
    prior.parent.mkdir(parents=True)
    own = replace(options, parts=tmp_path / "parts")
    prior.write_bytes(b"one")
    first = composite_evaluation.settings_of(own, 0, None)
    prior.write_bytes(b"other")
    assert composite_evaluation.settings_of(own, 0, None) != first
    out.write_text(out.read_text() + '{"a": 1}')
    with pytest.raises(OutputError, match=r"scores.jsonl, line 5: is no scene's scores .*; remove the line"):
        read_lines(out)


@pytest.mark.parametrize("part", ["out", "keep", "pictures"])
def test_what_cannot_be_written_is_told_before_a_scene_is_rendered(part, tmp_path, monkeypatch):
    monkeypatch.setattr(composite_evaluation, "kept_scene", lambda *_, **__: pytest.fail("a scene was rendered"))
    (tmp_path / "file").touch()
    paths = {"out": tmp_path / "scores.jsonl", part: tmp_path / "file" / "below"}
    with pytest.raises(OutputError, match=r"is a file|cannot be written"):
        composite_evaluation.evaluate_composites(1, **paths, options=SessionOptions(model="classical"))


def test_ratios_are_of_means_over_the_same_scenes():
    scores = CompositeScores(tuple(score(k, 1.0 + k, MATERIALS[k % 3]) for k in range(6)))
    ratio = scores.ratio(OURS, SHADOW, "rmse")
    assert ratio.mean == pytest.approx(0.5)
    assert (ratio.low, ratio.high) == pytest.approx((0.5, 0.5))  # the same scenes are drawn for both
    mean = scores.mean(HARMONICS, OBJECT, "rmse")
    assert mean.low < mean.mean < mean.high
    of_object, of_shadow, _ = summary(scores)
    assert "0.50" in of_object
    assert "target 0.85: met" in of_shadow
    assert "diffuse" in list(composite_tables(scores)[3].columns[0].cells)


def drawn_scene():
    picture, covered = drawn()
    frames = tuple(
        BoxRoom().frame(camera_at((0.2, 1.4, 1.2), 10.0 * number, -30.0), index=number, width=80, height=60)
        for number in range(3)
    )
    objects = Scene((SceneObject(NAME, virtual_object("vase", "glossy"), AtPixel(30.5, 40.0)),))
    return CompositeScene(
        "room", "vase", "glossy", frames[1], objects, picture, (picture, FLOOR), covered,
        dict.fromkeys(REGIONS, covered), FLOOR, frames, 0.004,
    )  # fmt: skip


def test_pictures_of_scenes_give_objects_the_grain_of_the_frame(tmp_path):
    scene, path = drawn_scene(), tmp_path / "scene.png"
    noisy = FLOOR + np.random.default_rng(1).normal(0, 0.02, FLOOR.shape).astype(np.float32)
    scene = replace(scene, frame=replace(scene.frame, image=noisy))
    composite_evaluation.write_scene_picture(path, scene, dict.fromkeys(METHODS, FLOOR))
    sheet = cv2.imread(str(path))
    assert sheet is not None
    _, own, _, _ = np.split(sheet.astype(np.float32), 4, axis=1)
    encoded = cv2.resize(linear_to_srgb8(noisy).astype(np.float32), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    assert own[44:76, 64:96].std() == pytest.approx(encoded.std(), rel=0.3)
    assert own[:30].std() == 0  # the frame's own pixels get none


def test_a_kept_scene_is_rendered_once_and_the_same_when_it_is_read(tmp_path, monkeypatch):
    scene = drawn_scene()
    rendered, settings = [], composite_evaluation.settings_of(SessionOptions(), 3, None)

    def render(number, *, seed):
        rendered.append((number, seed))
        return scene

    monkeypatch.setattr(composite_evaluation, "scene_for", render)
    kept_scene, folder = composite_evaluation.kept_scene, tmp_path / "kept"
    assert kept_scene(None, 7, seed=3) is kept_scene(folder, 7, seed=3) is scene
    read = kept_scene(folder, 7, seed=3)
    assert rendered == [(7, 3)] * 2
    assert read.frame is read.frames[1]
    np.testing.assert_array_equal(read.frame.depth_m, scene.frame.depth_m)
    np.testing.assert_array_equal(read.truth, scene.truth)
    assert read.objects.objects[0].place == AtPixel(30.5, 40.0)
    (path,) = folder.iterdir()
    with monkeypatch.context() as other:
        other.setattr(scenes, "EVERY", 6)
        assert composite_evaluation.settings_of(SessionOptions(), 3, None) != settings
        assert kept_scene(folder, 7, seed=3) is scene
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(OutputError, match=rf"{path.name}: is damaged .* remove it"):
        kept_scene(folder, 7, seed=3)
