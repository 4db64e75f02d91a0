"""The trained weights in the package: complete, small, documented, and as good as the classical model in the sample."""

import json

import numpy as np
import pytest

from roomlight.captures import open_capture
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.metrics import log_l2
from roomlight.sample import sample_capture
from roomlight.spheres import SphereRenderer, view_toward
from sessions import session_of

FOLDER = SHIPPED / "single"


def test_weights_are_under_20_mb_and_the_card_states_the_origin():
    assert sum(path.stat().st_size for path in FOLDER.rglob("*")) < 20e6
    card = json.loads((FOLDER / "model.json").read_text())["card"]
    assert card["steps"] > 0
    assert sum(share["sequences"] for share in card["data"]) == card["sequences"]
    assert all(isinstance(share["seed"], int) for share in card["data"])
    assert card["scores"]["log_l2_blended"] < card["scores"]["log_l2_warp"] < card["scores"]["log_l2_mean_colour"]


def scored(frames, probes):
    """(log-L2, squared error of a glossy sphere) after these frames of the sample room, a room never trained on."""
    found = {}
    for model in ("single", "classical"):
        session = session_of(frames, probes=[probe.position for probe in probes], model=model, provider="cpu")
        errors = []
        for answer, probe in zip(session.lights(), probes, strict=True):
            light, truth = answer.reflection, probe.panorama()
            spheres = SphereRenderer(view_toward(frames[0].camera_to_world, probe.position))
            drawn = [np.minimum(spheres.pixels(panorama, "glossy"), 1) for panorama in (light, truth)]
            errors.append((log_l2(light, truth), float(np.square(drawn[0] - drawn[1]).mean())))
        found[model] = np.mean(errors, axis=0)
    return found


@pytest.mark.slow
def test_a_walk_keeps_the_accuracy_of_the_first_frames():
    """Every tenth frame of the sample's walk, which ends at another wall: without memory each replaces the others.

    Measured: 0.95 of the classical model's error of spheres, 1.15 of its log-L2.
    """
    capture = open_capture(sample_capture())
    after = scored(list(capture)[::10], capture.probes)
    assert after["single"][1] < 1.1 * after["classical"][1]
    assert after["single"][0] < 1.2 * after["classical"][0]


def test_light_of_one_frame_is_as_good_as_the_classical_models_and_better_than_a_mean_colour():
    """Measured: 1.00 (spheres; over many rooms they are lit better) and 0.94 of the classical model's errors; 0.53 of
    those of the frame's mean colour.
    """
    capture = open_capture(sample_capture())
    first = next(iter(capture))
    scores = scored([first], capture.probes)
    assert (scores["single"] < 1.1 * scores["classical"]).all()
    colour = first.image.mean(axis=(0, 1))
    errors = [log_l2(np.full_like(truth, colour), truth) for truth in (probe.panorama() for probe in capture.probes)]
    assert scores["single"][0] < 0.65 * np.mean(errors)
