import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from light_rooms import lit, room

from roomlight.conventions import panorama_directions
from roomlight.light.checks import check_panorama
from roomlight.light.main_light import main_light
from roomlight.light.spherical_harmonics import SphericalHarmonics, basis, project


@given(seed=st.integers(0, 2**32 - 1), height=st.sampled_from([4, 5, 16, 47, 120]))
@settings(max_examples=20, deadline=None)
@pytest.mark.parametrize("phase", ["condon-shortley", "positive"])
def test_light_of_nine_harmonics_comes_back_exactly(phase, seed: int, height: int) -> None:
    coefficients = np.random.default_rng(seed).normal(size=(9, 3))
    directions = panorama_directions(height).reshape(-1, 3)
    panorama = (basis(directions, phase=phase) @ coefficients).reshape(height, 2 * height, 3)
    found = project(panorama, phase=phase)
    # The remainder is rounding: the panorama, its directions and the row sums are float32.
    np.testing.assert_allclose(found.coefficients, coefficients, atol=3e-6)
    np.testing.assert_allclose(found.evaluate(directions), panorama.reshape(-1, 3), atol=1e-5)
    assert found.phase == phase
    assert (found.kind, found.quantity) == ("total", "radiance")


def test_arcore_and_threejs_shade_alike_from_their_own_signs() -> None:
    """Both formulas as in the shaders of ARCore and three.js, with their constants."""
    panorama = room(60)
    normals = np.random.default_rng(0).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    x, y, z = normals.T[..., None]

    c = project(panorama).flat("interleaved").reshape(9, 3)
    factors = [0.282095, -0.325735, 0.325735, -0.325735, 0.273137, -0.273137, 0.078848, -0.273137, 0.136569]
    p = c * np.array(factors)[:, None]
    arcore = p[0] + p[1] * y + p[2] * z + p[3] * x + p[4] * x * y + p[5] * y * z
    arcore = arcore + p[6] * (3 * z * z - 1) + p[7] * z * x + p[8] * (x * x - y * y)

    c = project(panorama, phase="positive").flat("interleaved").reshape(9, 3)
    three = c[0] * 0.886227 + c[1] * 2 * 0.511664 * y + c[2] * 2 * 0.511664 * z + c[3] * 2 * 0.511664 * x
    three = three + c[4] * 2 * 0.429043 * x * y + c[5] * 2 * 0.429043 * y * z
    three = three + c[6] * (0.743125 * z * z - 0.247708) + c[7] * 2 * 0.429043 * x * z
    three = three + c[8] * 0.429043 * (x * x - y * y)

    np.testing.assert_allclose(arcore * np.pi, three, rtol=1e-4)
    np.testing.assert_allclose(three, project(panorama).irradiance().evaluate(normals), rtol=1e-4)


def test_layouts() -> None:
    harmonics = SphericalHarmonics(np.arange(27, dtype=np.float64).reshape(9, 3))
    assert harmonics.flat("interleaved").tolist() == list(range(27))
    planar = harmonics.flat("planar")
    assert planar[:9].tolist() == list(range(0, 27, 3))  # all of red first
    assert planar[9:18].tolist() == list(range(1, 27, 3))
    assert planar.dtype == np.float32
    for layout in ("interleaved", "planar"):
        back = SphericalHarmonics.from_flat(
            harmonics.flat(layout), layout=layout, phase="positive", quantity="irradiance", kind="ambient"
        )
        np.testing.assert_array_equal(back.coefficients, harmonics.coefficients)
        assert (back.phase, back.quantity, back.kind) == ("positive", "irradiance", "ambient")


def test_both_phases_are_the_same_light() -> None:
    directions = panorama_directions(6).reshape(-1, 3)
    phased = project(room(20))
    positive = phased.with_phase("positive")
    assert phased.with_phase("condon-shortley") is phased
    np.testing.assert_allclose(positive.evaluate(directions), phased.evaluate(directions), atol=1e-12)
    np.testing.assert_array_equal(positive.with_phase("condon-shortley").coefficients, phased.coefficients)
    irradiance = phased.irradiance()
    assert irradiance.irradiance() is irradiance
    np.testing.assert_allclose(positive.irradiance().evaluate(directions), irradiance.evaluate(directions), rtol=1e-12)


@pytest.mark.parametrize("phase", ["condon-shortley", "positive"])
def test_total_is_ambient_and_the_main_light_together(phase) -> None:
    panorama = room(60)
    light = main_light(panorama)
    total, ambient = project(panorama, phase=phase), project(panorama, kind="ambient", phase=phase)
    assert ambient.kind == "ambient"
    point = basis(light.direction[None], phase=phase)[0][:, None] * light.intensity
    np.testing.assert_allclose(ambient.coefficients + point, total.coefficients, atol=1e-12)
    given = project(panorama, kind="ambient", phase=phase, light=light)
    np.testing.assert_array_equal(given.coefficients, ambient.coefficients)


def test_ambient_is_the_room_without_its_lamp() -> None:
    dark = lit(120, [], level=0.3)
    lamp = lit(120, [((0.3, 0.9, 0.2), 6, [20.0, 15.0, 10.0])], level=0.3)
    ambient = project(lamp, kind="ambient")
    # A lamp of 6 degrees is a point to nine harmonics within 1 - cos(6) (1 + cos(6)) / 2 = 0.8 %.
    lamp_alone = project(lamp).coefficients - project(dark).coefficients
    np.testing.assert_allclose(ambient.coefficients, project(dark).coefficients, atol=0.02 * np.abs(lamp_alone).max())


@pytest.mark.parametrize(
    ("shape", "rule"),
    [((8, 16), r"\(H, 2H, 3\)"), ((8, 16, 4), r"\(H, 2H, 3\)"), ((8, 17, 3), "17 x 8"), ((3, 6, 3), "4 to 4096 rows")],
)
def test_invalid_panorama_shapes(shape, rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        check_panorama(np.zeros(shape, np.float32))


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, bool, complex])
def test_encoded_panoramas_are_refused(dtype) -> None:
    with pytest.raises(ValueError, match=r"linear float RGB, got .*; roomlight\.conventions\.srgb8_to_linear decodes"):
        check_panorama(np.zeros((8, 16, 3), dtype))


def test_invalid_numbers() -> None:
    panorama = lit(8, [], level=1.0)
    for value in (np.nan, np.inf, -np.inf):
        panorama[3, 5, 1] = value
        with pytest.raises(ValueError, match=r"finite numbers only, got .* in row 3, column 5"):
            project(panorama)
        with pytest.raises(ValueError, match="finite"):
            SphericalHarmonics(np.full((9, 3), value))
    with pytest.raises(ValueError, match="finite"):  # beyond float32
        check_panorama(np.full((8, 16, 3), 1e300))
    with pytest.raises(ValueError, match="27 numbers, got 26"):
        SphericalHarmonics.from_flat(np.zeros(26), layout="planar", phase="positive")
    light, total = main_light(room(16)), project(room(16))
    for harmonics, kind in ((total.irradiance(), "total irradiance"), (total.without(light), "ambient radiance")):
        with pytest.raises(ValueError, match=f"not from {kind}"):
            harmonics.without(light)
