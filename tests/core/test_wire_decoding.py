"""Decoding of frame messages: every colour and depth encoding, exposure, confidence, HEIC."""

import inspect
import io
import json
from dataclasses import replace

import cv2
import numpy as np
import pillow_heif
import pytest
import zstandard

from roomlight.conventions import linear_to_srgb8, srgb8_to_linear
from roomlight.errors import OptionError, WireError
from roomlight.wire.decoding import decode_frame
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import pack, parse

WIDTH, HEIGHT = 64, 48
POSE = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 1.5, -2.0, 1]
RGB = np.stack(
    [np.tile(np.linspace(0, 255, WIDTH), (HEIGHT, 1)), *np.full((2, HEIGHT, WIDTH), 128)], axis=-1
).astype(np.uint8)  # fmt: skip
DEPTH_M = np.tile(np.linspace(1, 3, WIDTH, dtype=np.float32), (HEIGHT, 1))
compress = zstandard.ZstdCompressor().compress


PLAIN_COLOUR = ("rgb8", RGB.tobytes())
PLAIN_DEPTH = ("float32_m", "raw", DEPTH_M.tobytes())


def message(colour=PLAIN_COLOUR, depth=PLAIN_DEPTH, confidence=None, **changes):
    header = {
        "colour": {"encoding": colour[0], "bytes": len(colour[1])},
        "depth": {
            "format": depth[0], "encoding": depth[1], "width": WIDTH, "height": HEIGHT, "bytes": len(depth[2]),
        },
        "intrinsics": {"fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0, "width": WIDTH, "height": HEIGHT},
        "camera_to_world": POSE,
    }  # fmt: skip
    parts = [colour[1], depth[2]]
    if confidence is not None:
        header["confidence"] = {
            "encoding": confidence[0], "width": WIDTH, "height": HEIGHT, "bytes": len(confidence[1]),
        }  # fmt: skip
        parts.append(confidence[1])
    return parse(pack(FrameHeader.model_validate_json(json.dumps(header | changes)), *parts))


def png(array):
    return cv2.imencode(".png", array[..., ::-1] if array.ndim == 3 else array)[1].tobytes()


@pytest.mark.parametrize("encoding", ["rgb8", "png", "jpeg", "linear_f32"])
def test_every_colour_encoding_decodes_to_linear_light(encoding):
    linear = srgb8_to_linear(RGB)
    clipped = RGB.max(axis=-1) >= 250
    data = {
        "rgb8": RGB.tobytes(),
        "png": png(RGB),
        "jpeg": cv2.imencode(".jpg", RGB[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes(),
        "linear_f32": linear.astype("<f4").tobytes() + clipped.astype(np.uint8).tobytes(),
    }[encoding]
    frame = decode_frame(message((encoding, data), timestamp_s=3.5), 7)
    assert (frame.index, frame.timestamp_s) == (7, 3.5)
    if encoding == "jpeg":
        error = linear_to_srgb8(frame.image).astype(int) - RGB.astype(int)
        assert np.abs(error).max() <= 12  # chroma is subsampled
    else:
        np.testing.assert_array_equal(frame.image, linear)
        np.testing.assert_array_equal(frame.clipped, clipped)
    assert frame.camera_to_world[:3, 3].tolist() == [0.5, 1.5, -2.0]


def heic(rgb):
    stream = io.BytesIO()
    height, width = rgb.shape[:2]
    image = pillow_heif.from_bytes("RGB", (width, height), rgb.tobytes())
    image.save(stream, format="HEIF", quality=95)
    return stream.getvalue()


def test_heic_decodes_if_the_decoder_is_installed():
    data = heic(RGB)
    frame = decode_frame(message(("heic", data)), 0)
    assert np.abs(linear_to_srgb8(frame.image).astype(int) - RGB.astype(int)).max() <= 16
    for wrong in (heic(np.zeros((32, 32, 3), np.uint8)), data[:-40], data[:60]):
        with pytest.raises(WireError) as caught:
            decode_frame(message(("heic", wrong)), 0)
        assert caught.value.field == "colour"


def test_transparent_pixels_of_a_png_are_not_seen():
    pixels = np.dstack([RGB[..., ::-1], np.full((HEIGHT, WIDTH), 255, np.uint8)])
    pixels[: HEIGHT // 2, :, 3] = 0
    frame = decode_frame(message(("png", cv2.imencode(".png", pixels)[1].tobytes())), 0)
    assert frame.seen is not None
    assert frame.seen.mean() == pytest.approx(0.5, abs=0.02)
    assert not frame.depth_m[: frame.depth_m.shape[0] // 2 - 1].any()
    assert frame.depth_m[frame.depth_m.shape[0] // 2 + 1 :].any()
    pixels[..., 3] = 0
    with pytest.raises(WireError, match="opaque"):
        decode_frame(message(("png", cv2.imencode(".png", pixels)[1].tobytes())), 0)


@pytest.mark.parametrize("encoding", ["exact", "jpeg", "png"])
def test_a_mask_and_whether_depth_was_estimated_are_sent_with_every_encoding(encoding):
    seen = np.ones((HEIGHT, WIDTH), bool)
    seen[: HEIGHT // 2] = False
    clipped = np.zeros_like(seen)
    clipped[:, : WIDTH // 2] = True
    own = replace(decode_frame(message(), 0), seen=seen, clipped=clipped)

    def sent(**changes):
        return decode_frame(parse(pack_frame(replace(own, **changes), colour=encoding)), 0)

    np.testing.assert_array_equal(sent().seen, seen)
    np.testing.assert_array_equal(sent(depth_m=np.zeros_like(own.depth_m)).seen, seen)
    if encoding == "exact":
        np.testing.assert_array_equal(sent().clipped, clipped)
        np.testing.assert_array_equal(sent().image, own.image)
    assert sent(seen=None).seen is None
    for estimated in (False, True):
        assert sent(depth_estimated=estimated).depth_estimated is estimated


def test_an_unknown_encoding_is_refused():
    with pytest.raises(OptionError, match="exact, jpeg, png; got 'webp'"):
        inspect.unwrap(pack_frame)(decode_frame(message(), 0), colour="webp")


def test_heic_without_the_decoder_is_rejected_with_advice(monkeypatch):
    monkeypatch.setattr("roomlight.wire.decoding.heic_available", lambda: False)
    with pytest.raises(WireError, match=r"roomlight\[heic\]"):
        decode_frame(message(("heic", b"\0\0\0\x18ftypheic")), 0)


@pytest.mark.parametrize(
    ("format_", "dtype", "scale", "tolerance"),
    [("uint16_mm", "<u2", 1000, 5.1e-4), ("float16_m", "<f2", 1, 1e-3), ("float32_m", "<f4", 1, 0)],
)
@pytest.mark.parametrize("encoding", ["raw", "zstd", "png"])
def test_every_depth_format_decodes_to_metres(format_, dtype, scale, tolerance, encoding):
    if encoding == "png" and format_ != "uint16_mm":
        with pytest.raises(WireError, match="png encodes uint16_mm only"):
            message(depth=(format_, "png", png(np.ones((HEIGHT, WIDTH), np.uint16))))
        return
    stored = (np.rint(DEPTH_M * scale) if scale > 1 else DEPTH_M).astype(dtype)
    data = {"raw": stored.tobytes(), "zstd": compress(stored.tobytes()), "png": png(stored.astype(np.uint16))}[encoding]
    frame = decode_frame(message(depth=(format_, encoding, data)), 0)
    np.testing.assert_allclose(frame.depth_m, DEPTH_M, atol=tolerance + 1e-7)


def test_unknown_depth_is_zero():
    metres = DEPTH_M.copy()
    metres[0, :6] = [0, -1, np.nan, np.inf, -np.inf, 1e9]
    assert decode_frame(message(depth=("float32_m", "raw", metres.tobytes())), 0).depth_m[0, :6].tolist() == [0.0] * 6
    millimetres = np.full((HEIGHT, WIDTH), 1500, "<u2")
    millimetres[0, :2] = [0, 65535]
    for encoding, data in (("raw", millimetres.tobytes()), ("png", png(millimetres))):
        first = decode_frame(message(depth=("uint16_mm", encoding, data)), 0).depth_m[0, :3]
        np.testing.assert_allclose(first, [0, 0, 1.5], rtol=1e-6)


@pytest.mark.parametrize("encoding", ["raw", "zstd", "png"])
def test_depth_of_low_confidence_becomes_unknown_and_one_beyond_high_is_refused(encoding):
    levels = np.zeros((HEIGHT, WIDTH), np.uint8)
    levels[:, 20:], levels[:, 40:] = 1, 2
    encode = {"raw": np.ndarray.tobytes, "zstd": lambda plane: compress(plane.tobytes()), "png": png}[encoding]
    for least, known in ((0, 64), (1, 44), (2, 24)):
        frame = decode_frame(message(confidence=(encoding, encode(levels))), 0, min_confidence=least)
        assert (frame.depth_m[0] > 0).sum() == known
    levels[7, 9] = 255
    with pytest.raises(WireError, match=r"must be 0 \(low\), 1 \(medium\) or 2 \(high\); got a pixel of 255"):
        decode_frame(message(confidence=(encoding, encode(levels))), 0)


def test_exposure_drifts_where_nothing_states_it():
    linear = ("linear_f32", np.ones((HEIGHT, WIDTH, 3), "<f4").tobytes() + bytes(HEIGHT * WIDTH))
    assert decode_frame(message(), 0).auto_exposed
    assert not decode_frame(message(exposure=4.0), 0).auto_exposed
    assert not decode_frame(message(linear), 0).auto_exposed
    assert decode_frame(message(linear, auto_exposed=True), 0).auto_exposed
    assert not decode_frame(message(auto_exposed=False), 0).auto_exposed


def test_radiance_is_relative_to_the_reference_exposure():
    plain = decode_frame(message(), 0).image
    shorter = decode_frame(message(exposure=4.0), 0)
    np.testing.assert_allclose(shorter.image, plain / 4, rtol=1e-6)
    np.testing.assert_allclose(shorter.recorded, plain, rtol=1e-6)
    np.testing.assert_array_equal(decode_frame(message(exposure=4.0), 0, reference_exposure=4.0).image, plain)


@pytest.mark.parametrize(
    ("depth", "rule"),
    [
        (("float32_m", "raw", (-DEPTH_M).tobytes()), "above 0 and up to 100 km"),
        (("float32_m", "raw", (1000 * DEPTH_M / 2).tobytes()), "unit is that of float32_m"),
        (("uint16_mm", "raw", np.full((HEIGHT, WIDTH), 3, "<u2").tobytes()), "unit is that of uint16_mm"),
        (("uint16_mm", "png", png(np.ones((HEIGHT, WIDTH), np.uint8))), "16-bit grey"),
        (("float32_m", "zstd", zstandard.ZstdCompressor(write_content_size=False).compress(bytes(9))), "must be 12288"),
        (
            ("float32_m", "zstd", zstandard.ZstdCompressor(write_content_size=False).compress(bytes(10**7))),
            "must decompress to 12288 bytes",
        ),
    ],
)
def test_unusable_depth_is_rejected(depth, rule):
    with pytest.raises(WireError, match=rule) as caught:
        decode_frame(message(depth=depth), 0)
    assert caught.value.field == "depth"


ZEROS = np.zeros((HEIGHT, WIDTH), "<u2")


@pytest.mark.parametrize(
    "parts",
    [
        {"depth": ("float32_m", "raw", bytes(4 * WIDTH * HEIGHT))},
        {"depth": ("float16_m", "raw", np.full((HEIGHT, WIDTH), np.nan, "<f2").tobytes())},
        {"depth": ("uint16_mm", "zstd", compress((ZEROS + 65535).tobytes()))},
        {"depth": ("uint16_mm", "png", png(ZEROS)), "confidence": ("raw", bytes(WIDTH * HEIGHT))},
        {"confidence": ("raw", bytes(WIDTH * HEIGHT))},
    ],
)
def test_a_depth_map_without_a_usable_pixel_is_no_depth(parts):
    sent = message(**parts)
    frame = decode_frame(sent, 0)
    assert (frame.depth_m.shape, frame.depth_m.any()) == ((HEIGHT, WIDTH), False)
    bare = sent.without_depth()
    assert (bare.header.depth, bare.header.confidence, bare.depth, bare.confidence) == (None,) * 4
    np.testing.assert_array_equal(decode_frame(bare, 0).image, frame.image)


@pytest.mark.parametrize(("far", "accepted"), [(49, True), (50, False), (51, False)])
def test_depth_is_checked_by_its_median(far, accepted):
    depth = DEPTH_M.reshape(-1).copy()
    depth[100:] = 0  # unknown ones do not count
    depth[:far] = 900.0
    given = ("float32_m", "raw", depth.tobytes())
    if accepted:
        assert decode_frame(message(depth=given), 0).depth_m.max() == 900
    else:
        with pytest.raises(WireError, match="unit is that of float32_m"):
            decode_frame(message(depth=given), 0)


@pytest.mark.parametrize("orientation", [2, 3, 6])
def test_an_exif_orientation_is_ignored(orientation):
    pixels = np.random.default_rng(3).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    upright = cv2.imencode(".jpg", pixels)[1].tobytes()
    tiff = b"MM\0*\0\0\0\x08" + b"\0\x01" + b"\x01\x12\0\x03\0\0\0\x01\0" + bytes([orientation, 0, 0]) + bytes(4)
    body = b"Exif\0\0" + tiff
    turned = upright[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + upright[2:]
    expected = decode_frame(message(("jpeg", upright)), 0).image
    np.testing.assert_array_equal(decode_frame(message(("jpeg", turned)), 0).image, expected)
