"""The Mitsuba scene of the composites' truth: camera, depth and object agree with RoomLight's conventions."""

import cv2
import numpy as np
import pytest

from roomlight.engine.session import SessionOptions
from roomlight_evaluation.composites.methods import OURS, composites
from roomlight_evaluation.composites.mitsuba import VIEWS, MitsubaView, mitsuba_scene


@pytest.mark.slow
@pytest.mark.parametrize("view", [VIEWS[2], VIEWS[4]], ids=lambda view: view.name)
def test_the_composite_covers_the_rendered_object(view: MitsubaView):
    pytest.importorskip("mitsuba")
    scene = mitsuba_scene(view, samples=4)
    images = composites(scene, scene.session(SessionOptions(model="classical", height=32)), quality="preview")
    changed = np.abs(images[OURS] - scene.frame.image).max(axis=-1) > 0.02
    assert scene.covered.sum() > 100
    assert changed[scene.masks["object"]].mean() > 0.9
    affected = (scene.covered | scene.masks["shadow"]).astype(np.uint8)
    away = cv2.dilate(affected, np.ones((11, 11), np.uint8)) == 0  # the two shadows end at different places
    assert changed[away].mean() < 0.02
    v, u = np.argwhere(scene.covered).mean(axis=0)
    assert np.hypot(u - 100, v - 75) < 12  # the camera looks at the object
