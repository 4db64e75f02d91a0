"""Images of a few bytes that take long to decode."""

import re
import struct
import zlib

import cv2
import numpy as np


def jpeg_of_scans(count, height=36, width=48):
    """Return a progressive JPEG whose last scan is repeated until there are `count`."""
    image = np.full((height, width, 3), 128, np.uint8)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    starts = [match.start() for match in re.finditer(b"\xff\xda", data)]
    return data[:-2] + data[starts[-1] : -2] * (count - len(starts)) + b"\xff\xd9"


def chunk(kind, data):
    """Return a chunk of a PNG."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_of_texts(count, size, height=36, width=48):
    """Return a PNG with `count` compressed texts of `size` bytes each."""
    data = cv2.imencode(".png", np.full((height, width, 3), 90, np.uint8))[1].tobytes()
    packed = zlib.compress(bytes(size), 9)
    return data[:33] + b"".join(chunk(b"zTXt", b"k%d\0\0" % number + packed) for number in range(count)) + data[33:]
