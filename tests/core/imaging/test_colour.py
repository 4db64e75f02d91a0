"""Colour spaces: values of the standards, and the same fact stated in every way in which files state it."""

import io
import struct
import zlib
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms
from PIL.PngImagePlugin import PngInfo
from slow_images import chunk

from colour_profiles import matrix_profile
from roomlight.conventions import srgb_to_linear
from roomlight.errors import ImageError
from roomlight.images import decode_picture
from roomlight.imaging.colour_spaces import DISPLAY_P3, REC709, ColourSpace, to_rec709
from roomlight.imaging.other_formats import as_png

RED = np.full((8, 8, 3), (200, 40, 40), np.uint8)
# Linear sRGB of the Display P3 colour (200, 40, 40): the curve is sRGB's, the matrix that of SMPTE EG 432-1.
P3_RED = np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]]) @ [
    0.5776,
    0.0212,
    0.0212,
]


def png(pixels: np.ndarray, *chunks: bytes) -> bytes:
    data = cv2.imencode(".png", pixels[..., ::-1])[1].tobytes()
    return data[:33] + b"".join(chunks) + data[33:]


def saved(kind: str, pixels: np.ndarray | Image.Image = RED, **extra: object) -> bytes:
    stream = io.BytesIO()
    image = Image.fromarray(pixels) if isinstance(pixels, np.ndarray) else pixels
    image.save(stream, kind, **extra)
    return stream.getvalue()


def linear_of(data: bytes) -> np.ndarray:
    return decode_picture(data, "x").image[4, 4]


def test_matrices_are_those_of_the_standards() -> None:
    bt2020 = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]  # BT.2087
    np.testing.assert_allclose(to_rec709(ColourSpace.of_codes(9, 1).primaries), bt2020, atol=2e-4)
    np.testing.assert_allclose(to_rec709(REC709), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(to_rec709(DISPLAY_P3) @ np.ones(3), np.ones(3), atol=1e-9)


def test_curves_of_hlg_and_pq_are_those_of_bt2100() -> None:
    codes = np.array([[[0, 0, 0], [128, 128, 128], [191, 191, 191], [255, 255, 255]]], np.uint8)
    hlg = ColourSpace.of_codes(1, 18).to_linear(codes)[0, :, 0]
    np.testing.assert_allclose(hlg, [0, (128 / 255 - 0.55991073) * 0 + 0.0842, 0.2625, 1.0], atol=2e-3)
    pq = ColourSpace.of_codes(1, 16).to_linear(codes)[0, :, 0]
    np.testing.assert_allclose(pq[[1, 3]], [0.0941, 10.0], rtol=0.02)  # 94 and 10,000 cd/m^2


def test_unknown_codes_are_refused_by_number() -> None:
    for primaries, transfer, says in ((99, 1, "primaries of code 99"), (1, 9, "curve of code 9")):
        with pytest.raises(ValueError, match=says):
            ColourSpace.of_codes(primaries, transfer)
    data = png(RED, chunk(b"cICP", bytes([99, 1, 0, 1])))
    with pytest.raises(ImageError, match="x: has colour primaries of code 99"):
        decode_picture(data, "x")


@pytest.mark.parametrize("code", [0, 3])
def test_reserved_codes_of_png_state_nothing(code: int) -> None:
    data = png(RED, chunk(b"cICP", bytes([code, code, 0, 1])))
    np.testing.assert_array_equal(linear_of(data), linear_of(png(RED)))


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_icc_profiles_are_applied(kind: str) -> None:
    plain = linear_of(saved(kind))
    wide = linear_of(saved(kind, icc_profile=matrix_profile(DISPLAY_P3)))
    assert wide[0] == pytest.approx(P3_RED[0], abs=0.02)
    assert wide[0] > 1.15 * plain[0]
    assert wide[1] < plain[1] / 2
    own = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    np.testing.assert_array_equal(linear_of(saved(kind, icc_profile=own)), plain)


@pytest.mark.parametrize(("gamma", "beyond"), [(2.2, True), (1.8, True), (1.5, False)])
def test_colours_beyond_srgb_of_a_profile_with_a_usual_curve_are_kept(gamma: float, beyond: bool) -> None:
    data = saved("PNG", np.full((8, 8, 3), (255, 20, 20), np.uint8), icc_profile=matrix_profile(DISPLAY_P3, gamma))
    picture = decode_picture(data, "x")
    assert picture.image[4, 4] == pytest.approx([1.22 if beyond else 1, 0, 0], abs=0.01)
    assert picture.clipped.all()


def test_a_png_of_16_bits_with_a_profile_keeps_its_levels() -> None:
    pixels = np.full((8, 8, 3), (2_000, 1_999, 1_998), np.uint16)
    profile = chunk(b"iCCP", b"P3\0\0" + zlib.compress(matrix_profile(DISPLAY_P3, 1.0)))
    expected = to_rec709(DISPLAY_P3) @ pixels[0, 0] / 65535
    np.testing.assert_allclose(linear_of(png(pixels, profile)), expected, rtol=1e-5)


def test_a_damaged_profile_is_said_and_read_as_srgb() -> None:
    picture = decode_picture(saved("PNG", icc_profile=b"nothing of the kind" * 20), "x.png")
    np.testing.assert_allclose(picture.image[0, 0], [0.5776, 0.0212, 0.0212], atol=1e-3)
    (note,) = picture.notes
    assert "x.png: its colour profile" in str(note)


def test_png_states_display_p3_by_codes_and_by_chromaticities() -> None:
    by_codes = linear_of(png(RED, chunk(b"cICP", bytes([12, 13, 0, 1]))))
    np.testing.assert_allclose(by_codes, np.maximum(P3_RED, 0), atol=2e-3)
    stated = (DISPLAY_P3[6], DISPLAY_P3[7], *DISPLAY_P3[:6])
    chromaticities = chunk(b"cHRM", struct.pack(">8I", *(round(value * 100_000) for value in stated)))
    gamma = chunk(b"gAMA", struct.pack(">I", 45455))
    np.testing.assert_allclose(linear_of(png(RED, gamma, chromaticities)), by_codes, atol=1e-3)
    np.testing.assert_allclose(linear_of(png(RED, chromaticities)), by_codes, atol=1e-3)
    with pytest.raises(ImageError, match="narrow range"):
        linear_of(png(RED, chunk(b"cICP", bytes([1, 13, 0, 0]))))


def test_a_linear_png_of_16_bits_keeps_its_values() -> None:
    pixels = np.full((8, 8, 3), (30_000, 600, 100), np.uint16)
    found = linear_of(png(pixels, chunk(b"gAMA", struct.pack(">I", 100_000))))
    np.testing.assert_allclose(found, pixels[0, 0] / 65535, atol=1e-5)


def test_an_srgb_png_of_16_bits_keeps_its_levels() -> None:
    pixels = np.full((8, 8, 3), (2_000, 2_001, 300), np.uint16)  # within one level of 8 bits
    np.testing.assert_allclose(linear_of(png(pixels)), srgb_to_linear(pixels[0, 0] / 65535), rtol=1e-5)


@pytest.mark.parametrize(("bits", "noted"), [(10, True), (12, True), (14, False), (16, False)])
@pytest.mark.parametrize("chunks", [(), (chunk(b"gAMA", struct.pack(">I", 100_000)),)])
def test_a_png_that_uses_few_of_its_bits_is_noted(bits: int, noted: bool, chunks: tuple[bytes, ...]) -> None:
    picture = decode_picture(png(np.full((4, 4, 3), 2**bits - 1, np.uint16), *chunks), "x")
    assert ("its values use at most 12 of its 16 bits" in str(picture.notes)) == noted


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "WEBP"])
def test_adobe_rgb_by_exif(kind: str) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 1
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ColorSpace] = 2
    quality = {"JPEG": {"quality": 100}, "WEBP": {"lossless": True}}.get(kind, {})
    red = linear_of(as_png(saved(kind, exif=exif.tobytes(), **quality), "x", max_pixels=64))
    expected = to_rec709((0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329)) @ (RED[0, 0] / 255.0) ** (563 / 256)
    np.testing.assert_allclose(red, np.maximum(expected, 0), atol=0.01)
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ColorSpace] = 65535
    (note,) = decode_picture(as_png(saved(kind, exif=exif.tobytes()), "x", max_pixels=64), "x").notes
    assert "not sRGB" in note.left_out


RADIANCE = cv2.imencode(".hdr", np.arange(1, 16 * 12 * 3 + 1).reshape(12, 16, 3)[..., ::-1].astype(np.float32))[1]


@pytest.mark.parametrize(
    ("old", "new", "change"),
    [
        (b"FORMAT", b"EXPOSURE=2\nEXPOSURE= 4\nFORMAT", lambda image: image / 8),
        (b"FORMAT", b"COLORCORR=1 2 4\nFORMAT", lambda image: image / [1, 2, 4]),
        (b"FORMAT", b"GAMMA=1\nPRIMARIES=0.64 0.33 0.29 0.6 0.15 0.06 0.3333 0.3333\nFORMAT", lambda image: image),
        (
            b"FORMAT",
            b"PRIMARIES=0.68 0.32 0.265 0.69 0.15 0.06 0.3127 0.329\nFORMAT",
            lambda image: np.maximum(image @ to_rec709(DISPLAY_P3).T, 0),
        ),
        (b"FORMAT", b"pfilt -e 4\n\tEXPOSURE=4\n\tPRIMARIES=1 2\npcomb\nFORMAT", lambda image: image),  # of the inputs
        (b"FORMAT=32-bit_rle_rgbe", b"SOFTWARE=x", lambda image: image),
        (b"FORMAT=", b"FORMAT= ", lambda image: image),
        (b"FORMAT", b"x" * 127 + b"\nFORMAT", lambda image: image),
        (b"-Y 12 +X 16", b"+Y 12 +X 16", lambda image: image[::-1]),
        (b"-Y 12 +X 16", b"-Y 12 -X 16", lambda image: image[:, ::-1]),
    ],
)
def test_the_header_of_radiance_is_read(old: bytes, new: bytes, change: Callable[[np.ndarray], np.ndarray]) -> None:
    plain = decode_picture(RADIANCE.tobytes(), "x.hdr").image
    read = decode_picture(RADIANCE.tobytes().replace(old, new, 1), "x.hdr").image
    np.testing.assert_allclose(read, change(plain), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"FORMAT", b"GAMMA=2.2\nFORMAT", "gamma of 2.2"),
        (b"rle_rgbe", b"rle_xyze", "xyze"),
        (b"-Y 12 +X 16", b"+X 16 -Y 12", "no size as rows"),
        (b"\nFORMAT=32-bit_rle_rgbe\n\n", b"\r\nFORMAT=32-bit_rle_rgbe\r\n\r\n", "transferred as text"),
        (b"FORMAT", b"EXPOSURE=x\nFORMAT", "EXPOSURE=x"),
        (b"FORMAT", b"EXPOSURE=0\nFORMAT", "EXPOSURE=0"),
        (b"FORMAT", b"COLORCORR=1 -2 1\nFORMAT", "COLORCORR=1 -2 1"),
        (b"FORMAT", b"PRIMARIES=1 2\nFORMAT", "2 numbers as primaries"),
    ],
)
def test_what_is_not_read_of_radiance_is_refused_by_name(old: bytes, new: bytes, says: str) -> None:
    with pytest.raises(ImageError, match=rf"^x\.hdr: .*{says}"):
        decode_picture(RADIANCE.tobytes().replace(old, new, 1), "x.hdr")


def old_coding(runs: list[int], width: int, height: int) -> bytes:
    """A grey pixel and runs of it in the old coding of Radiance."""
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width)
    return header + bytes([128, 128, 128, 129]) + b"".join(bytes([1, 1, 1, run]) for run in runs)


def test_old_run_length_coding_of_radiance_is_read() -> None:
    np.testing.assert_array_equal(decode_picture(old_coding([43, 1], 30, 10), "x.hdr").image, np.ones((10, 30, 3)))
    for runs in ([42, 1], [43]):
        with pytest.raises(ImageError, match="truncated or damaged"):
            decode_picture(old_coding(runs, 30, 10), "x.hdr")


def test_runs_of_radiance_are_not_undone_beyond_the_largest_picture() -> None:
    millions, rest = divmod(999_999**2 - 1, 1 << 24)
    runs = [*rest.to_bytes(3, "little"), *[255] * (millions // 255), millions % 255]
    with pytest.raises(ImageError, match="999999 x 999999 pixels; up to"):
        decode_picture(old_coding(runs, 999_999, 999_999), "x.hdr")


def test_oblong_pixels_of_radiance_are_said() -> None:
    data = RADIANCE.tobytes().replace(b"FORMAT", b"PIXASPECT=2\nFORMAT", 1)
    (note,) = decode_picture(data, "x.hdr").notes
    assert "0.5 times as wide as high" in note.left_out


def test_cmyk_is_read_and_said() -> None:
    cmyk = Image.fromarray(RED).convert("CMYK")
    picture = decode_picture(saved("JPEG", cmyk, quality=98), "x")
    assert picture.image[4, 4, 0] > 0.4
    (note,) = picture.notes
    assert "x: its pixels are CMYK, and no profile" in str(note)
    (note,) = decode_picture(as_png(saved("TIFF", cmyk), "x", max_pixels=64), "x").notes
    assert "colours are not sRGB" in str(note)


def test_a_profile_for_other_pixels_is_said_and_not_applied() -> None:
    """A profile of grey would take the colour out of the picture; a grey picture has it applied."""
    grey = bytearray(matrix_profile(DISPLAY_P3))
    grey[16:20] = b"GRAY"
    grey[grey.index(b"rTRC") : grey.index(b"rTRC") + 4] = b"kTRC"
    picture = decode_picture(saved("JPEG", icc_profile=bytes(grey), quality=98), "x")
    np.testing.assert_allclose(picture.image[4, 4], [0.5776, 0.0212, 0.0212], atol=0.02)
    (note,) = picture.notes
    assert "its colour profile is for GRAY, which its pixels are not" in str(note)
    level = np.full((8, 8, 3), 128, np.uint8)
    assert decode_picture(saved("PNG", level, icc_profile=bytes(grey)), "x").notes == ()


TURNED: bytes = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "text"])
def test_orientation_is_applied_wherever_the_file_states_it(kind: str) -> None:
    """In EXIF, as XMP, or as EXIF in a PNG's text (ImageMagick); half of the picture is red."""
    half = RED.copy()
    half[:, 4:] = 40
    if kind == "text":
        exif = Image.Exif()
        exif[ExifTags.Base.Orientation] = 6
        raw = b"Exif\0\0" + exif.tobytes().removeprefix(b"Exif\0\0")
        info = PngInfo()
        info.add_text("Raw profile type exif", f"\nexif\n{len(raw):8}\n{raw.hex()}\n", zip=True)
        data = saved("PNG", half, pnginfo=info)
    elif kind == "PNG":
        data = png(half, chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + TURNED))
    else:
        data = saved("JPEG", half, xmp=TURNED, quality=98)
    picture = decode_picture(data, "x").image
    assert picture[0, 0, 0] > 0.4
    assert picture[0, 7, 0] > 0.4
    assert picture[7, 0, 0] < 0.1
    assert "EXIF orientation 6" in str(decode_picture(data, "x", as_stored=True).notes)


def test_a_gain_map_is_said() -> None:
    data = saved("JPEG")
    xmp = b"http://ns.adobe.com/xap/1.0/\0<x hdrgm:Version='1.0'/>"
    data = data[:2] + b"\xff\xe1" + struct.pack(">H", len(xmp) + 2) + xmp + data[2:]
    (note,) = decode_picture(data, "x").notes
    assert "gain map" in note.left_out


def test_a_panorama_is_refused_as_png_too() -> None:
    xmp = b'XML:com.adobe.xmp\0\0\0\0\0<x GPano:ProjectionType="equirectangular"/>'
    with pytest.raises(ImageError, match=r"^x: is a panorama \(GPano\)"):
        decode_picture(png(RED, chunk(b"iTXt", xmp)), "x")


@pytest.mark.parametrize(("kind", "noted"), [("MPO", True), ("JPEG", False)])
def test_other_pictures_in_a_jpeg_are_said(kind: str, noted: bool) -> None:
    more = {"save_all": True, "append_images": [Image.fromarray(255 - RED)]} if kind == "MPO" else {}
    picture = decode_picture(saved(kind, **more), "x")
    np.testing.assert_array_equal(picture.image, decode_picture(saved("JPEG"), "x").image)
    assert ["further pictures (MPF): 1" in str(note) for note in picture.notes] == [True] * noted


def test_alpha_in_every_way_of_png() -> None:
    pixels = np.dstack([RED, np.full((8, 8), 255, np.uint8)])
    pixels[:4, :, 3] = 0
    grey = np.dstack([RED[..., 0], pixels[..., 3]])
    palette = saved("PNG", Image.fromarray(pixels).quantize(8))
    keyed = png(np.where(pixels[..., 3:] > 0, RED, 0), chunk(b"tRNS", bytes(6)))
    for data in (saved("PNG", pixels), saved("PNG", grey), palette, keyed):
        seen = decode_picture(data, "x").seen
        assert seen is not None
        assert not seen[:4].any()
        assert seen[4:].all()
    assert decode_picture(saved("PNG", np.dstack([RED, pixels[4:, :, 3].repeat(2, 0)])), "x").seen is None


def test_what_follows_the_end_mark_is_ignored() -> None:
    smooth = cv2.resize(np.random.default_rng(1).integers(0, 255, (3, 4, 3), np.uint8), (64, 48))
    for kind in ("JPEG", "PNG"):
        whole = saved(kind, smooth)
        plain = decode_picture(whole, "x").image
        video = b"\0\0\0\x18ftypmp42" + bytes(range(256)) * 8
        for trailer in (b"\n", video, b"SEFHk" + bytes(100) + b"SEFT", saved(kind, smooth[:16])):
            np.testing.assert_array_equal(decode_picture(whole + trailer, "x").image, plain)
    jpeg = saved("JPEG", smooth)
    np.testing.assert_array_equal(decode_picture(jpeg[:-2], "x").image, decode_picture(jpeg, "x").image)
