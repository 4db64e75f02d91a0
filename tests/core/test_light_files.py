from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from light_rooms import lit, room

from roomlight.conventions import linear_to_srgb8, panorama_directions
from roomlight.engine.panorama.blend import PanoramaState
from roomlight.images import decode_colour, decode_grey8, write_exr
from roomlight.light.coverage import confidence_png, coverage
from roomlight.light.encode import to_exr, to_hdr, to_png


def test_exr_is_the_file_that_is_written(tmp_path: Path) -> None:
    panorama = room(24)
    data = to_exr(panorama, metadata={"roomlight:interpolated": "true"})
    write_exr(tmp_path / "a.exr", panorama, metadata={"roomlight:interpolated": "true"})
    assert data == (tmp_path / "a.exr").read_bytes()
    assert data == to_exr(panorama, metadata={"roomlight:interpolated": "true"})
    assert b"roomlight:interpolated" in data
    decoded, clipped = decode_colour(data, "light.exr")
    np.testing.assert_allclose(decoded, panorama, rtol=2**-11)
    assert not clipped.any()
    assert (decode_colour(to_exr(lit(8, [], level=1e9)), "light.exr")[0] == 65504).all()  # no infinity


@given(
    seed=st.integers(0, 1000), scale=st.sampled_from([1e-6, 0.01, 1.0, 255.5, 3e4]), height=st.sampled_from([4, 8, 30])
)
@settings(max_examples=20, deadline=None)
def test_hdr_is_within_its_mantissa_and_unbiased(seed: int, scale: float, height: int) -> None:
    panorama = np.random.default_rng(seed).random((height, 2 * height, 3), np.float32) * np.float32(scale)
    panorama[0, 0] = 0
    decoded, _ = decode_colour(to_hdr(panorama), "light.hdr")
    error = (decoded - panorama) / np.maximum(panorama.max(axis=-1, keepdims=True), 1e-30)
    # A step is 1/256 to 1/128 of the brightest channel: rounding errs by half a step, 1.5/256 where it carries over.
    assert np.abs(error).max() < 1.504 / 256
    assert np.abs(error).mean() < 1 / 500
    assert abs(error.mean()) < 2e-3 / np.sqrt(height)
    assert decoded[0, 0].tolist() == [0, 0, 0]


def test_hdr_of_a_room_keeps_its_light() -> None:
    decoded, _ = decode_colour(to_hdr(room(120)), "light.hdr")
    assert decoded.mean() == pytest.approx(room(120).mean(), rel=3e-4)
    negative, _ = decode_colour(to_hdr(lit(8, [], level=-1.0)), "light.hdr")
    assert not negative.any()
    huge, _ = decode_colour(to_hdr(lit(8, [], level=3e38)), "light.hdr")
    assert np.isfinite(huge).all()


def pixels_of(png: bytes) -> np.ndarray:
    """Decode a PNG to pixels [H, W, 3], BGR."""
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    return pixels


@pytest.mark.parametrize("exposure_ev", [-3.0, -0.5, 0.0, 1.0, 16.0])
def test_png_is_white_at_its_exposure(exposure_ev: float) -> None:
    white = np.float32(2.0**-exposure_ev)
    panorama = np.zeros((8, 16, 3), np.float32)
    panorama[0], panorama[1], panorama[2] = white, white * 4, white * np.float32(0.18)
    data = to_png(panorama, exposure_ev=exposure_ev)
    pixels = pixels_of(data)
    assert (pixels[:2] == 255).all()
    assert (pixels[2] == 118).all()  # 18 % grey in sRGB
    assert not pixels[3:].any()


def test_png_without_exposure_is_the_panorama_in_srgb() -> None:
    pixels = pixels_of(to_png(room(24)))
    np.testing.assert_array_equal(pixels[..., ::-1], linear_to_srgb8(room(24)))


@pytest.mark.parametrize(
    ("calls", "given", "rule"),
    [
        ((to_exr, to_hdr, to_png), np.zeros((8, 8, 3), np.float32), "twice as wide as high"),
        ((to_exr, to_hdr, to_png), np.full((8, 16, 3), np.nan, np.float32), "finite"),
        *(
            ((lambda p, ev=ev: to_png(p, exposure_ev=ev),), room(8), f"-16 to 16 EV, got {ev}")
            for ev in (np.nan, 16.5, -17.0)
        ),
        ((coverage, confidence_png), np.zeros((8, 15)), "15 x 8"),
        ((coverage, confidence_png), np.full((8, 16), 1.5), r"lies in \[0, 1\], got 1.5 to 1.5"),
        ((coverage, confidence_png), np.full((8, 16), -0.1), r"lies in \[0, 1\]"),
        ((coverage, confidence_png), np.full((8, 16), np.nan), "finite"),
        ((coverage, confidence_png), np.zeros((2, 4)), "4 to 4096 rows, this has 2"),
    ],
)
def test_invalid_planes_are_refused(calls, given, rule: str) -> None:
    for call in calls:
        with pytest.raises(ValueError, match=rule):
            call(given)


@pytest.mark.parametrize("height", [4, 33, 120])
def test_coverage_is_by_solid_angle(height: int) -> None:
    rng = np.random.default_rng(height)
    observed = rng.random((height, 2 * height)).astype(np.float32)
    state = PanoramaState.fresh(height, 3.0)
    state.observed[:] = observed
    assert coverage(observed) == pytest.approx(state.coverage(), rel=1e-5)
    assert coverage(np.zeros_like(observed)) == 0
    assert coverage(np.ones_like(observed)) == pytest.approx(1, rel=1e-6)
    cap = (panorama_directions(240)[..., 1] > 0.5).astype(np.float32)  # 60 degrees about +Y: a quarter of the sphere
    assert coverage(cap) == pytest.approx(0.25, rel=0.01)


def test_confidence_as_png() -> None:
    observed = np.random.default_rng(0).random((24, 48)).astype(np.float32)
    observed[0, :2] = 0, 1
    grey = decode_grey8(confidence_png(observed), "confidence.png")
    assert grey[0, :2].tolist() == [0, 255]
    assert np.abs(grey / 255 - observed).max() <= 0.5 / 255 + 1e-6
