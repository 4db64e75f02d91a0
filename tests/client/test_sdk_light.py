"""One `Light` class: the same light from the engine, and from a response of a server through the client."""

import json
from typing import Any, get_args

import numpy as np
import pytest
from light_rooms import room

import roomlight as rl
import roomlight_client as sdk
from roomlight.light.sources import FileFormat, LightPanorama, LightUse
from roomlight.light.spherical_harmonics import SphericalHarmonics
from roomlight.wire.light_message import MEDIA_TYPE, pack_light
from roomlight.wire.messages import EncodedLight, LightResponse, ProbeLight
from roomlight_client.light import parse_lights

ROOM = room(24)
OBSERVED = np.tile(np.array([0, 1], np.float32), (24, 24))
MIRRORED = room(24)[::-1].copy()


class TwoUses:
    """Other light is seen than lights things, as from a session."""

    def panorama(self, use: LightUse) -> LightPanorama:
        return LightPanorama(ROOM if use == "lighting" else MIRRORED)

    def digest(self) -> str:
        return "two"


ENGINE = rl.Light((1.0, 0.5, -2.0), observed=OBSERVED, frame=7, name="table", source=TwoUses())
LIGHTS = ENGINE.main_light.to_json() | {"lights": [source.to_json() for source in ENGINE.lights]}
BOTH = ("npy", ("npy", "reflection"), "confidence")
FILES: tuple[FileFormat, ...] = get_args(FileFormat)


def received(*forms: Any) -> rl.Light:
    """Return `ENGINE` as a server sends it in these forms: file formats, (format, values) or (format, use)."""
    encoded, parts = [], []
    for form in forms:
        if isinstance(form, tuple) and isinstance(form[1], dict):
            encoded.append(EncodedLight(format=form[0], media_type="application/json", values=form[1]))
        else:
            name, use = form if isinstance(form, tuple) else (form, None)
            parts.append(ENGINE.file(name, use=use))
            encoded.append(EncodedLight(format=name, media_type="x", use=use, bytes=len(parts[-1])))
    result = ProbeLight(position=[1.0, 0.5, -2.0], name="table", coverage=ENGINE.coverage, etag="e", forms=encoded)
    (light,) = parse_lights(pack_light(LightResponse(frame=7, results=[result]), parts), MEDIA_TYPE)
    return light


@pytest.mark.parametrize(
    "forms",
    [
        BOTH,
        (*BOTH, *((kind, values) for kind, values in (
            ("sh", ENGINE.harmonics.to_json()),
            ("sh", ENGINE.ambient.to_json("planar")),
            ("main_light", LIGHTS),
        ))),
    ],
    ids=["computed", "sent"],
)  # fmt: skip
def test_the_same_light_comes_through_the_client(forms):
    light = received(*forms)
    assert (light.panorama == ROOM).all()
    assert (light.reflection == MIRRORED).all()
    assert (light.observed == ENGINE.observed).all()
    assert (light.position, light.frame, light.name, light.etag) == ((1.0, 0.5, -2.0), 7, "table", "e")
    assert light.coverage == ENGINE.coverage
    assert (light.main_light.direction == ENGINE.main_light.direction).all()
    assert (light.main_light.intensity == ENGINE.main_light.intensity).all()
    assert light.main_light.to_json() == ENGINE.main_light.to_json()
    for ours, theirs in ((light.harmonics, ENGINE.harmonics), (light.ambient, ENGINE.ambient)):
        assert isinstance(ours, SphericalHarmonics)
        assert ours.coefficients == pytest.approx(theirs.coefficients, rel=1e-6, abs=1e-7)  # sent as float32
        assert (ours.kind, ours.phase) == (theirs.kind, theirs.phase)
    assert (light.cube(size=64).faces == ENGINE.cube(size=64).faces).all()
    assert light.specular(size=16).to_bytes() == ENGINE.specular(size=16).to_bytes()
    assert repr(light) == repr(ENGINE)
    assert light._repr_png_() == ENGINE._repr_png_()


@pytest.mark.parametrize("name", FILES)
def test_files_are_computed_if_the_panorama_was_sent(name):
    assert received(*BOTH).file(name) == ENGINE.file(name)


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_was_sent_comes_as_it_is(name):
    assert received(name).file(name) == ENGINE.file(name)


def test_json_is_saved_from_harmonics_and_main_light(tmp_path):
    light = received(
        ("sh", ENGINE.harmonics.to_json()),
        ("sh", ENGINE.ambient.to_json()),
        ("main_light", LIGHTS),
    )
    light.save(tmp_path / "light.json")
    assert json.loads((tmp_path / "light.json").read_text()) == json.loads(json.dumps(ENGINE.to_json()))


def test_the_cube_that_was_sent_is_returned_if_its_size_fits():
    light = received("cube", "npy")
    sent = np.frombuffer(ENGINE.file("cube"), "<f2").reshape(6, 32, 32, 4)
    assert (light.cube().faces == sent[..., :3]).all()
    assert (light.cube(size=16).faces == ENGINE.cube(size=16).faces).all()
    with pytest.raises(rl.RoomLightError, match=r"requested was cube; .*LightForm\(format='cube', size=16\)"):
        received("cube").cube(size=16)


def test_without_confidence_the_alpha_is_one():
    texels = np.frombuffer(received("npy").file("cube"), "<f2").reshape(6, 32, 32, 4)
    assert (texels[..., 3] == 1).all()


@pytest.mark.parametrize(
    ("access", "request_it"),
    [
        (lambda light: light.panorama, "'npy'"),
        (lambda light: light.observed, "'confidence'"),
        (lambda light: light.main_light, "'main_light'"),
        (lambda light: light.harmonics, "LightForm(format='sh', kind='total')"),
        (lambda light: light.ambient, "LightForm(format='sh', kind='ambient')"),
        (lambda light: light.cube(), "LightForm(format='cube', size=32)"),
        (lambda light: light.file("hdr"), "'hdr'"),
        (lambda light: light.reflection, "LightForm(format='npy', use='reflection')"),
        (lambda light: light.file("hdr", use="reflection"), "LightForm(format='hdr', use='reflection')"),
        (lambda light: light.to_json(), "'main_light'"),
    ],
)
def test_a_form_that_is_missing_names_the_request(access, request_it):
    with pytest.raises(rl.RoomLightError) as caught:
        access(received("png"))
    assert f"requested was png; request it with forms=({request_it}, ...)" in str(caught.value)


def test_lights_come_beside_the_main_light():
    light = received(("main_light", LIGHTS))
    assert len(ENGINE.lights) > 0
    assert [source.to_json() for source in light.lights] == LIGHTS["lights"]


@pytest.mark.parametrize(
    "broken", [{"radius_deg": "wide"}, {"emitted": [1, 2]}, {"lights": [{"direction": [0, 1, 0]}]}, {"lights": 3}]
)
def test_lights_that_cannot_be_read_are_refused(broken):
    light = received(("main_light", LIGHTS | broken))
    with pytest.raises(sdk.BadReplyError, match="the form main_light cannot be read"):
        _ = light.lights if "lights" in broken else light.main_light
