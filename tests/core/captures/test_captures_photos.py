"""Photos with a depth map inside (HEIC portraits of phones, by boxes written here), and of other formats."""

import random
import struct
from pathlib import Path
from typing import Any

import cv2
import formats
import heic_files
import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from colour_profiles import matrix_profile
from roomlight.captures import open_capture
from roomlight.captures.bare_video import panorama_like
from roomlight.captures.notes import round_picture
from roomlight.captures.photo import PhotoOptions, read_photo
from roomlight.conventions import srgb8_to_linear, srgb_to_linear
from roomlight.errors import ImageError, RoomLightError
from roomlight.images import decode_picture
from roomlight.imaging.colour_spaces import DISPLAY_P3
from roomlight.imaging.exif import oriented
from roomlight.imaging.other_formats import as_png

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


def xmp(accuracy: str = "absolute") -> str:
    return heic_files.APPLE_XMP.format(low=LOW, high=HIGH, accuracy=accuracy, focal=3024.0)


@pytest.mark.parametrize("stated", ["xmp", "sei"])
def test_a_portraits_own_depth_is_read(tmp_path: Path, stated: str) -> None:
    colour, disparity = scene()
    text, levels = (xmp(), None) if stated == "xmp" else ("", (LOW, HIGH))
    photo = read_photo(
        formats.save(tmp_path / "photo.heic", heic_files.portrait(colour, disparity, xmp=text, sei=levels)),
        options=PhotoOptions(world_up="y"),
    )
    depth_m = photo.frame.depth_m
    assert depth_m.shape == (48, 64)
    # half a level of 8 bits is 0.4 %; HEVC adds about two levels
    np.testing.assert_allclose([depth_m[4, 30], depth_m[44, 30]], [2.0, 1.0], rtol=0.04)
    expected = srgb8_to_linear(colour)
    np.testing.assert_allclose(photo.frame.image[40, [20, 110]], expected[40, [20, 110]], atol=0.03)
    if stated == "xmp":
        assert photo.fov_source == "depth"
        assert photo.frame.intrinsics.fx == pytest.approx(3024 / 4032 * 128)
    assert [note for note in photo.notes if "which way is up" not in note.left_out] == []


def test_depth_in_metres_is_told_from_the_type_of_a_gain_map(tmp_path: Path) -> None:
    gain_map = "<apdi:AuxiliaryImageType>urn:com:apple:photo:2020:aux:hdrgainmap</apdi:AuxiliaryImageType>"
    text = gain_map + xmp().replace(">disparity<", ">depth<")
    path = formats.save(tmp_path / "p.heic", heic_files.portrait(*scene(), xmp=text))
    depth_m = read_photo(path, options=PhotoOptions(world_up="y")).frame.depth_m
    np.testing.assert_allclose([depth_m[4, 30], depth_m[44, 30]], [0.5, 1.0], rtol=0.04)


def test_relative_depth_is_said_and_can_be_scaled(tmp_path: Path) -> None:
    path = formats.save(tmp_path / "photo.heic", heic_files.portrait(*scene(), xmp=xmp("relative")))
    photo = read_photo(path, options=PhotoOptions(world_up="y"))
    assert "relative accuracy" in photo.notes[0].left_out
    scaled = read_photo(path, options=PhotoOptions(depth_unit_m=1.5, world_up="y"))
    np.testing.assert_allclose(scaled.frame.depth_m, 1.5 * photo.frame.depth_m, rtol=1e-6)
    assert scaled.notes == ()


def test_a_turned_portrait_comes_out_upright(tmp_path: Path) -> None:
    turn = heic_files.box(b"irot", b"\x03")  # 270 degrees counter-clockwise: clockwise by 90
    photo = read_photo(formats.save(tmp_path / "p.heic", heic_files.portrait(*scene(), xmp=xmp(), more=(turn,))))
    assert photo.frame.image.shape == (128, 96, 3)
    assert photo.frame.depth_m.shape == (64, 48)
    red, blue = photo.frame.image[10, 48], photo.frame.image[118, 48]
    assert red[0] > 3 * red[2]
    assert blue[2] > 3 * blue[0]
    np.testing.assert_allclose([photo.frame.depth_m[30, 44], photo.frame.depth_m[30, 4]], [2.0, 1.0], rtol=0.04)


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("mirror", [(), (heic_files.box(b"imir", b"\0"),), (heic_files.box(b"imir", b"\1"),)])
def test_depth_stored_like_the_pixels_of_a_heic_is_turned_with_them(
    tmp_path: Path, turns: int, mirror: tuple[bytes, ...]
) -> None:
    """A quarter of the picture is bright and near."""
    near = np.zeros((96, 128), bool)
    near[:48, :64] = True
    colour = np.where(near[..., None], np.uint8(200), np.full(3, 20, np.uint8))
    data = heic_files.portrait(colour, None, more=(heic_files.box(b"irot", bytes([turns])), *mirror))
    np.save(tmp_path / "d.npy", np.where(near, 1.0, 3.0))
    options = PhotoOptions(depth_orientation="stored", world_up="y")
    frame = read_photo(formats.save(tmp_path / "p.heic", data), tmp_path / "d.npy", options).frame
    assert np.mean((frame.image[..., 1] > 0.3) == (frame.depth_m < 2)) > 0.98


@pytest.mark.parametrize(
    "stated", [b"nclx" + struct.pack(">HHHB", 12, 13, 6, 0x80), b"prof" + matrix_profile(DISPLAY_P3)]
)
def test_the_colour_space_of_heic_is_converted(stated: bytes) -> None:
    colour = scene()[0] + np.uint8(55)
    data = heic_files.portrait(colour, None, more=(heic_files.box(b"colr", stated),))
    image = decode_picture(data, "photo.heic").image
    plain = srgb8_to_linear(colour)[40, 20]
    assert image[40, 20, 0] > 1.15 * plain[0] > 1.1  # red of Display P3 lies outside sRGB


def test_a_gain_map_that_an_item_states_is_said() -> None:
    data = heic_files.portrait(scene()[0], None)
    assert decode_picture(data + heic_files.box(b"free", b"a bitmap"), "x").notes == ()
    entry = heic_files.box(b"free", heic_files.box(b"infe", b"\2\0\0\0" + b"\0\7" + b"\0\0" + b"tmap\0"))
    for stated in (data.replace(b"mif1heic", b"tmapheic", 1), data + entry):
        (note,) = decode_picture(stated, "x").notes
        assert "gain map" in note.left_out


def test_other_pictures_in_a_heic_are_said(tmp_path: Path) -> None:
    """Of spatial photos and bursts."""
    heif = heic_files.pillow_heif.from_pillow(Image.fromarray(scene()[0]))
    heif.add_from_pillow(Image.fromarray(255 - scene()[0]))
    heif.save(tmp_path / "p.heic")
    (note,) = decode_picture((tmp_path / "p.heic").read_bytes(), "x").notes
    assert "x: further pictures: 1" in str(note)


def test_an_avif_that_begins_as_any_picture_is_refused_by_name(tmp_path: Path) -> None:
    data = other_file(tmp_path / "a.avif", BLACK).read_bytes()
    with pytest.raises(ImageError, match="AVIF is not read"):
        decode_picture(data.replace(b"ftypavif", b"ftypmif1", 1), "x")


def test_depth_without_a_range_is_noted(tmp_path: Path) -> None:
    data = heic_files.portrait(*scene())
    picture = decode_picture(data, "photo.heic")
    assert "no range" in picture.notes[0].effect
    assert picture.own_depth is None
    formats.save(tmp_path / "photo.heic", data)
    depth = formats.save(tmp_path / "d.png", formats.image(".png", np.full((48, 64), 1500, np.uint16)))
    for unit_m, depth_m in ((None, 1.5), (0.002, 3.0)):
        photo = read_photo(tmp_path / "photo.heic", depth, PhotoOptions(depth_unit_m=unit_m))
        np.testing.assert_allclose(photo.frame.depth_m, depth_m, rtol=1e-6)


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
    path = formats.save(tmp_path / "photo.heic", bytes(data[:cut]))
    refusal = None
    try:
        frame = read_photo(path).frame
        assert np.isfinite(frame.image).all()
        assert np.isfinite(frame.depth_m).all()
    except RoomLightError as error:
        refusal = error
    assert refusal is None or str(path) in str(refusal)


def other_file(path: Path, pixels: np.ndarray, **options: Any) -> Path:
    Image.fromarray(pixels).save(path, **options)
    return path


def exif_of(details: dict[int, Any], camera: dict[int, Any] | None = None) -> Image.Exif:
    exif = Image.Exif()
    exif.update(camera or {})
    exif.get_ifd(ExifTags.IFD.Exif).update(details)
    return exif


@pytest.mark.parametrize(("ending", "options"), [("webp", {"lossless": True}), ("tif", {}), ("bmp", {})])
def test_photos_of_other_formats_are_those_of_png(tmp_path: Path, ending: str, options: dict[str, Any]) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (24, 32, 3), np.uint8)
    exif = exif_of({ExifTags.Base.FocalLengthIn35mmFilm: 26}, {ExifTags.Base.Orientation: 6})
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    stated = {} if ending == "bmp" else {"exif": exif, "icc_profile": profile}
    whole = read_photo(other_file(tmp_path / "a.png", pixels, **stated))
    photo = read_photo(other_file(tmp_path / f"a.{ending}", pixels, **options, **stated))
    np.testing.assert_array_equal(photo.frame.image, whole.frame.image)
    assert photo.frame.image.shape[:2] == ((24, 32) if ending == "bmp" else (32, 24))
    stored = as_png((tmp_path / f"a.{ending}").read_bytes(), "a", max_pixels=1000)
    assert decode_picture(stored, "a", as_stored=True).image.shape[:2] == (24, 32)
    if ending == "webp":  # Pillow writes no focal length into a TIFF
        assert photo.fov_source == "exif"
        assert photo.fov_deg == whole.fov_deg


def tiff16(pixels: np.ndarray, tags: dict[int, Any]) -> bytes:
    """Write RGB or RGBA of 16 bits with TIFF's tags; Pillow writes 8 bits, but adds where pixels begin (273)."""
    height, width, channels = pixels.shape
    directory = ImageFileDirectory_v2(prefix=b"II")
    layout = {256: width, 257: height, 258: (16,) * channels, 259: 1, 262: 2, 273: 0, 277: channels, 278: height}
    for tag, value in {**layout, 279: pixels.nbytes, **tags}.items():
        directory[tag] = value
    return b"II*\0\10\0\0\0" + directory.tobytes(8) + pixels.tobytes()


@pytest.mark.parametrize("turn", [1, 6, 7])
@pytest.mark.parametrize(("channels", "alpha"), [(3, None), (4, 0), (4, 1), (4, 2)])
def test_a_tiff_of_16_bits_keeps_them(turn: int, channels: int, alpha: int | None) -> None:
    pixels = np.random.default_rng(1).integers(0, 65536, (24, 32, channels)).astype(np.uint16)
    truth = pixels[..., :3] / 65535
    if alpha == 1:  # colour is multiplied by it
        pixels[..., 3] |= 1 << 14
        pixels[..., :3] = np.rint(truth * pixels[..., 3:])
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    tags = {274: turn, 34675: profile, **({} if alpha is None else {338: alpha})}
    png = as_png(tiff16(pixels, tags), "a", max_pixels=1000)
    assert b"iCCP" in png
    stored, upright = decode_picture(png, "a", as_stored=True), decode_picture(png, "a")
    np.testing.assert_allclose(stored.image, srgb_to_linear(truth), atol=1e-4 if alpha == 1 else 1e-6)
    np.testing.assert_array_equal(upright.image, oriented(stored.image, turn))
    assert (stored.seen is None) == (alpha not in (1, 2))
    if stored.seen is not None:
        np.testing.assert_array_equal(stored.seen, pixels[..., 3] >= 32768)


def test_a_tiff_of_16_bits_with_channels_apart_or_cut_off_is_refused() -> None:
    pixels = np.ones((8, 8, 3), np.uint16)
    planes = {284: 2, 273: (0, 128, 256), 279: (128, 128, 128)}
    for data, says in ((tiff16(pixels, planes), "channels apart"), (tiff16(pixels, {})[:-99], "truncated")):
        with pytest.raises(ImageError, match=rf"^a: the TIFF does not decode \(16 bits.*{says}"):
            as_png(data, "a", max_pixels=1000)


def test_transparent_pixels_of_a_webp_are_not_seen(tmp_path: Path) -> None:
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[:4, :, 3] = 0
    seen = read_photo(other_file(tmp_path / "a.webp", pixels, lossless=True)).frame.seen
    assert seen is not None
    np.testing.assert_array_equal(seen, pixels[..., 3] > 0)


def test_captures_hold_webp_pictures(tmp_path: Path) -> None:
    path = formats.nerfstudio(tmp_path / "capture", formats.scene())
    whole = [frame.image for frame in open_capture(path)]
    for picture in sorted((path / "images").glob("*.png")):
        with Image.open(picture) as image:
            image.save(picture.with_suffix(".webp"), lossless=True)
        picture.unlink()
    index = path / "transforms.json"
    index.write_text(index.read_text().replace('.png", "depth', '.webp", "depth'))
    np.testing.assert_array_equal([frame.image for frame in open_capture(path)], whole)


BLACK = np.zeros((24, 32, 3), np.uint8)
TWO = {"save_all": True, "append_images": [Image.fromarray(BLACK)]}
PANORAMA = b'<x GPano:ProjectionType="equirectangular"/>'
WIDE = "3000 x 10 pixels with a field of view of 64 degrees are no photo"


@pytest.mark.parametrize(
    ("ending", "pixels", "stated", "message"),
    [
        ("tif", np.ones((4, 4), np.float32), {}, "the TIFF has values of the kind F; save it as EXR"),
        ("avif", BLACK, {}, "AVIF is not read, because its HDR would be lost"),
        ("png", np.zeros((10, 3000, 3), np.uint8), {}, WIDE),
        ("tif", BLACK, {"tiffinfo": {254: 1}}, "a raw photo, of which only a preview"),
        ("tif", BLACK, {"tiffinfo": {50706: b"\1\4\0\0"}}, "a raw photo, of which only a preview"),
        ("tif", BLACK, {"tiffinfo": {50706: b"\1\4\0\0"}, **TWO}, "a raw photo, of which only a preview"),
        ("tif", BLACK, TWO, "the TIFF holds 2 pictures"),
        ("webp", BLACK, {"xmp": PANORAMA}, r"panorama \(GPano\)"),
        ("gif", BLACK, {}, "is GIF, which is not read"),
        ("jp2", BLACK, {}, "is JPEG 2000, which is not read"),
    ],
)
def test_what_is_no_photo_is_refused_by_name(
    tmp_path: Path, ending: str, pixels: np.ndarray, stated: dict, message: str
) -> None:
    with pytest.raises(ImageError, match=message):
        read_photo(other_file(tmp_path / f"a.{ending}", pixels, **stated))


def test_a_tiff_of_floats_in_three_channels_is_refused_by_what_it_is(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "a.tiff"), np.ones((4, 4, 3), np.float32))
    with pytest.raises(
        ImageError, match=r"TIFF does not decode \(of an unknown layout\); TIFF is read with 8 or 16 bits"
    ):
        read_photo(tmp_path / "a.tiff")


def test_damaged_and_endless_pictures_of_other_formats_are_refused(tmp_path: Path) -> None:
    rng, pixels = random.Random(2), np.random.default_rng(3).integers(0, 256, (16, 16, 3), np.uint8)
    for ending in ("webp", "tif", "bmp"):
        whole = other_file(tmp_path / f"a.{ending}", pixels).read_bytes()
        for _ in range(60):
            data = bytearray(whole[: rng.randrange(len(whole))] if rng.random() < 0.5 else whole)
            for _ in range(3 if data else 0):
                data[rng.randrange(len(data))] = rng.randrange(256)
            try:
                as_png(bytes(data), "a picture", max_pixels=1000)
            except ImageError:
                continue
    with pytest.raises(ImageError, match="up to 100 are read"):
        as_png(whole, "a picture", max_pixels=100)
    frames = [Image.fromarray(pixels), Image.fromarray(255 - pixels)]
    frames[0].save(tmp_path / "film.webp", save_all=True, append_images=frames[1:])
    with pytest.raises(ImageError, match="the WebP holds 2 pictures"):
        as_png((tmp_path / "film.webp").read_bytes(), "a picture", max_pixels=1000)


@pytest.mark.parametrize(
    ("camera", "details", "says"),
    [
        ({}, {ExifTags.Base.DigitalZoomRatio: 2.0}, "a digital zoom of 2"),
        ({ExifTags.Base.Make: "GoPro", ExifTags.Base.Model: "HERO9"}, {}, "its camera is GoPro HERO9, whose"),
        ({}, {ExifTags.Base.LensModel: "EF8-15mm f/4L FISHEYE USM"}, "EF8-15mm f/4L FISHEYE USM, whose lens bends"),
        ({ExifTags.Base.Make: "Apple"}, {ExifTags.Base.CustomRendered: 6}, "it is a panorama, by its EXIF"),
        ({ExifTags.Base.Make: "Apple"}, {ExifTags.Base.DigitalZoomRatio: 1.0, ExifTags.Base.CustomRendered: 3}, None),
    ],
)
def test_a_zoom_and_a_lens_that_exif_names_are_pointed_out(
    tmp_path: Path, camera: dict[int, Any], details: dict[int, Any], says: str | None
) -> None:
    exif = exif_of({ExifTags.Base.FocalLengthIn35mmFilm: 26, **details}, camera)
    photo = other_file(tmp_path / "a.jpg", scene()[0], exif=exif)
    np.save(tmp_path / "d.npy", np.full((96, 128), 2.0, np.float32))
    notes = " ".join(map(str, read_photo(photo, tmp_path / "d.npy", PhotoOptions(world_up="y")).notes))
    assert says is None or says in notes
    if says is None:
        assert not [word for word in ("lens", "zoom", "panorama") if word in notes]


def test_a_picture_that_is_clipped_throughout_is_pointed_out(tmp_path: Path) -> None:
    Image.new("RGB", (64, 48), "white").save(tmp_path / "a.png")
    np.save(tmp_path / "d.npy", np.full((48, 64), 2.0, np.float32))
    (note,) = read_photo(tmp_path / "a.png", tmp_path / "d.npy", PhotoOptions(world_up="y")).notes
    assert "100% of its pixels are clipped" in note.left_out


def test_a_picture_of_a_panorama_s_aspect_is_pointed_out() -> None:
    assert "by its aspect of 7.68" in str(panorama_like("a.jpg", 500, 3840))
    assert panorama_like("a.jpg", 1920, 800) is None  # a film


@pytest.mark.parametrize(
    ("plane", "fov_deg", "says"),
    [
        ({"X": 6000 * 25.4 / 36, "Y": 4000 * 25.4 / 24}, 73.7, "gives a field of view of 74 degrees"),
        ({"X": 6000 / 36, "Y": 4000 / 24, "Unit": 4}, 73.7, "gives a field of view of 74 degrees"),
        ({"X": 6000 / 3.6}, 64.0, "because the sensor's size is not stated"),
        ({}, 64.0, "because the sensor's size is not stated"),
    ],
    ids=["inch", "millimetre", "no sensor", "unknown"],
)
def test_a_focal_length_counts_on_a_sensor_of_known_size(
    tmp_path: Path, plane: dict[str, float], fov_deg: float, says: str
) -> None:
    """As cameras write it that state no equivalent one: 24 mm on 36 x 24 mm."""
    tags = ExifTags.Base
    names = {"X": tags.FocalPlaneXResolution, "Y": tags.FocalPlaneYResolution, "Unit": tags.FocalPlaneResolutionUnit}
    stated: dict[int, Any] = {tags.FocalLength: 24, tags.ExifImageWidth: 6000, tags.ExifImageHeight: 4000}
    exif = exif_of({**stated, **{names[key]: value for key, value in plane.items()}})
    picture = other_file(tmp_path / "photo.jpg", np.zeros((80, 120, 3), np.uint8), exif=exif)
    depth = formats.save(tmp_path / "depth.png", formats.image(".png", np.full((80, 120), 1500, np.uint16)))
    photo = read_photo(picture, depth)
    assert photo.fov_deg == pytest.approx(fov_deg, abs=0.1)
    assert any("24 mm" in note.left_out and says in note.effect for note in photo.notes)


@pytest.mark.parametrize(("size", "cropped"), [((128, 96), False), ((96, 128), False), ((80, 96), True)])
def test_a_crop_whose_exif_states_the_whole_picture_is_pointed_out(
    tmp_path: Path, size: tuple[int, int], cropped: bool
) -> None:
    tags, pixels = ExifTags.Base, np.random.default_rng(1).integers(0, 255, (*size[::-1], 3), np.uint8)
    exif = exif_of({tags.FocalLengthIn35mmFilm: 26, tags.ExifImageWidth: 4032, tags.ExifImageHeight: 3024})
    photo = other_file(tmp_path / "photo.jpg", pixels, exif=exif)
    notes = read_photo(photo, options=PhotoOptions(world_up="y")).notes
    assert any("cropped, by its EXIF from an aspect of 1.33 to 1.2" in note.left_out for note in notes) == cropped


@pytest.mark.parametrize("turned", [False, True])
def test_an_orientation_that_a_heic_has_in_its_exif_alone_is_noted(tmp_path: Path, turned: bool) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    heif = heic_files.pillow_heif.from_pillow(Image.fromarray(scene()[0]))
    heif.save(tmp_path / "p.heic", exif=exif.tobytes())
    data = (tmp_path / "p.heic").read_bytes()
    notes = decode_picture(data if turned else data.replace(b"irot", b"free"), "p.heic").notes
    assert ["orientation 6, and the HEIC itself is not" in note.left_out for note in notes] == [True] * (not turned)


@pytest.mark.parametrize(("radius", "shift", "noted"), [(48, 0, True), (44, 3, True), (80, 0, False), (30, 20, False)])
def test_a_disc_within_black_is_pointed_out(radius: int, shift: int, noted: bool) -> None:
    y, x = np.mgrid[:96, :128]
    picture = np.where(np.hypot(y - 48, x - 64 - shift) < radius, 0.2, 0.001).astype(np.float32)
    assert (round_picture("fish.jpg", np.repeat(picture[..., None], 3, axis=2)) is not None) == noted
