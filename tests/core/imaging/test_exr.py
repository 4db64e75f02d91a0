"""EXR: the depth and the colour are found among the layers of renderers, or refused with the layers' names."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from roomlight.captures.decoding import read_rgbd
from roomlight.errors import ImageError
from roomlight.files import FolderSource
from roomlight.images import decode_depth, decode_picture, write_exr
from roomlight.imaging.colour_spaces import DISPLAY_P3, REC709, to_rec709
from roomlight.imaging.exr import sequence_metadata
from roomlight.imaging.rates import exact_rate

PLANE = {key: np.full((6, 8), value, np.float32) for key, value in {"R": 0.5, "G": 0.25, "B": 0.125, "A": 1.0}.items()}
DEPTH = np.linspace(1, 3, 48, dtype=np.float32).reshape(6, 8)
HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def written(path: Path, channels: dict[str, np.ndarray], **header: object) -> bytes:
    OpenEXR.File({**HEADER, **header}, {key: np.ascontiguousarray(v) for key, v in channels.items()}).write(str(path))
    return path.read_bytes()


def layer(name: str, **channels: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}.{key}": value for key, value in channels.items()}


@pytest.mark.parametrize(
    "channels",
    [
        {**PLANE, "Z": DEPTH},
        {**layer("ViewLayer.Combined", **PLANE), **layer("ViewLayer.Depth", Z=DEPTH)},
        {**layer("Image", **PLANE), **layer("Depth", V=DEPTH)},
        {**layer("ViewLayer.Normal", X=DEPTH * 0, Y=DEPTH * 0, Z=DEPTH * 0), **layer("ViewLayer.Depth", Z=DEPTH)},
        {**layer("ViewLayer.Mist", Z=DEPTH * 0), **layer("ViewLayer.Depth", Z=DEPTH)},
        {"V": DEPTH},
        {"Y": DEPTH},
        {"R": DEPTH, "G": DEPTH, "B": DEPTH},
        {**layer("RenderLayer", **PLANE), **layer("RenderLayer", Z=DEPTH)},
        {**layer("ViewLayer.Denoising Depth", Z=DEPTH * 2), **layer("ViewLayer.Depth", Z=DEPTH)},
        {**layer("ViewLayer.Depth raw", Z=DEPTH * 2), **layer("ViewLayer.Depth", Z=DEPTH)},
    ],
    ids=["rgbz", "blender", "compositor", "normals", "mist", "V", "Y", "grey", "old blender", "denoising", "exact"],
)
def test_depth_is_found_by_its_name(tmp_path: Path, channels: dict[str, np.ndarray]) -> None:
    np.testing.assert_array_equal(decode_depth(written(tmp_path / "d.exr", channels), "d.exr"), DEPTH)


@pytest.mark.parametrize(
    ("channels", "says"),
    [
        (PLANE, "no depth channel .*: A, B, G, R"),
        ({**layer("A.Depth", Z=DEPTH), **layer("B.Depth", Z=DEPTH)}, "several channels .*A.Depth.Z, B.Depth.Z"),
        (layer("Normal", X=DEPTH, Y=DEPTH, Z=DEPTH), "no depth channel"),
        (layer("ViewLayer.Mist", Z=DEPTH), "no depth channel"),
        (layer("disparity", V=DEPTH), "no depth channel"),
        (layer("Depth_Normalized", Z=DEPTH), "no depth channel"),
        ({"A": DEPTH}, "no depth channel"),
        (layer("Depth", R=DEPTH, G=2 * DEPTH, B=DEPTH), "no depth channel"),
    ],
)
def test_what_cannot_be_told_is_refused(tmp_path: Path, channels: dict[str, np.ndarray], says: str) -> None:
    with pytest.raises(ImageError, match=rf"^d\.exr: .*{says}"):
        decode_depth(written(tmp_path / "d.exr", channels), "d.exr")


def test_long_attributes_may_come_before_the_size(tmp_path: Path) -> None:
    data = written(tmp_path / "c.exr", PLANE, comments="x" * 70_000)
    np.testing.assert_allclose(decode_picture(data, "c.exr").image[0, 0], [0.5, 0.25, 0.125])


def test_colour_is_the_combined_layer(tmp_path: Path) -> None:
    passes = {
        **layer("V.Combined", **PLANE),
        **layer("V.DiffDir", R=DEPTH, G=DEPTH, B=DEPTH),
        **layer("V.Depth", Z=DEPTH),
    }
    picture = decode_picture(written(tmp_path / "c.exr", passes), "c.exr")
    np.testing.assert_allclose(picture.image[0, 0], [0.5, 0.25, 0.125])


@pytest.mark.parametrize(
    ("channels", "says"),
    [
        ({"Y": DEPTH, "RY": DEPTH, "BY": DEPTH}, "no colour"),
        ({"X": DEPTH, "Y": DEPTH, "Z": DEPTH}, "no colour"),
        (layer("V.Normal", X=DEPTH, Y=DEPTH, Z=DEPTH), "has no colour"),
        ({key: (255 * DEPTH).astype(np.uint32) for key in "RGB"}, "integers"),
        (layer("ViewLayer.DiffCol", **PLANE), "only the passes"),
        (layer("V.DiffDir", **PLANE) | layer("V.GlossDir", **PLANE), r"only the passes V\.DiffDir, V\.GlossDir"),
        (layer("left", **PLANE) | layer("right", **PLANE), "layers left, right"),
    ],
)
def test_what_is_no_picture_is_refused(tmp_path: Path, channels: dict[str, np.ndarray], says: str) -> None:
    cropped = {"displayWindow": (np.array([0, 0], np.int32), np.array([9, 5], np.int32))}
    for header in ({}, cropped):
        with pytest.raises(ImageError, match=rf"^c\.exr: .*{says}"):
            decode_picture(written(tmp_path / "c.exr", channels, **header), "c.exr")


def test_alpha_is_divided_out_and_what_is_no_number_is_not_seen(tmp_path: Path) -> None:
    alpha = np.full_like(DEPTH, 0.75)
    stored = {**{key: 0.75 * plane for key, plane in PLANE.items()}, "A": alpha}
    picture = decode_picture(written(tmp_path / "a.exr", stored), "a.exr")
    np.testing.assert_allclose(picture.image[0, 0], [0.5, 0.25, 0.125], rtol=1e-3)
    picture = decode_picture(written(tmp_path / "n.exr", {**PLANE, "R": np.where(DEPTH < 2, np.nan, DEPTH)}), "n.exr")
    assert picture.seen is not None
    np.testing.assert_array_equal(picture.seen, DEPTH >= 2)


def test_primaries_of_aces(tmp_path: Path) -> None:
    """White of AP0 is white; its green lies outside Rec. 709. Coefficients of SMPTE ST 2065-1's matrix, adapted."""
    ap0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
    grey = dict.fromkeys("RGB", np.full_like(DEPTH, 0.5))
    image = decode_picture(written(tmp_path / "w.exr", grey, chromaticities=ap0), "w.exr").image
    np.testing.assert_allclose(image[0, 0], 0.5, rtol=1e-3)
    np.testing.assert_allclose(to_rec709(ap0)[0], [2.5217, -1.1341, -0.3876], atol=2e-3)
    for flagged, primaries in ((1, ap0), (0, REC709)):  # SMPTE ST 2065-4's flag stands for them
        flag = decode_picture(written(tmp_path / "f.exr", PLANE, acesImageContainerFlag=flagged), "f.exr").image
        np.testing.assert_allclose(flag[0, 0], np.maximum(to_rec709(primaries) @ [0.5, 0.25, 0.125], 0), atol=1e-3)


def test_parts_are_layers(tmp_path: Path) -> None:
    parts = [
        OpenEXR.Part({**HEADER, "name": "Combined"}, dict(PLANE)),
        OpenEXR.Part({**HEADER, "name": "Depth"}, {"Z": DEPTH}),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "p.exr"))
    data = (tmp_path / "p.exr").read_bytes()
    np.testing.assert_allclose(decode_picture(data, "p.exr").image[0, 0], [0.5, 0.25, 0.125])
    np.testing.assert_array_equal(decode_depth(data, "p.exr"), DEPTH)


def test_only_the_data_window_of_the_colour_says_what_is_seen(tmp_path: Path) -> None:
    display = (np.array([0, 0], np.int32), np.array([7, 5], np.int32))
    parts = [
        OpenEXR.Part({**HEADER, "name": "Combined", "displayWindow": display}, dict(PLANE)),
        OpenEXR.Part({**HEADER, "name": "Depth", "displayWindow": display}, {"Z": DEPTH[:3, :4].copy()}),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "p.exr"))
    assert decode_picture((tmp_path / "p.exr").read_bytes(), "p.exr").seen is None


def test_too_large_channels_are_refused_before_they_are_decoded(tmp_path: Path) -> None:
    far = (np.array([0, 0], np.int32), np.array([7999, 7999], np.int32))
    channels = {f"{key}.{name}": plane for key in "VW" for name, plane in PLANE.items()}
    with pytest.raises(ImageError, match=r"take 2\.05 GB; up to 1\.28 GB"):
        decode_picture(written(tmp_path / "d.exr", channels, displayWindow=far), "d.exr")


def test_chromaticities_alpha_and_windows_are_read(tmp_path: Path) -> None:
    wide = decode_picture(written(tmp_path / "w.exr", PLANE, chromaticities=DISPLAY_P3), "w.exr")
    np.testing.assert_allclose(wide.image[0, 0], np.maximum(to_rec709(DISPLAY_P3) @ [0.5, 0.25, 0.125], 0), atol=1e-3)
    half = {**PLANE, "A": np.where(DEPTH < 2, 0, 1).astype(np.float32)}
    seen = decode_picture(written(tmp_path / "a.exr", half), "a.exr").seen
    assert seen is not None
    np.testing.assert_array_equal(seen, DEPTH >= 2)
    corner = (np.array([0, 0], np.int32), np.array([9, 5], np.int32))
    picture = decode_picture(written(tmp_path / "x.exr", PLANE, displayWindow=corner), "x.exr")
    assert picture.image.shape == (6, 10, 3)
    assert picture.seen is not None
    assert picture.seen[:, :8].all()
    assert not picture.seen[:, 8:].any()


@pytest.mark.parametrize(
    ("index", "rate", "wanted"),
    [
        (0, 24.0, (0, 0, 0, 0, False)),
        (29, 29.97, (0, 0, 0, 29, False)),
        (30, 29.97, (0, 0, 1, 0, False)),
        (61, 60.0, (0, 0, 1, 0, True)),
        (24 * 3600 * 10 + 3663 * 10 + 7, 10.0, (1, 1, 3, 7, False)),  # a clock of a day
    ],
)
def test_timecode_of_a_sequence(tmp_path, index, rate, wanted):
    written(tmp_path / "a.exr", PLANE, **sequence_metadata(index, rate))
    header = OpenEXR.File(str(tmp_path / "a.exr")).header()
    code = header["timeCode"]
    assert (code.hours, code.minutes, code.seconds, code.frame, code.fieldPhase) == wanted
    assert float(header["framesPerSecond"]) == pytest.approx(rate, rel=2e-6)


@pytest.mark.parametrize(
    ("index", "rate", "wanted"), [(61, 24.0, "00:00:02:13"), (29, 29.97, "00:00:00:29"), (36630, 10.0, "01:01:03:00")]
)
def test_openimageio_reads_a_frame_of_a_sequence(tmp_path: Path, index: int, rate: float, wanted: str) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    shade = np.random.default_rng(index).random((6, 12, 3)).astype(np.float16).astype(np.float32)
    write_exr(tmp_path / f"light.{index:06d}.exr", shade, metadata=sequence_metadata(index, rate))
    frame = oiio.ImageBuf(str(tmp_path / f"light.{index:06d}.exr"))
    np.testing.assert_array_equal(frame.get_pixels(), shade)
    assert frame.spec().get_string_attribute("smpte:TimeCode") == wanted
    numerator, denominator = frame.spec().getattribute("framesPerSecond")
    assert numerator / denominator == pytest.approx(rate, rel=2e-6)


@pytest.mark.parametrize(
    ("rate", "exact"),
    [(29.97, (30000, 1001)), (29.97003, (30000, 1001)), (23.976, (24000, 1001)), (25.0001, (25, 1)), (7.3, (73, 10))],
)
def test_rates_are_whole_or_those_of_television_where_they_are_close(rate, exact):
    assert exact_rate(rate).as_integer_ratio() == exact


@pytest.mark.parametrize("rate", [0.2, 120.0])
def test_rates_that_timecode_does_not_count(rate):
    assert list(sequence_metadata(5, rate)) == ["framesPerSecond", "roomlight:frame"]


@pytest.mark.parametrize(("channels", "holds"), [({**PLANE, "Z": DEPTH}, True), (dict.fromkeys("RGB", DEPTH), False)])
def test_a_picture_holds_the_depth_beside_its_colour(tmp_path: Path, channels: dict[str, np.ndarray], holds: bool):
    written(tmp_path / "p.exr", channels)
    own = decode_picture((tmp_path / "p.exr").read_bytes(), "p.exr").own_depth
    assert (own is not None) == holds
    assert own is None or np.array_equal(own.depth_m, DEPTH)
    picture, _ = read_rgbd(FolderSource(tmp_path), "p.exr", None, unit_m=None)
    assert any("depth that the picture holds" in note.left_out for note in picture.notes) == holds
