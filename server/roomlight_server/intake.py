"""From a frame's bytes to a frame at the engine's size: what runs on decoding threads.

A frame is parsed, and all its sizes checked, before it is accepted. Decoded it is before, too, or, where it takes the
place of one that still waits, when its turn comes.
"""

import hashlib

from roomlight.engine.session import WORKING_SIZE
from roomlight.errors import RoomLightError, WireError
from roomlight.frame import Frame
from roomlight.wire.decoding import decode_frame
from roomlight.wire.frame_message import FrameLimits, FrameMessage, parse


def parse_frame(body: bytes, limits: FrameLimits) -> tuple[FrameMessage, bytes]:
    """The message, and the digest that tells its repetition from another. Raises WireError."""
    return parse(body, limits), hashlib.sha256(body).digest()


def decode_to_size(message: FrameMessage, index: int, reference: float, min_confidence: int) -> Frame:
    """The frame at the working size, so that one that waits takes 1.3 MB whatever the camera. Raises WireError."""
    try:
        frame = decode_frame(message, index, reference_exposure=reference, min_confidence=min_confidence)
        return frame.resized(*WORKING_SIZE)
    except WireError:
        raise
    except (RoomLightError, ValueError) as error:
        size = f"{message.intrinsics.width} x {message.intrinsics.height}"
        raise WireError("bad-frame", field="intrinsics", value=size, rule=str(error)) from error


def index_of(message: FrameMessage, index: int | None) -> int:
    """The address's index, or the message's own where there is no address (None). Raises WireError."""
    stated = message.header.index
    if index is None and stated is None:
        raise WireError("bad-frame", field="index", value="nothing", rule="a frame on a WebSocket states its index")
    if index is not None and stated not in (None, index):
        raise WireError("bad-frame", field="index", value=stated, rule=f"must be the address's, {index}")
    return stated if index is None and stated is not None else index or 0
