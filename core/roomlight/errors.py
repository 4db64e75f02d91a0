"""What can go wrong, as exceptions a caller can tell apart.

RoomLightError
├── CaptureError          a capture is refused whole (names the file)
│   └── UnknownFormatError   no reader recognises the folder or file
├── FrameError            one frame is unusable and is skipped (names file and frame)
├── ImageError            a file does not decode, or its size is absurd (names the file)
├── ProbeError            a probe position is not usable
├── ModelError            weights are missing, foreign or do not fit
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


class OutputError(RoomLightError):
    """A result cannot be written where it was asked to go."""
