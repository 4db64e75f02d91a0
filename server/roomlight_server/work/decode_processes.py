"""Processes that decode images and objects."""

from dataclasses import asdict
from functools import partial

from roomlight.compositing.objects.virtual_object import VirtualObject
from roomlight.errors import ObjectError, WireError
from roomlight.frame import Frame
from roomlight.wire.frame_message import FrameMessage, bad_frame
from roomlight_server.base.settings import ServerSettings
from roomlight_server.work.decode_worker import unpack_frame
from roomlight_server.work.object_packing import unpack_object
from roomlight_server.work.processes import Cancellation, KilledError, Processes


class DecodeProcesses(Processes):
    """Decoding processes. Methods may be called on any thread."""

    def __init__(self, settings: ServerSettings) -> None:
        super().__init__("roomlight_server.work.decode_worker", "decoding", spare=True)
        self._timeout_s, self._object_timeout_s = settings.decode_timeout_s, settings.object_timeout_s
        self._object_limits = settings.object_limits

    def decode(
        self, message: FrameMessage, index: int, reference: float, min_confidence: int, box: tuple[int, int]
    ) -> Frame:
        """Decode a frame and reduce it to fit into a box of (width, height) pixels.

        Raises:
            WireError: A part does not decode, has unusable values, takes too long or ends the decoder.
            RuntimeError: The decoder failed.
        """
        body = message.colour.obj
        assert isinstance(body, bytes)
        arguments = {"work": "frame", "index": index, "reference": reference, "min_confidence": min_confidence}
        try:
            unpack = partial(unpack_frame, message=message, index=index)
            return self._request(arguments | {"box": box}, body, self._timeout_s, unpack)
        except KilledError as error:
            value = f"{len(body)} bytes, {message.header.colour.encoding}"
            raise bad_frame("colour", value, str(error)) from error

    def decode_object(self, body: bytes, kind: str | None, cancel: Cancellation | None = None) -> VirtualObject:
        """Decode the file of an object; `cancel` ends it.

        Raises:
            WireError: The file is refused, takes too long or ends the decoder; of the kind bad-object.
            RuntimeError: The decoder failed.
        """
        arguments = {"work": "object", "kind": kind, "limits": asdict(self._object_limits)}
        try:
            return self._request(arguments, body, self._object_timeout_s, unpack_object, cancel=cancel)
        except (KilledError, ObjectError) as error:
            raise WireError("bad-object", field="body", value="", rule=str(error)) from error
