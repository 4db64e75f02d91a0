"""Image files: round trips, and an ImageError that names the file for every kind of damage."""

import io
import struct

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import ExifTags, Image

from roomlight.errors import ImageError, OutputError
from roomlight.files import write_atomic
from roomlight.images import (
    MAX_PIXELS,
    ExifCamera,
    decode_colour,
    decode_depth,
    decode_picture,
    exif_camera,
    peek_size,
    read_bytes,
    read_colour,
    read_panorama,
    write_exr,
    write_png,
)
from roomlight.imaging.exif import exif_camera_of

RNG = np.random.default_rng(5)
SRGB = RNG.integers(0, 256, (12, 16, 3), dtype=np.uint8)
LINEAR = RNG.uniform(0.1, 30, (12, 24, 3)).astype(np.float32)


def _encoded(kind, pixels: np.ndarray = SRGB):
    ok, data = cv2.imencode(f".{kind}", pixels)
    assert ok
    return data.tobytes()


def _exr(tmp_path, **channels):
    path = tmp_path / "given.exr"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {key: np.ascontiguousarray(value) for key, value in channels.items()}).write(str(path))
    return path


def test_png_keeps_every_value(tmp_path):
    write_png(tmp_path / "a.png", SRGB)
    image, clipped = read_colour(tmp_path / "a.png")
    write_png(tmp_path / "b.png", image)  # linear floats, encoded again
    assert (tmp_path / "b.png").read_bytes() == (tmp_path / "a.png").read_bytes()
    assert (clipped == (SRGB >= 250).any(axis=-1)).all()


def test_what_a_camera_clipped_is_marked():
    pixels = np.full((2, 3, 3), 249, np.uint8)
    pixels[0, 1, 2] = 250
    _, clipped = decode_colour(_encoded("png", pixels), "x")
    assert clipped.tolist() == [[False, True, False], [False, False, False]]


def test_exr_keeps_radiance_to_half_precision(tmp_path):
    write_exr(tmp_path / "p.exr", LINEAR, metadata={"probe": "1 2 3"})
    back = read_panorama(tmp_path / "p.exr")
    write_exr(tmp_path / "q.exr", LINEAR[:, :20])
    with pytest.raises(ImageError, match=r"q\.exr.*20 x 12"):
        read_panorama(tmp_path / "q.exr")
    assert back == pytest.approx(LINEAR, rel=2**-11)  # half has 11 significant bits
    with OpenEXR.File(str(tmp_path / "p.exr")) as file:
        assert file.header()["probe"] == "1 2 3"
        assert file.header()["chromaticities"] == pytest.approx((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329))


def test_invalid_exr_colours_become_black(tmp_path):
    bad = np.ones((4, 8, 3), np.float32)
    bad[0, 0], bad[1, 1], bad[2, 2] = np.nan, -5, np.inf
    image, clipped = read_colour(_exr(tmp_path, RGB=bad))
    assert (image[0, 0] == 0).all()
    assert (image[1, 1] == 0).all()
    assert (image[2, 2] == 65504).all()
    assert not clipped.any()


@pytest.mark.parametrize("names", ["RGB", "RGBA", "separate", "Y"])
def test_exr_channels_by_any_name(tmp_path, names):
    pixels = LINEAR.copy()
    if names == "RGB":
        path = _exr(tmp_path, RGB=pixels)
    elif names == "RGBA":
        path = _exr(tmp_path, RGBA=np.dstack([pixels, np.ones((12, 24), np.float32)]))
    elif names == "separate":
        path = _exr(tmp_path, **{c: pixels[..., i] for i, c in enumerate("RGB")})
    else:
        pixels = np.repeat(pixels[..., :1], 3, axis=-1)
        path = _exr(tmp_path, Y=pixels[..., 0])
    assert (read_colour(path)[0] == pixels).all()
    assert (decode_colour(path.read_bytes(), "inside/an.zip")[0] == pixels).all()


def test_hdr_is_linear_and_never_clipped():
    image, clipped = decode_colour(_encoded("hdr", LINEAR[..., ::-1]), "x.hdr")
    # RGBE shares one exponent: the smaller channels keep 8 bits of the greatest
    assert abs(image - LINEAR).max() < LINEAR.max() / 100
    assert not clipped.any()


def test_depth_png_is_in_its_unit_and_65535_is_unknown(tmp_path):
    raw = np.array([[0, 1, 1000], [2500, 65534, 65535]], np.uint16)
    write_png(tmp_path / "d.png", raw)
    depth = decode_depth((tmp_path / "d.png").read_bytes(), "d.png", unit_m=0.001)
    assert depth == pytest.approx(np.array([[0, 0.001, 1.0], [2.5, 65.534, 0]]))


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_depth_exr_is_in_metres_and_not_finite_is_unknown(tmp_path, dtype):
    metres = np.array([[1.5, np.nan, np.inf, -np.inf], [-1.0, 0.0, 2.0, 4.0]], dtype)
    path = _exr(tmp_path, Z=metres)
    assert decode_depth(path.read_bytes(), "d").tolist() == [[1.5, 0, 0, 0], [0, 0, 2.0, 4.0]]
    assert decode_depth(path.read_bytes(), "d", unit_m=0.5).tolist() == [[0.75, 0, 0, 0], [0, 0, 1.0, 2.0]]


@pytest.mark.parametrize("pixels", [SRGB, SRGB[..., 0], SRGB.astype(np.uint16)])
def test_depth_that_is_a_picture_is_refused(pixels):
    with pytest.raises(ImageError, match=r"d\.png: depth must be a 16-bit grey PNG"):
        decode_depth(_encoded("png", pixels), "d.png", unit_m=0.001)


def test_missing_and_empty_files_are_named(tmp_path):
    (tmp_path / "empty.png").touch()
    for name in ("empty.png", "gone.png", "."):
        with pytest.raises(ImageError, match=r"empty|cannot be read") as caught:
            read_bytes(tmp_path / name)
        assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("data", [b"x", b"GIF89a......", b"\x89PNG", b"\xff\xd8", b"#?", b"\x76\x2f\x31\x01"])
def test_files_of_a_few_bytes_are_refused(data):
    with pytest.raises(ImageError, match=r"^stub: "):
        decode_colour(data, "stub")


def _bomb(kind, width, height, tmp_path):
    if kind == "png":
        data = bytearray(_encoded("png"))
        data[16:24] = struct.pack(">II", width, height)
    elif kind == "jpg":
        data = bytearray(_encoded("jpg"))
        at = data.index(b"\xff\xc0")
        data[at + 5 : at + 9] = struct.pack(">HH", min(height, 65535), min(width, 65535))
    elif kind == "hdr":
        data = bytearray(_encoded("hdr", LINEAR).replace(b"-Y 12 +X 24", f"-Y {height} +X {width}".encode()))
    else:
        data = bytearray(_exr(tmp_path, RGB=LINEAR).read_bytes())
        at = data.index(b"dataWindow\x00box2i\x00") + 21
        data[at : at + 16] = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    return bytes(data)


@pytest.mark.parametrize("kind", ["png", "jpg", "hdr", "exr"])
def test_a_header_of_absurd_size_is_refused_before_decoding(kind, tmp_path):
    with pytest.raises(ImageError, match=rf"^bomb: .*{MAX_PIXELS}"):
        decode_colour(_bomb(kind, 60_000, 60_000, tmp_path), "bomb")


# A JPEG that is larger than its data says decodes (grey at the end), by the format's own rules.
@pytest.mark.parametrize("kind", ["png", "hdr", "exr"])
@pytest.mark.parametrize(("width", "height"), [(0, 12), (16, 0), (17, 13), (4000, 4000)])
def test_a_header_of_another_size_than_the_data_is_refused(kind, width, height, tmp_path):
    with pytest.raises(ImageError, match=r"^liar: "):
        decode_colour(_bomb(kind, width, height, tmp_path), "liar")


@pytest.mark.parametrize("kind", ["png", "jpg", "hdr", "exr"])
def test_a_truncated_file_is_an_image_error_wherever_it_ends(kind, tmp_path):
    whole = _exr(tmp_path, RGB=LINEAR).read_bytes() if kind == "exr" else None
    whole = whole or _encoded(kind, LINEAR if kind == "hdr" else SRGB)
    decode_colour(whole, "whole")
    for end in range(0, len(whole) - 1, 10):
        if kind == "jpg" and end == len(whole) - 2:
            continue  # all pixels are there, the end mark alone is not
        with pytest.raises(ImageError, match=r"^cut\."):
            decode_colour(whole[:end], f"cut.{kind}")


def test_the_size_is_read_from_the_header_alone():
    assert peek_size(_encoded("png"), "x") == (16, 12)
    assert peek_size(_encoded("jpg"), "x") == (16, 12)
    assert peek_size(_encoded("hdr", LINEAR), "x") == (24, 12)


def _photo(orientation=None, focal_35mm=None, kind="JPEG"):
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "Test"
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    if focal_35mm is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal_35mm
    stream = io.BytesIO()
    Image.fromarray(SRGB).save(stream, kind, exif=exif)
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_exif_states_focal_length_and_orientation(kind):
    assert exif_camera(_photo(6, 26, kind), "x") == ExifCamera(focal_35mm=26.0, orientation=6, lens="Test")
    assert exif_camera(_photo(None, 50, kind), "x") == ExifCamera(focal_35mm=50.0, lens="Test")
    assert exif_camera(_photo(3, None, kind), "x") == ExifCamera(orientation=3, lens="Test")


def test_a_tag_that_is_damaged_leaves_the_others():
    exif = Image.Exif()
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details.update({ExifTags.Base.FocalLengthIn35mmFilm: 26, ExifTags.Base.DigitalZoomRatio: "wide"})
    details[ExifTags.Base.ExifImageWidth] = "4032 px"
    assert exif_camera_of(exif) == ExifCamera(focal_35mm=26.0)


def test_field_of_view_follows_the_film_equivalent():
    camera = ExifCamera(focal_35mm=50.0)
    assert camera.fov_deg(3600, 2400) == pytest.approx(39.6, abs=0.05)  # the textbook value of a 50 mm lens
    assert camera.fov_deg(2400, 3600) == pytest.approx(27.0, abs=0.05)
    assert ExifCamera(focal_35mm=26.0).fov_deg(4032, 3024) == pytest.approx(67.3, abs=0.1)
    assert ExifCamera().fov_deg(3600, 2400) is None


def test_missing_exif_gives_the_defaults(tmp_path):
    write_exr(tmp_path / "p.exr", LINEAR)
    for data in (_encoded("jpg"), _encoded("png"), _encoded("hdr", LINEAR), (tmp_path / "p.exr").read_bytes()):
        assert exif_camera(data, "x") == ExifCamera()
    assert exif_camera(_photo(orientation=9, focal_35mm=0), "x") == ExifCamera(no_orientation=9, lens="Test")
    (note,) = decode_picture(_photo(orientation=9), "x").notes
    assert note.left_out == "x: EXIF orientation 9, which does not exist (1 to 8)"
    assert not decode_picture(_photo(orientation=0), "x").notes


def test_damaged_exif_never_raises():
    whole = _photo(6, 26)
    start, stop = whole.index(b"Exif"), whole.index(b"\xff\xdb")
    rng = np.random.default_rng(0)
    for _ in range(300):
        data = bytearray(whole)
        for at in rng.integers(start, stop, 4):
            data[at] = rng.integers(256)
        camera = exif_camera(bytes(data), "x")
        assert 1 <= camera.orientation <= 8
        assert camera.focal_35mm is None or camera.focal_35mm > 0


def test_exif_of_a_bomb_is_refused_as_the_pixels_are(tmp_path):
    for kind in ("png", "jpg"):
        with pytest.raises(ImageError, match=rf"^bomb: .*{MAX_PIXELS}"):
            exif_camera(_bomb(kind, 60_000, 60_000, tmp_path), "bomb")


def _write(kind, path):
    if kind == "exr":
        write_exr(path, LINEAR)
    elif kind == "png":
        write_png(path, SRGB)
    else:
        write_atomic(path, b"bytes")


@pytest.mark.parametrize("kind", ["exr", "png", "bytes"])
def test_writing_makes_folders_and_an_error_names_the_file(kind, tmp_path):
    target = tmp_path / "deep" / "er" / f"x.{kind}"
    _write(kind, target)
    assert [entry.name for entry in target.parent.iterdir()] == [target.name]
    with pytest.raises(OutputError, match=rf"x\.{kind}/x\."):
        _write(kind, target / f"x.{kind}")


@pytest.mark.parametrize("kind", ["exr", "png", "bytes"])
def test_a_failed_write_keeps_the_old_file_only(kind, tmp_path, monkeypatch):
    target = tmp_path / f"x.{kind}"
    target.write_text("old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(OutputError, match="No space left"):
        _write(kind, target)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]
