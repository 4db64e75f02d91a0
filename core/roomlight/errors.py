"""Exceptions that RoomLight raises on purpose.

RoomLightError
├── OptionError           an option is out of range, unknown or contradicts another (also a ValueError)
├── CaptureError          a capture cannot be used at all (names the file)
│   └── UnknownFormatError   no reader recognises the folder or file
├── FrameError            one frame is unusable and is skipped (names file and frame)
├── ImageError            a file does not decode, or its size is out of bounds (names the file)
├── ProbeError            a probe position is not usable
├── ModelError            weights are missing, of another version or do not fit
├── FurnitureError        a furniture library or its cache is unusable (names file and model)
├── ObjectError           a virtual object or its file cannot be used (names the file and the rule)
├── SceneError            a scene, a place or a motion of virtual objects is refused (names the field)
├── StateError            a saved session is damaged, of another version or of other weights (names the file)
├── DatasetError          a dataset or one of its sequences cannot be read, continued or made
├── WireError             a message from the network is refused (names field, value and rule)
├── ServerError           a server cannot start with these settings (names the setting)
└── OutputError           a result cannot be written

Every message says what was wrong, with which value, and what to do. Messages name options as the Python API does;
the command line adds its own flag where it helps.
"""


class RoomLightError(Exception):
    """Base of all errors that RoomLight raises on purpose; the command line prints them without a traceback."""

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle by attributes: an error of a process pool arrives whatever arguments its class takes."""
        return type(self).__new__, (type(self), *self.args), self.__dict__


class OptionError(RoomLightError, ValueError):
    """An option is out of range, unknown, or contradicts another one.

    The message names the option as the Python API spells it, the value and the values that are allowed.
    """


class CaptureError(RoomLightError):
    """The capture as a whole cannot be used."""


class UnknownFormatError(CaptureError):
    """No reader recognises this path by its files."""


class FrameError(RoomLightError):
    """One frame of a capture cannot be used; reading goes on without it."""


class ImageError(RoomLightError):
    """An image file is missing, truncated, larger than the limit or of the wrong kind."""


class ProbeError(RoomLightError):
    """A probe position is not finite, or no light can be given for it."""


class ModelError(RoomLightError):
    """Weights are missing, of another version, or do not fit the request."""


class FurnitureError(RoomLightError):
    """A furniture library, one of its models, or the cache made from it cannot be used."""


class ObjectError(RoomLightError):
    """A virtual object, its file or its material cannot be used; nothing of it was kept."""


class SceneError(RoomLightError):
    """A scene of virtual objects, a place in it or a motion is refused; session and compositor are unchanged."""


class StateError(RoomLightError):
    """A saved session is damaged, or was made by another version, with other options or other weights."""


class DatasetError(RoomLightError):
    """A dataset, or one of its sequences, cannot be read, continued or made; other sequences stay untouched."""


class WireError(RoomLightError):
    """A message of the wire format is refused; it had no effect.

    Attributes:
        kind: Short name of the mistake, e.g. `bad-header`; `too-large` where a limit was passed.
        field: Where it is, as a path in the message (`depth.width`), or "" for the message as a whole.
        value: The refused value, shortened; "" where it says nothing.
        rule: What is allowed there.
    """

    def __init__(self, kind: str, *, field: str, value: object, rule: str) -> None:
        self.kind, self.field, self.rule = kind, field, rule
        self.value = text if len(text := str(value)) <= 120 else f"{text[:117]}..."
        super().__init__(f"{field or 'the message'}: {rule}{self.value and f'; got {self.value}'}")


class ServerError(RoomLightError):
    """A server's settings are not usable, or not safe."""


class OutputError(RoomLightError):
    """A result cannot be written to its path."""
