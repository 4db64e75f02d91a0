"""Light by its use: what was measured stays, the network changes the rest of what lights things."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from part_models import write_part
from roomlight.captures import open_capture
from roomlight.conventions import LUMINANCE, panorama_rays, panorama_solid_angles
from roomlight.engine.lighting import (
    LIGHTING_PANELS,
    LightingModel,
    lighting_panels,
    shipped_lighting,
    unmeasured_share,
)
from roomlight.engine.networks.graphs import load_part
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.engine.panorama.panels import BRIGHTEST, HEIGHT
from roomlight.frame import Frame
from roomlight.sample import sample_capture
from roomlight_evaluation.objects.lit_objects import SPHERES, LitObjects
from rooms import BoxRoom, camera_at
from sessions import session_of

PLACE = (0.3, 0.4, -1.0)


def state_of(rows: int = 120, *, seed: int = 0) -> PanoramaState:
    """Return a place of which half was seen, with clipped light on the upper quarter."""
    rng = np.random.default_rng(seed)
    state = PanoramaState.fresh(rows, 5.0)
    state.radiance[:] = rng.exponential(1, state.radiance.shape)
    state.observed[:, :rows] = 1
    state.clipped[: rows // 4, :rows] = 1
    state.guessed[: rows // 4, :rows] = 0.5 * (state.radiance @ LUMINANCE)[: rows // 4, :rows]
    return state


def known_model(folder: Path, *, constant: float = 0.0, image: float = 0.0) -> LightingModel:
    path = write_part(folder / f"objects-{len(list(folder.iterdir()))}", "objects", constant=constant, image=image)
    return LightingModel(load_part(path, "objects", provider="cpu"))


@pytest.mark.parametrize("rows", [16, 32, 60, 120, 200])
def test_measured_light_keeps_its_bits(rows: int, tmp_path: Path) -> None:
    state = state_of(rows)
    lighting = known_model(tmp_path, constant=0.7).panorama(state)
    measured = (state.observed == 1) & (state.guessed == 0)
    assert lighting.dtype == np.float32
    assert_array_equal(lighting[measured], state.radiance[measured])
    gain = np.log1p(lighting) - np.log1p(state.radiance)
    assert_allclose(gain[state.guessed > 0], 0.35, rtol=1e-3, atol=1e-5)  # half of it is an estimate
    assert_allclose(gain[state.observed == 0], 0.7, rtol=1e-4, atol=1e-5)


def test_unseen_light_changes_by_the_network(tmp_path: Path) -> None:
    """The known graph changes light by what was seen."""
    state = state_of()
    planes = lighting_panels(state)[:3]
    inside = state.observed == 0
    inside[:, [119, 120, 121, 122, -1, -2, -3]] = False  # changes are interpolated there
    expected = 0.1 * np.moveaxis(planes, 0, -1).repeat(2, axis=0).repeat(2, axis=1)
    gain = np.log1p(known_model(tmp_path, image=0.1).panorama(state)) - np.log1p(state.radiance)
    assert_allclose(gain[inside], expected[inside], atol=0.02)


def test_no_colour_channel_is_special() -> None:
    """A single run of the shipped network gives other light where the channels stand in another order."""
    state, turned = state_of(), state_of()
    turned.radiance[:] = np.roll(state.radiance, 1, axis=-1)
    unseen = state.observed == 0
    lighting, expected = (shipped_lighting("cpu").panorama(each)[unseen] for each in (turned, state))
    assert_allclose(lighting, np.roll(expected, 1, axis=-1), rtol=1e-3)


def test_panels_are_what_frames_have_shown_and_the_estimate_for_clipped_pixels() -> None:
    state = state_of()
    panels = lighting_panels(state)
    assert panels.shape == (LIGHTING_PANELS, HEIGHT, 2 * HEIGHT)
    assert_allclose(panels[9], state.guessed.reshape(60, 2, 120, 2).mean(axis=(1, 3)), rtol=1e-4, atol=1e-6)
    assert_allclose(panels[3], np.repeat([[1.0] * 60 + [0.0] * 60], 60, axis=0))
    state.guessed[:] = 1e9
    assert lighting_panels(state)[9].max() == BRIGHTEST


def test_unmeasured_share_is_what_was_not_measured() -> None:
    state = state_of()
    state.observed[-1, 0] = 0.25
    share = unmeasured_share(state)
    assert share[-1, 0] == 0.75
    assert share[-1, 1] == 0
    assert share[-1, -1] == 1
    assert_allclose(share[0, 0], 0.5, rtol=1e-5)


@pytest.fixture
def room() -> BoxRoom:
    return BoxRoom(size_m=(5.0, 2.6, 4.5), lamp=((0.5, 2.6, 0.3), 0.3))


def view(room: BoxRoom, pitch: float = 0.0, *, yaw: float = 0.0, index: int = 0) -> Frame:
    return room.frame(camera_at((0.2, 1.4, 1.2), yaw, pitch), index=index, width=64, height=48)


@pytest.mark.parametrize("model", ["classical", "single"])
def test_every_model_has_light_of_both_uses(model: str, room: BoxRoom) -> None:
    session = session_of([view(room, -35.0)], model=model, height=32)
    handle = session.track(PLACE)
    state = session.panorama_state(handle)
    own, unseen = state.radiance.copy(), state.observed < 0.01
    light = session.light(handle)
    assert unseen.any()
    assert (light.panorama[unseen] != own[unseen]).any(axis=-1).mean() > 0.9
    assert_array_equal(light.reflection, own)
    assert_array_equal(state.radiance, own)  # the session's own estimate stays


def test_light_is_that_of_its_frame_however_late_it_is_asked_for(room: BoxRoom) -> None:
    session = session_of([view(room, -35.0)], height=32)
    handle = session.track(PLACE)
    asked, waiting = session.light(handle), session.light(handle)
    before, lights = asked.panorama.copy(), asked.main_light.to_json()
    session.push(view(room, yaw=90.0, index=1))
    assert_array_equal(waiting.panorama, before)
    assert waiting.main_light.to_json() == lights
    assert waiting.digest() == asked.digest() != session.light(handle).digest()


def test_main_light_and_ambient_shade_a_sphere_as_the_light_that_lights_things(room: BoxRoom) -> None:
    light = session_of([view(room, 20.0)], probes=[PLACE], height=32).light(0)
    own = light.used_for("reflection")
    assert own.main_light.intensity.max() > 0
    assert_array_equal(light.main_light.direction, own.main_light.direction)
    normals = panorama_rays(12).astype(np.float64)
    cosines = np.maximum(normals @ panorama_rays(32).T.astype(np.float64), 0)
    lit = (cosines * np.repeat(panorama_solid_angles(32)[:, 0], 64)) @ light.panorama.reshape(-1, 3)
    facing = np.maximum(normals @ light.main_light.direction, 0)[:, None]
    both = light.ambient.irradiance().evaluate(normals) + facing * light.main_light.intensity
    assert np.abs(both - lit).mean() < 0.05 * lit.mean()
    toward = lit[np.argmax(normals @ light.main_light.direction)]
    share = (light.main_light.intensity / toward) @ LUMINANCE
    assert share == pytest.approx(light.main_light.shadow_strength, rel=0.1)


@pytest.mark.slow
def test_objects_are_lit_better_than_by_the_session() -> None:
    """At the true probes of the sample room, after every second frame of its whole walk."""
    capture = open_capture(sample_capture())
    probes = capture.truths
    session = session_of(list(capture)[::2], probes=[probe.position for probe in probes], model="single")
    own, lit = dict.fromkeys(SPHERES, 0.0), dict.fromkeys(SPHERES, 0.0)
    for probe, handle in zip(probes, session.handles, strict=True):
        objects = LitObjects(probe.panorama(), (0.0, -0.5, -0.866))
        before, after = (
            objects.errors(panorama) for panorama in (session.light(handle).reflection, session.light(handle).panorama)
        )
        for look in SPHERES:
            own[look] += before[look]
            lit[look] += after[look]
    assert lit["diffuse"] < own["diffuse"]
    assert lit["glossy"] < own["glossy"]
