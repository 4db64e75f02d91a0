"""Photos with a depth map inside: HEIC portraits of phones, by boxes written here."""

import random
from pathlib import Path

import formats
import heic_files
import numpy as np
import pytest

from roomlight.captures.photo import PhotoOptions, read_photo
from roomlight.conventions import srgb8_to_linear
from roomlight.errors import RoomLightError
from roomlight.images import decode_picture

LOW, HIGH = 0.25, 2.25
"""Disparities, 1 / metres."""


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A red and a blue half, the upper half at 2 m, the lower one at 1 m; and an unknown corner."""
    colour = np.zeros((96, 128, 3), np.uint8)
    colour[:, :64], colour[:, 64:] = (200, 40, 40), (40, 40, 200)
    depth_m = np.full((48, 64), 2.0)
    depth_m[24:] = 1.0
    disparity = np.rint((1 / depth_m - LOW) / (HIGH - LOW) * 255).astype(np.uint8)
    return colour, disparity


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def xmp(accuracy: str = "absolute") -> str:
    return heic_files.APPLE_XMP.format(low=LOW, high=HIGH, accuracy=accuracy, focal=3024.0)


@pytest.mark.parametrize("stated", ["xmp", "sei"])
def test_a_portraits_own_depth_is_read(tmp_path: Path, stated: str) -> None:
    colour, disparity = scene()
    text, levels = (xmp(), None) if stated == "xmp" else ("", (LOW, HIGH))
    photo = read_photo(written(tmp_path / "photo.heic", heic_files.portrait(colour, disparity, xmp=text, sei=levels)))
    depth_m = photo.frame.depth_m
    assert depth_m.shape == (48, 64)
    # half a level of 8 bits is 0.4 %; HEVC adds about two levels
    np.testing.assert_allclose([depth_m[4, 30], depth_m[44, 30]], [2.0, 1.0], rtol=0.04)
    expected = srgb8_to_linear(colour)
    np.testing.assert_allclose(photo.frame.image[40, [20, 110]], expected[40, [20, 110]], atol=0.03)
    if stated == "xmp":
        assert photo.fov_source == "depth"
        assert photo.frame.intrinsics.fx == pytest.approx(3024 / 4032 * 128)
    assert photo.notes == ()


def test_relative_depth_is_said_and_can_be_scaled(tmp_path: Path) -> None:
    path = written(tmp_path / "photo.heic", heic_files.portrait(*scene(), xmp=xmp("relative")))
    photo = read_photo(path)
    assert "relative accuracy" in photo.notes[0].left_out
    scaled = read_photo(path, options=PhotoOptions(depth_unit_m=1.5))
    np.testing.assert_allclose(scaled.frame.depth_m, 1.5 * photo.frame.depth_m, rtol=1e-6)
    assert scaled.notes == ()


def test_a_turned_portrait_comes_out_upright(tmp_path: Path) -> None:
    turn = heic_files.box(b"irot", b"\x03")  # 270 degrees counter-clockwise: clockwise by 90
    photo = read_photo(written(tmp_path / "p.heic", heic_files.portrait(*scene(), xmp=xmp(), more=(turn,))))
    assert photo.frame.image.shape == (128, 96, 3)
    assert photo.frame.depth_m.shape == (64, 48)
    red, blue = photo.frame.image[10, 48], photo.frame.image[118, 48]
    assert red[0] > 3 * red[2]
    assert blue[2] > 3 * blue[0]
    np.testing.assert_allclose([photo.frame.depth_m[30, 44], photo.frame.depth_m[30, 4]], [2.0, 1.0], rtol=0.04)


def test_the_colour_space_of_heic_is_converted() -> None:
    colour, _ = scene()
    p3 = heic_files.colour_box(codes=(12, 13, 6))
    data = heic_files.portrait(colour, None, more=(p3,))
    image = decode_picture(data, "photo.heic").image
    plain = srgb8_to_linear(colour)[40, 20]
    assert image[40, 20, 0] > 1.15 * plain[0]  # red of Display P3 lies outside sRGB


def test_depth_without_a_range_is_noted(tmp_path: Path) -> None:
    data = heic_files.portrait(*scene())
    picture = decode_picture(data, "photo.heic")
    assert "no range" in picture.notes[0].effect
    assert picture.own_depth is None
    written(tmp_path / "photo.heic", data)
    depth = written(tmp_path / "d.png", formats.image(".png", np.full((48, 64), 1500, np.uint16)))
    photo = read_photo(tmp_path / "photo.heic", depth)
    np.testing.assert_allclose(photo.frame.depth_m, 1.5, rtol=1e-6)


def test_heic_without_the_decoder_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roomlight.imaging.heic.heic_available", lambda: False)
    with pytest.raises(RoomLightError, match=r"roomlight\[heic\]"):
        decode_picture(b"\0\0\0\x18ftypheic" + bytes(99), "photo.heic")


@pytest.mark.parametrize("seed", range(12))
def test_damaged_portraits_are_read_or_refused(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    data = bytearray(heic_files.portrait(*scene(), xmp=xmp()))
    for _ in range(rng.randrange(1, 8)):
        data[rng.randrange(rng.choice([len(data), 600]))] ^= 1 << rng.randrange(8)
    cut = len(data) if rng.random() < 0.7 else rng.randrange(len(data))
    path = written(tmp_path / "photo.heic", bytes(data[:cut]))
    refusal = None
    try:
        frame = read_photo(path).frame
        assert np.isfinite(frame.image).all()
        assert np.isfinite(frame.depth_m).all()
    except RoomLightError as error:
        refusal = error
    assert refusal is None or str(path) in str(refusal)
