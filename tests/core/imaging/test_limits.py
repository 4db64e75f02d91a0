"""Files that are small and take long to decode are rejected by their structure."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from slow_images import chunk, jpeg_of_scans, png_of_texts

from roomlight.errors import ImageError
from roomlight.images import decode_colour, decode_grey8, peek_size
from roomlight.imaging.limits import (
    MAX_JPEG_SCANS,
    MAX_JPEG_SEGMENTS,
    MAX_PNG_CHUNKS,
    MAX_PNG_COMPRESSED_CHUNKS,
    check_jpeg,
    check_png,
)


def pixels(height=36, width=48):
    return np.random.default_rng(2).integers(0, 255, (height, width, 3), np.uint8)


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("restart", [0, 2])
def test_ordinary_jpegs_pass(progressive, restart):
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_RST_INTERVAL, restart]
    data = cv2.imencode(".jpg", pixels(600, 800), options)[1].tobytes()
    check_jpeg(data, "a")
    assert decode_colour(data, "a")[0].shape == (600, 800, 3)


def test_a_jpeg_of_many_scans_or_segments_is_rejected():
    decode_colour(jpeg_of_scans(MAX_JPEG_SCANS), "a")
    with pytest.raises(ImageError, match=r"^a: the JPEG has more than 64 scans"):
        decode_colour(jpeg_of_scans(MAX_JPEG_SCANS + 1), "a")
    data = cv2.imencode(".jpg", pixels())[1].tobytes()
    comment = b"\xff\xfe" + struct.pack(">H", 2 + 2000) + b"\xff\xda" * 1000
    check_jpeg(data[:2] + comment + data[2:], "a")  # scan markers inside metadata do not count
    data = data[:2] + b"\xff\xfe\x00\x02" * MAX_JPEG_SEGMENTS + data[2:]
    for read in (decode_colour, peek_size):
        with pytest.raises(ImageError, match="more than 4096 segments"):
            read(data, "a")


def test_a_png_of_many_texts_or_chunks_is_rejected():
    decode_colour(png_of_texts(MAX_PNG_COMPRESSED_CHUNKS, 1000), "a")
    with pytest.raises(ImageError, match=r"^a: the PNG has more than 8 compressed texts"):
        decode_colour(png_of_texts(MAX_PNG_COMPRESSED_CHUNKS + 1, 1000), "a")
    data = cv2.imencode(".png", pixels()[..., 0])[1].tobytes()
    with pytest.raises(ImageError, match="more than 20000 chunks"):
        decode_grey8(data[:33] + chunk(b"tEXt", b"k\0v") * MAX_PNG_CHUNKS + data[33:], "a")


@pytest.mark.parametrize("end", range(8, 80, 3))
def test_truncated_files_end_the_check(end):
    check_png(cv2.imencode(".png", pixels())[1].tobytes()[:end], "a")
    check_jpeg(cv2.imencode(".jpg", pixels())[1].tobytes()[:end], "a")
    check_png(zlib.compress(bytes(end)), "a")


def test_chunks_that_hold_no_pixels_print_nothing(capfd):
    data = cv2.imencode(".png", pixels())[1].tobytes()
    twice = data[:33] + chunk(b"gAMA", b"\0\0\xb1\x8f") * 2 + chunk(b"tIME", b"short") + data[33:]
    np.testing.assert_array_equal(decode_colour(twice, "a")[0], decode_colour(data, "a")[0])
    assert capfd.readouterr() == ("", "")
