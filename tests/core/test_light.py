"""`Light` as the engine makes it: its forms, files, errors and notebook picture."""

import inspect
import io
import json
import pickle

import cv2
import numpy as np
import pytest
from light_rooms import room

from roomlight.conventions import NO_FRAME
from roomlight.errors import OptionError
from roomlight.images import decode_colour, decode_grey8
from roomlight.light.coverage import coverage
from roomlight.light.cube import CubeMap, observed_cube
from roomlight.light.light import SAVED_AS, Light
from roomlight.light.main_light import main_light
from roomlight.light.prefilter import prefilter
from roomlight.light.sources import LightPanorama, LightUse
from roomlight.light.spherical_harmonics import SphericalHarmonics, project

ROOM = room(24)
OBSERVED = np.zeros((24, 48), np.float32)
OBSERVED[:, :24] = 1


@pytest.fixture
def light():
    return Light((1.0, 0.5, -2.0), ROOM, OBSERVED, frame=7, name="table")


def test_forms_are_those_of_the_panorama(light):
    np.testing.assert_array_equal(light.panorama, ROOM)
    np.testing.assert_array_equal(light.observed, OBSERVED)
    assert light.coverage == coverage(OBSERVED)
    assert (light.main_light.direction == main_light(ROOM).direction).all()
    assert (light.harmonics.coefficients == project(ROOM).coefficients).all()
    assert (light.ambient.coefficients == project(ROOM, kind="ambient").coefficients).all()
    assert (light.harmonics.kind, light.ambient.kind) == ("total", "ambient")
    assert (light.cube().faces == CubeMap.from_panorama(ROOM, size=32).faces).all()
    assert light.cube(size=64).size == 64
    specular, expected = light.specular(size=16), prefilter(CubeMap.from_panorama(ROOM, size=16))
    assert specular.to_bytes() == expected.to_bytes()


def test_cube_file_has_observed_as_alpha(light):
    cube, alpha = light.cube(size=16), observed_cube(OBSERVED, size=16)
    assert light.file("cube", size=16) == cube.to_bytes(alpha)
    assert light.file("ktx2", size=16) == cube.to_ktx2(alpha)


def test_files_of_other_sizes(light):
    assert decode_colour(light.file("exr", size=12), "exr")[0].shape == (12, 24, 3)
    assert np.load(io.BytesIO(light.file("npy", size=48))).shape == (48, 96, 3)
    assert decode_grey8(light.file("confidence", size=8), "confidence").shape == (8, 16)
    assert light.file("png", exposure_ev=1.0) != light.file("png")


def test_save_writes_what_the_suffix_says(light, tmp_path):
    for suffix in SAVED_AS:
        light.save(tmp_path / f"light{suffix}")
    exr, _ = decode_colour((tmp_path / "light.exr").read_bytes(), "exr")
    np.testing.assert_allclose(exr, ROOM, rtol=2**-11)
    assert f"{light.coverage:.4f}".encode() in (tmp_path / "light.exr").read_bytes()
    hdr, _ = decode_colour((tmp_path / "light.hdr").read_bytes(), "hdr")
    np.testing.assert_allclose(hdr, ROOM, atol=float(ROOM.max()) / 128)
    assert (tmp_path / "light.png").read_bytes() == light.file("png")
    assert (tmp_path / "light.ktx2").read_bytes() == light.file("ktx2", size=32)
    assert (tmp_path / "light.equirect.ktx2").read_bytes() == light.file("equirect")
    assert {path.name for path in tmp_path.iterdir()} == {f"light{end}" for end in SAVED_AS}  # no temporary is left


def test_save_takes_text_and_capitals(light, tmp_path):
    light.save(str(tmp_path / "new folder" / "LIGHT.EXR"))
    assert (tmp_path / "new folder" / "LIGHT.EXR").read_bytes() == light.file("exr")


def test_json_reads_back_as_the_same_light(light, tmp_path):
    light.save(tmp_path / "light.json")
    read = json.loads((tmp_path / "light.json").read_text())
    assert (read["position"], read["frame"], read["name"]) == ([1.0, 0.5, -2.0], 7, "table")
    assert read["coverage"] == light.coverage
    assert read["main_light"]["direction"] == light.main_light.direction.tolist()
    assert read["main_light"]["intensity"] == light.main_light.intensity.tolist()
    for name, expected in (("harmonics", light.harmonics), ("ambient", light.ambient)):
        stated = {key: read[name][key] for key in ("layout", "phase", "quantity", "kind")}
        harmonics = SphericalHarmonics.from_flat(np.array(read[name]["coefficients"]), **stated)
        assert harmonics.coefficients == pytest.approx(expected.coefficients, rel=1e-6)
        assert (harmonics.phase, harmonics.kind) == (expected.phase, expected.kind)
    assert "y up" in read["conventions"]["position"]


@pytest.mark.parametrize("name", ["light.tiff", "light", ".exr"])
def test_other_suffixes_name_those_that_work(light, tmp_path, name):
    with pytest.raises(OptionError, match=r"\.exr, \.hdr, \.confidence\.png, .*, \.usdz, \.glb, \.json"):
        light.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        *((lambda light, n=size: light.cube(size=n), "16, 32, 64, 128, 256") for size in (0, 20, 512)),
        (lambda light: light.file("ktx2", size=20), "16, 32, 64, 128, 256"),
        *(
            (lambda light, f=form: light.file(f, size=2), "4 to 4096 rows, got 2")
            for form in ("exr", "npy", "confidence")
        ),
        (lambda light: light.file("png", exposure_ev=17.0), "-16 to 16 EV"),
        # past the checks of the test run
        (lambda light: inspect.unwrap(Light.used_for)(light, "mirror"), "lighting, reflection; got 'mirror'"),
    ],
)
def test_an_option_out_of_its_range_is_refused(light, call, message):
    with pytest.raises(OptionError, match=message):
        call(light)


def test_a_light_of_a_panorama_alone(light):
    reused = ROOM.copy()
    alone = Light((0.0, 0.0, 0.0), reused)
    reused[:] = 0
    np.testing.assert_array_equal(alone.panorama, ROOM)
    assert alone.coverage == pytest.approx(1, abs=1e-6)
    assert alone.observed.all()
    assert alone.etag is None
    assert not light.is_prior
    assert Light((0.0, 0.0, 0.0), ROOM, OBSERVED, 0.0, frame=NO_FRAME).is_prior
    with pytest.raises(ValueError, match="got none of them"):
        Light((0.0, 0.0, 0.0))


def test_a_notebook_shows_the_tone_mapped_panorama(light):
    picture = cv2.imdecode(np.frombuffer(light._repr_png_(), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (24, 48, 3)
    assert picture.max() == 255  # the window is brighter than white
    assert light._repr_png_() == light.file("png")


def test_repr_is_one_short_line(light):
    assert repr(light) == "Light(position=(1, 0.5, -2), frame=7, coverage=0.500, name='table')"
    assert "name" not in repr(Light((0.0, 0.0, 0.0), ROOM))


class TwoUses:
    """A source of two panoramas that counts how often it computes them."""

    def __init__(self) -> None:
        self.runs: list[LightUse] = []

    def panorama(self, use: LightUse) -> LightPanorama:
        self.runs.append(use)
        return LightPanorama(ROOM if use == "lighting" else 2 * ROOM)

    def digest(self) -> str:
        return "source"


def test_a_light_is_computed_when_it_is_asked_for_and_once_for_each_use():
    source = TwoUses()
    light = Light((0.0, 0.0, 0.0), observed=OBSERVED, source=source)
    assert light.digest()
    assert source.runs == []
    mirrored = light.used_for("reflection")
    assert (mirrored.panorama == 2 * light.panorama).all()
    assert (light.reflection == mirrored.panorama).all()
    assert source.runs == ["reflection", "lighting"]


def test_a_light_is_pickled_with_what_was_computed():
    light = Light((1.0, 0.5, -2.0), ROOM, OBSERVED, frame=7)
    assert light.main_light.intensity.any()
    other = pickle.loads(pickle.dumps(light))
    assert other.to_json() == light.to_json()
    assert other.main_light != light.main_light
    np.testing.assert_array_equal(other.panorama, ROOM)


def test_a_panorama_is_checked():
    with pytest.raises(ValueError, match=r"shape \(H, 2H, 3\), got \(24, 48, 4\)"):
        inspect.unwrap(Light.__init__)(object.__new__(Light), (0.0, 0.0, 0.0), np.ones((24, 48, 4), np.float32))
    with pytest.raises(ValueError, match="finite numbers only, got"):
        Light((0.0, 0.0, 0.0), np.full((24, 48, 3), np.nan, np.float32))
    with pytest.raises(ValueError, match=r"observed \(8, 16\) and the panorama \(24, 48, 3\)"):
        inspect.unwrap(Light.__init__)(object.__new__(Light), (0.0, 0.0, 0.0), ROOM, np.ones((8, 16), np.float32))


def test_forms_are_of_lighting_but_for_pictures():
    light = Light((0.0, 0.0, 0.0), observed=OBSERVED, source=TwoUses())
    mirrored = light.used_for("reflection")
    for name in ("exr", "hdr", "npy", "cube", "ktx2", "specular"):
        assert light.file(name) == light.file(name, use="lighting") != mirrored.file(name)
        assert mirrored.file(name) == light.file(name, use="reflection")
    assert light.file("png") == mirrored.file("png") != light.file("png", use="lighting")
    assert mirrored.harmonics.coefficients == pytest.approx(2 * light.harmonics.coefficients)
    assert mirrored.main_light.intensity == pytest.approx(2 * light.main_light.intensity, rel=1e-3)


def test_equal_sources_have_equal_digests():
    assert Light((0.0, 0.0, 0.0), ROOM).digest() == Light((1.0, 0.0, 0.0), ROOM.copy()).digest()
    assert Light((0.0, 0.0, 0.0), ROOM).digest() != Light((0.0, 0.0, 0.0), 2 * ROOM).digest()
