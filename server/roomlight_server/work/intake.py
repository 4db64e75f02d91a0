"""Parsing and decoding of frames at the engine's working size; these functions run on decoding threads.

A frame is parsed and its sizes are checked before it is accepted. It is also decoded before, unless another frame is
waiting in the queue: then it is decoded when the engine takes it.
"""

import hashlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from roomlight.engine.preparation import WORKING_SIZE
from roomlight.frame import Frame
from roomlight.wire.frame_message import FrameLimits, FrameMessage, bad_frame, parse
from roomlight_server.work.decode_processes import DecodeProcesses
from roomlight_server.work.decode_worker import decode_to_box


@dataclass(frozen=True)
class LatestFrame:
    """The last processed frame, as received; `depth_m` is what was estimated if it came without usable depth."""

    index: int
    message: FrameMessage
    depth_m: Float32[np.ndarray, "dh dw"] | None = None

    @property
    def size(self) -> int:
        """Bytes of the message without its header."""
        parts = (self.message.colour, self.message.depth, self.message.confidence)
        return sum(part.nbytes for part in parts if part is not None)


def parse_frame(body: bytes, limits: FrameLimits) -> tuple[FrameMessage, bytes]:
    """Parse a message; return it with its digest, which identifies a repetition of the same bytes.

    Raises:
        WireError: The message is malformed or exceeds the limits.
    """
    return parse(body, limits), hashlib.sha256(body).digest()


def decode_to_size(
    message: FrameMessage,
    index: int,
    reference: float,
    min_confidence: int,
    processes: DecodeProcesses,
    *,
    box: tuple[int, int] = WORKING_SIZE,
) -> Frame:
    """Decode a frame at the working size (a waiting frame takes 1.3 MB, whatever the camera).

    Image files are decoded in a process with a time limit; raw and zstd parts, whose sizes bound the time, on this
    thread.

    Args:
        reference: Exposure at which radiance 1 is white.
        min_confidence: Depth below this confidence becomes unknown.
        box: Width and height that the frame is reduced to fit into.

    Raises:
        WireError: A part does not decode, has unusable values or takes too long.
    """
    header = message.header
    planes = [None if part is None else part.encoding for part in (header.depth, header.confidence)]
    if header.colour.encoding in ("jpeg", "png", "heic") or "png" in planes:
        return processes.decode(message, index, reference, min_confidence, box)
    return decode_to_box(message, index, reference, min_confidence, box)


def index_of(message: FrameMessage, index: int | None) -> int:
    """Return the index of the path, or the message's own if there is no path index (None).

    Raises:
        WireError: Both are missing, or they differ.
    """
    stated = message.header.index
    if index is None and stated is None:
        raise bad_frame("index", "nothing", "required on a WebSocket")
    if index is not None and stated not in (None, index):
        raise bad_frame("index", stated, f"must equal the index of the path, {index}")
    return stated if index is None and stated is not None else index or 0
