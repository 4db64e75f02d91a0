"""What can go wrong, as exceptions a caller can tell apart.

RoomLightError
├── CaptureError          a capture is refused whole (names the file)
│   └── UnknownFormatError   no reader recognises the folder or file
├── FrameError            one frame is unusable and is skipped (names file and frame)
├── ImageError            a file does not decode, or its size is absurd (names the file)
├── ProbeError            a probe position is not usable
├── ModelError            weights are missing, foreign or do not fit
├── FurnitureError        a furniture library or its cache is unusable (names file and model)
├── WireError             a message from the network is refused (names field, value and rule)
├── ServerError           a server cannot start with these settings (names the setting)
└── OutputError           a result cannot be written

Every message says what was wrong, with which value, and what to do.
"""


class RoomLightError(Exception):
    """Base of all errors that RoomLight raises on purpose; the command line prints them without a
    traceback."""


class CaptureError(RoomLightError):
    """The capture as a whole cannot be used."""


class UnknownFormatError(CaptureError):
    """No reader recognises this path by its files."""


class FrameError(RoomLightError):
    """One frame of a capture cannot be used; the capture goes on without it."""


class ImageError(RoomLightError):
    """An image file is missing, truncated, of an absurd size or of the wrong kind."""


class ProbeError(RoomLightError):
    """A probe position is not finite, or no light can be given for it."""


class ModelError(RoomLightError):
    """Weights are missing, of another version, or do not fit what is asked for."""


class FurnitureError(RoomLightError):
    """A furniture library, one of its models, or the cache made of it cannot be used."""


class DatasetError(RoomLightError):
    """A dataset, or one sequence of it, cannot be read, continued or made; the other sequences are not touched."""


class WireError(RoomLightError):
    """A message of the wire format is refused; nothing was done with it.

    kind:   a short name of what is wrong, e.g. `bad-header`; `too-large` where a limit was passed.
    field:  where, as a path in the message (`depth.width`), or "" for the message as a whole.
    value:  what stood there, shortened.
    rule:   what would have been right.
    """

    def __init__(self, kind: str, *, field: str, value: object, rule: str) -> None:
        """The message is made of the parts."""
        self.kind, self.field, self.rule = kind, field, rule
        self.value = shown if len(shown := str(value)) <= 120 else f"{shown[:117]}..."
        super().__init__(f"{field or 'the message'}: {rule}; got {self.value}")


class ServerError(RoomLightError):
    """A session server's settings are not usable, or not safe."""


class OutputError(RoomLightError):
    """A result cannot be written where it was asked to go."""
