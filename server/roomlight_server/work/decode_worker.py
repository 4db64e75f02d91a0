"""Decoding of frames and objects, and the process that does it: `python -m roomlight_server.work.decode_worker FD`.

The process reads requests from standard input and writes results to standard output, one at a time, until the input
ends. Files and arrays are in the block of the descriptor FD (`shared_block`). A result is plain numbers and no pickle,
so that a decoder taken over by a hostile image cannot run code in the server. This module imports no engine: a process
takes 76 MB and starts in 0.4 s.
"""

import ctypes
import json
import os
import resource
import signal
import struct
import sys
import traceback
from collections.abc import Callable, Mapping
from typing import Any, BinaryIO, Final

import numpy as np
from jaxtyping import Bool

from roomlight.camera import Intrinsics
from roomlight.errors import ObjectError, RoomLightError, WireError
from roomlight.frame import Frame
from roomlight.wire.decoding import decode_frame, is_auto_exposed
from roomlight.wire.frame_message import UNLIMITED, FrameMessage, bad_frame, parse
from roomlight_server.work.shared_block import BLOCK_BYTES, SharedBlock

REQUEST: Final = struct.Struct("<IQI")
"""Lengths of the JSON (`work` and its arguments) and of the file, and seconds to live. A file that is larger than the
block follows the JSON."""
RESULT: Final = struct.Struct("<IQ")
"""Lengths of the JSON and of the arrays."""
READY: Final = b"ready\n"
Result = tuple[dict[str, Any], tuple[bytes | memoryview, ...]]
"""JSON and arrays."""
MAX_MEMORY_BYTES: Final = 2 * 2**30 + BLOCK_BYTES
"""Address space of the process, of which libraries of one thread take 0.7 GB: a file may take 1.3 GB."""
_trim: Final = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
"""Returns free memory to the system: an object of 31 MiB leaves 32 MB that glibc would keep."""


def decode_to_box(
    message: FrameMessage, index: int, reference: float, min_confidence: int, box: tuple[int, int]
) -> Frame:
    """Decode a frame and reduce it to fit into a box of (width, height) pixels.

    Raises:
        WireError: A part does not decode or has unusable values.
    """
    try:
        frame = decode_frame(message, index, reference_exposure=reference, min_confidence=min_confidence)
        return frame.resized(*box)
    except WireError:
        raise
    except (RoomLightError, ValueError) as error:
        size = f"{message.intrinsics.width} x {message.intrinsics.height}"
        raise bad_frame("intrinsics", size, str(error)) from error


def pack_frame(frame: Frame) -> Result:
    """Return a decoded frame as a result."""
    k = frame.intrinsics
    text = {
        "image": frame.image.shape[:2],
        "depth": frame.depth_m.shape,
        "masked": frame.seen is not None,
        "exposure": frame.exposure,
        "intrinsics": [k.fx, k.fy, k.cx, k.cy, k.width, k.height],
    }
    image, depth_m = (values.astype("<f4", copy=False) for values in (frame.image, frame.depth_m))
    masks = (frame.clipped,) if frame.seen is None else (frame.clipped, frame.seen)
    parts = (image, depth_m, *(mask.view(np.uint8) for mask in masks))
    return text, tuple(np.ascontiguousarray(part).reshape(-1).data.cast("B") for part in parts)


def unpack_frame(text: dict[str, Any], data: bytes | memoryview, message: FrameMessage, index: int) -> Frame:
    """Return the frame of a result of `pack_frame`, with arrays of its own: a kept image keeps no depth in memory."""
    (height, width), (depth_height, depth_width) = text["image"], text["depth"]
    pixels, depth_pixels = height * width, depth_height * depth_width
    depth_at = 12 * pixels

    def mask(number: int) -> Bool[np.ndarray, "h w"]:
        start = depth_at + 4 * depth_pixels + number * pixels
        return np.frombuffer(data, np.uint8, pixels, start).reshape(height, width) > 0

    return Frame(
        index=index,
        image=np.frombuffer(data, "<f4", 3 * pixels).reshape(height, width, 3).copy(),
        clipped=mask(0),
        seen=mask(1) if text["masked"] else None,
        depth_m=np.frombuffer(data, "<f4", depth_pixels, depth_at).reshape(depth_height, depth_width).copy(),
        intrinsics=Intrinsics(*text["intrinsics"]),
        camera_to_world=message.camera_to_world,
        timestamp_s=message.header.timestamp_s,
        source=f"frame {index}",
        auto_exposed=is_auto_exposed(message.header),
        depth_estimated=message.depth_estimated,
        exposure=text["exposure"],
    )


def _frame_result(body: bytes, index: int, reference: float, min_confidence: int, box: list[int]) -> Result:
    try:
        return pack_frame(decode_to_box(parse(body, UNLIMITED), index, reference, min_confidence, (box[0], box[1])))
    except WireError as error:
        fields = {"kind": error.kind, "field": error.field, "value": str(error.value)[:1000], "rule": error.rule}
        return {"rejected": fields}, ()


def _object_result(body: bytes, kind: str | None, limits: dict[str, int]) -> Result:
    from roomlight_server.work.object_packing import pack_object  # most processes decode frames only

    try:
        text, data = pack_object(body, kind, limits)
    except ObjectError as error:
        return {"rejected": {"kind": "bad-object", "field": "body", "value": "", "rule": str(error)[:1000]}}, ()
    return text, (data,)


def serve(
    requests: BinaryIO, results: BinaryIO, block: SharedBlock, answers: Mapping[str, Callable[..., Result]]
) -> None:
    """Answer requests until the input ends; `answers` has what is done by the name of the work.

    An exception is answered with its traceback (`failed`), or with `memory` if there was too little.
    """
    results.write(READY)
    results.flush()
    while len(head := requests.read(REQUEST.size)) == REQUEST.size:
        text_bytes, length, seconds = REQUEST.unpack(head)
        arguments = json.loads(requests.read(text_bytes))
        signal.alarm(seconds)  # ends this process, even inside a decoder, if the server that would kill it is gone
        work = arguments.pop("work")
        try:
            body = block.read(length) if length <= BLOCK_BYTES else requests.read(length)
            text, parts = answers[work](body, **arguments)
        except MemoryError:
            body, text, parts = b"", {"memory": True}, ()
        except Exception:
            body, text, parts = b"", {"failed": traceback.format_exc()[-4000:]}, ()
        encoded, size = json.dumps(text).encode(), sum(map(len, parts))
        if size <= BLOCK_BYTES:  # else the server refuses it
            block.write(*parts)
        signal.alarm(0)
        results.write(RESULT.pack(len(encoded), size) + encoded)
        results.flush()
        if work != "frame" and _trim is not None:
            del body, text, parts, encoded
            _trim(0)


def open_output(memory_bytes: int) -> BinaryIO:
    """Bound the address space of this process, which leaves no core dump and ignores Ctrl-C; return where it writes."""
    if sys.platform == "linux":  # macOS refuses limits below what it maps for every process
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the server ends its processes
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not enter the results
    return output


def main(answers: Mapping[str, Callable[..., Result]], memory_bytes: int) -> None:
    """Serve as a process, with a bounded address space and the block of the first argument."""
    serve(sys.stdin.buffer, open_output(memory_bytes), SharedBlock(int(sys.argv[1])), answers)


if __name__ == "__main__":
    main({"frame": _frame_result, "object": _object_result}, MAX_MEMORY_BYTES)
