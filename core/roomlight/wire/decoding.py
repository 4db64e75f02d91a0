"""Decode a parsed frame message to a `Frame`: linear RGB, depth in metres, exposure and confidence applied.

`frame_message.parse` has checked every size against the header; decompression stops at these sizes.
"""

import numpy as np
import zstandard
from jaxtyping import Float, Float32, UInt8

from roomlight.conventions import srgb8_to_linear
from roomlight.depth import DEPTH_MEDIAN_M, clean_depth
from roomlight.errors import RoomLightError, WireError
from roomlight.frame import Frame, clipped_pixels, hidden
from roomlight.images import ColourImage, decode_depth, decode_grey8, decode_picture
from roomlight.imaging.heic import heic_available, heic_size
from roomlight.wire.frame_header import DEPTH_BYTES, ConfidencePart, DepthPart, FrameHeader
from roomlight.wire.frame_message import FrameMessage, bad_frame


def decode_frame(
    message: FrameMessage, index: int, *, reference_exposure: float = 1.0, min_confidence: int = 1
) -> Frame:
    """Decode the message to a frame; a radiance of 1 is white at the reference exposure.

    Depth whose confidence is below `min_confidence` becomes unknown. A message without depth gives a frame without, and
    so does one whose depth is 0 or NaN everywhere, or nowhere of that confidence.

    Raises:
        WireError: A part does not decode or has unusable values; `field` names it.
    """
    picture = _colour(message)
    image = picture.image
    ratio = message.header.exposure / reference_exposure
    if ratio != 1.0:  # keeps unscaled images bit-exact
        image = image / np.float32(ratio)
    depth_m = _depth(message, min_confidence)
    if picture.seen is not None and message.header.colour.encoding != "linear_f32":
        known = depth_m.any()
        image, depth_m = hidden(image, depth_m, picture.seen)
        if known and not depth_m.any():
            raise bad_frame("depth", "0 pixels", "at least one pixel that is opaque must have a known depth")
    try:
        return Frame(
            index=index,
            image=image,
            clipped=picture.clipped,
            seen=picture.seen,
            depth_m=depth_m,
            intrinsics=message.intrinsics,
            camera_to_world=message.camera_to_world,
            timestamp_s=message.header.timestamp_s,
            source=f"frame {index}",
            auto_exposed=is_auto_exposed(message.header),
            depth_estimated=message.depth_estimated,
            exposure=ratio,
        )
    except RoomLightError as error:
        raise bad_frame("colour", message.header.colour.encoding, str(error)) from error


def is_auto_exposed(header: FrameHeader) -> bool:
    """Return `Frame.auto_exposed` of a message."""
    unstated = header.colour.encoding != "linear_f32" and header.exposure == 1.0
    return unstated if header.auto_exposed is None else header.auto_exposed


def _colour(message: FrameMessage) -> ColourImage:
    encoding, data = message.header.colour.encoding, message.colour
    width, height = message.intrinsics.width, message.intrinsics.height
    if encoding == "linear_f32":
        image = np.frombuffer(data, "<f4", height * width * 3).reshape(height, width, 3).astype(np.float32)
        marks = np.frombuffer(data, np.uint8, offset=12 * height * width).reshape(height, width)
        seen = (marks != 2) & (marks != 3)
        return ColourImage(image, (marks > 0) & (marks != 2), None if seen.all() else seen)
    if encoding == "rgb8":
        rgb = np.frombuffer(data, np.uint8).reshape(height, width, 3)
        return ColourImage(srgb8_to_linear(rgb), clipped_pixels(rgb))
    if encoding == "heic" and not heic_available():
        rule = "the server has no HEIC decoder (pip install 'roomlight[heic]'); send jpeg or png"
        raise bad_frame("colour.encoding", "heic", rule)
    try:
        if encoding == "heic":  # its size is known before any pixel is decoded
            _check_size(heic_size(bytes(data), "the image"), (width, height))
        # turned by its EXIF orientation, the image would no longer fit its depth and intrinsics
        picture = decode_picture(bytes(data), "the image", as_stored=True)
    except WireError:
        raise
    except RoomLightError as error:
        raise bad_frame("colour", f"{len(data)} bytes of {encoding}", str(error)) from error
    _check_size(picture.image.shape[1::-1], (width, height))
    return picture


def _check_size(size: tuple[int, ...], stated: tuple[int, int]) -> None:
    if size != stated:
        rule = f"the image must have the size stated in the header, {stated[0]} x {stated[1]}"
        raise bad_frame("colour", f"{size[0]} x {size[1]}", rule)


def _depth(message: FrameMessage, min_confidence: int) -> Float[np.ndarray, "dh dw"]:
    part, data = message.header.depth, message.depth
    if part is None or data is None:  # estimated later
        return np.zeros((message.intrinsics.height, message.intrinsics.width), np.float32)
    if part.encoding == "png":
        try:
            depth_m = decode_depth(bytes(data), "the depth map", unit_m=0.001)
        except RoomLightError as error:
            raise bad_frame("depth", f"{len(data)} bytes of png", str(error)) from error
    else:
        raw = _plane(part, data, DEPTH_BYTES[part.format], "depth")
        if part.format == "uint16_mm":
            millimetres = np.frombuffer(raw, "<u2")
            depth_m = millimetres.astype(np.float32) * np.float32(0.001)
            depth_m[millimetres == 65535] = 0.0
        else:
            depth_m = np.frombuffer(raw, "<f2" if part.format == "float16_m" else "<f4").astype(np.float32)
    if not (np.abs(depth_m) > 0).any():  # the sensor measured nothing: NaN, too, compares as False
        return np.zeros((part.height, part.width), np.float32)
    depth_m = clean_depth(depth_m.reshape(part.height, part.width))
    _check_median(depth_m, part.format)
    if message.confidence is None or message.header.confidence is None:
        return depth_m
    confidence = _confidence(message.header.confidence, message.confidence)
    if (highest := confidence.max()) > 2:
        raise bad_frame("confidence", f"a pixel of {highest}", "each pixel must be 0 (low), 1 (medium) or 2 (high)")
    return np.where(confidence >= min_confidence, depth_m, np.float32(0))


def _check_median(depth_m: Float32[np.ndarray, "h w"], unit: str) -> None:
    known, (low, high) = np.count_nonzero(depth_m), DEPTH_MEDIAN_M
    if not known:
        raise bad_frame("depth", "0 known pixels", "at least one must be above 0 and up to 100 km, or all be 0 or NaN")
    if 2 * np.count_nonzero((depth_m >= low) & (depth_m <= high)) > known:
        return  # the median is between these, and takes 1 ms
    median_m = float(np.median(depth_m[depth_m > 0]))
    if not low <= median_m <= high:
        rule = f"must be {low:g} to {high:g} m; check that the unit is that of {unit}"
        raise bad_frame("depth", f"a median of {median_m:.4g} m", rule)


def _confidence(part: ConfidencePart, data: memoryview) -> UInt8[np.ndarray, "h w"]:
    if part.encoding != "png":
        return np.frombuffer(_plane(part, data, 1, "confidence"), np.uint8).reshape(part.height, part.width)
    try:
        return decode_grey8(bytes(data), "the confidence map")
    except RoomLightError as error:
        raise bad_frame("confidence", f"{len(data)} bytes of png", str(error)) from error


def _plane(part: DepthPart | ConfidencePart, data: memoryview, item: int, field: str) -> bytes | memoryview:
    """Return the raw values of a plane; decompression is limited to their size."""
    size = part.width * part.height * item
    if part.encoding == "raw":
        return data
    try:
        # no depth map needs a window above 8 MB; without this bound a message of 18 bytes allocates 128 MB
        decompressor = zstandard.ZstdDecompressor(max_window_size=2**23)
        raw = decompressor.decompress(data, max_output_size=size, allow_extra_data=False)
    except (zstandard.ZstdError, MemoryError) as error:
        raise bad_frame(field, f"{len(data)} bytes of zstd", f"must decompress to {size} bytes ({error})") from error
    if len(raw) != size:
        raise bad_frame(field, f"{len(raw)} bytes decompressed", f"must be {size}")
    return raw
