"""Colours of video: tags that only the container states, curves that nothing states, exact conversion to RGB."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from roomlight.captures.bare_video import BareVideoReader
from roomlight.captures.options import CaptureOptions
from roomlight.captures.video import VideoFrames
from roomlight.conventions import srgb_to_linear
from roomlight.images import ColourImage

HLG_2020 = {"color_primaries": 9, "color_trc": 18, "colorspace": 9}
LIMITED, FULL = 1, 2
SIZE = 64, 48


def video(
    path: Path,
    code: Sequence[int],
    *,
    tags: dict[str, int],
    codec: str = "prores_ks",
    pixels: str = "yuv422p10le",
    size: tuple[int, int] = SIZE,
) -> Path:
    """Write two frames of one colour (Y, Cb, Cr); a tag stands in the container alone where the codec has none."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = *size, pixels
        if codec == "prores_ks":
            stream.codec_context.open()  # the encoder writes what is stated before it
        for name, value in tags.items():
            setattr(stream.codec_context, name, value)
        for number in range(2):
            frame = av.VideoFrame(*size, pixels)
            frame.pts = number
            for plane, value in zip(frame.planes, code, strict=True):
                kind = np.uint16 if "10" in pixels else np.uint8
                plane.update(np.full(plane.buffer_size // kind().itemsize, value, kind).tobytes())
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def first_of(path: Path) -> ColourImage:
    with VideoFrames(path, path.name) as frames:
        return frames.frame(0)


@pytest.mark.parametrize(("code", "light"), [(940, 1.0), (721, 0.265), (502, 1 / 12)])
def test_hlg_of_limited_range_that_the_container_alone_states(tmp_path: Path, code: int, light: float) -> None:
    path = video(tmp_path / "hlg.mkv", (code, 512, 512), tags=HLG_2020 | {"color_range": LIMITED})
    assert first_of(path).image[0, 0] == pytest.approx(light, rel=0.01)


@pytest.mark.parametrize("grey", [8, 64, 128, 255])
def test_ordinary_greys_keep_their_level(tmp_path: Path, grey: int) -> None:
    code = round((16 + 219 * grey / 255) * 4)
    path = video(tmp_path / "grey.mkv", (code, 512, 512), tags={"colorspace": 1, "color_range": LIMITED})
    assert first_of(path).image[0, 0] == pytest.approx(srgb_to_linear(np.full(3, grey / 255)), rel=0.01, abs=1e-3)


@pytest.mark.parametrize("primaries", [5, 6, 12])
def test_greys_of_8_bits_are_the_same_whatever_the_primaries(tmp_path: Path, primaries: int) -> None:
    others, usual = (
        video(
            tmp_path / f"{code}.mp4", (54, 128, 128), tags={"color_primaries": code}, codec="libx264", pixels="yuv420p"
        )
        for code in (primaries, 1)
    )
    np.testing.assert_allclose(first_of(others).image, first_of(usual).image, rtol=1e-3)


@pytest.mark.parametrize("matrix", [0, 2])
@pytest.mark.parametrize(("size", "kr", "kb"), [((1280, 48), 0.2126, 0.0722), ((64, 576), 0.299, 0.114)])
def test_an_unstated_matrix_is_that_of_the_size(
    tmp_path: Path, matrix: int, size: tuple[int, int], kr: float, kb: float
) -> None:
    """BT.709's, of small films BT.601's."""
    tags = {"colorspace": matrix, "color_range": LIMITED}
    red = [round(part) for part in (16 + 219 * kr, 128 - 112 * kr / (1 - kb), 128 + 112)]
    path = video(tmp_path / "red.mp4", red, tags=tags, codec="libx264", pixels="yuv420p", size=size)
    assert first_of(path).image[0, 0] == pytest.approx([1, 0, 0], abs=0.01)


def test_an_unstated_matrix_of_wide_colours_is_theirs(tmp_path: Path) -> None:
    stated, other = (
        video(tmp_path / f"{matrix}.mkv", (502, 400, 700), tags=HLG_2020 | {"colorspace": matrix}) for matrix in (9, 2)
    )
    np.testing.assert_allclose(first_of(other).image, first_of(stated).image, rtol=1e-3)


@pytest.mark.parametrize(
    ("reserved", "stated"),
    [((3, 3, 3), (2, 2, 2)), ((0, 0, 6), (2, 2, 6)), ((3, 18, 9), (9, 18, 9)), ((9, 18, 3), (9, 18, 9))],
)
def test_reserved_codes_of_the_container_state_nothing(
    tmp_path: Path, reserved: tuple[int, ...], stated: tuple[int, ...]
) -> None:
    """As phones of Samsung and Android 15 write them."""
    whole = video(tmp_path / "a.mov", (502, 400, 700), tags=HLG_2020).read_bytes()
    images = []
    for codes in (reserved, stated):
        (tmp_path / "a.mov").write_bytes(whole.replace(b"nclc\0\x09\0\x12\0\x09", b"nclc" + struct.pack(">3H", *codes)))
        images.append(first_of(tmp_path / "a.mov").image)
    np.testing.assert_allclose(*images, rtol=1e-3)


@pytest.mark.parametrize("primaries", [9, 2])  # of Apple Log, and of Apple Log 2
def test_wide_colours_without_a_curve_are_noted(tmp_path: Path, primaries: int) -> None:
    path = video(tmp_path / "log.mkv", (502, 512, 512), tags={"color_primaries": primaries, "colorspace": 9})
    (note,) = first_of(path).notes
    assert "its transfer curve is not stated" in str(note)


def test_a_logarithmic_curve_that_a_camera_states_beside_the_tags_is_noted(tmp_path: Path) -> None:
    path = video(tmp_path / "sony.mp4", (105, 128, 128), tags={"colorspace": 1}, codec="libx264", pixels="yuv420p")
    xml = b'<Item name="CaptureGammaEquation" value="s-log3-cine"/>'
    path.write_bytes(path.read_bytes().replace(b"ftypisom", b"ftypXAVC") + len(xml).to_bytes(4, "big") + b"free" + xml)
    (note,) = first_of(path).notes
    assert "sony.mp4: its camera states the logarithmic curve s-log3-cine" in str(note)


def test_a_text_of_another_encoding_does_not_spoil_a_video(tmp_path: Path) -> None:
    path = video(tmp_path / "walk.mov", (105, 128, 128), tags={"colorspace": 1}, codec="libx264", pixels="yuv420p")
    data = path.read_bytes()
    assert b"VideoHandler" in data
    path.write_bytes(data.replace(b"VideoHandler", b"\xce\xe1\xf0\xe0\xe1\xee\xf2\xf7\xe8\xea11"))
    assert first_of(path).image.shape == (48, 64, 3)


def test_frames_after_a_pause_are_as_far_apart_as_those_before(tmp_path: Path) -> None:
    path = tmp_path / "screen.mkv"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for time in (*range(30), *range(240, 300)):  # a second, seven without frames, two
            frame = av.VideoFrame(*SIZE, "yuv420p")
            frame.pts = time
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    times = BareVideoReader(path, CaptureOptions()).timestamps()
    assert len(times) == 15
    assert np.diff([time for time in times if time is not None]).min() > 0.15
