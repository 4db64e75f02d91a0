"""Channels of OpenEXR files: which of them are the colour, and which is the depth.

Renderers write many layers into a file, named `Layer.Pass.Channel`. Colour is R, G, B without a layer, else the layer
that is called Combined, rgba, beauty or the like, else the only layer with R, G and B. Depth is Z, or Z or V of a layer
called depth, or the only Z or channel of the file; a Z beside X and Y is a vector, red is no depth, and neither are
mist, masks and disparity. Colour is divided by its alpha, by which EXR multiplies it.
"""

import os
import re
import struct
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import OpenEXR
from jaxtyping import Bool, Float, Shaped

from roomlight.errors import ImageError
from roomlight.imaging.colour_spaces import ACES_AP0, REC709, to_rec709
from roomlight.imaging.rates import exact_rate
from roomlight.notes import Note, oblong_pixels

_COMBINED: Final = ("combined", "rgba", "rgb", "beauty", "color", "colour", "image", "composite", "main")
_PASSES: Final = re.compile(
    r".(dir|ind|col)$|albedo|normal|position|vector|^uv$|crypto|emi(t|ssion)|^env|^ao$|shadow|mist|depth|luminance"
)
"""Layers of renderers that are a part of the picture, or none."""
_NO_DEPTH: Final = re.compile(
    r"mist|alpha|index|mask|confid|dispar|inv|norm|crypto|shadow|luminance|denois|(^|\.)(a|ao|x|u|g|b)$"
)
_DEEPEST: Final = 65504.0
"""Half's largest value: it and beyond, and infinity, mean that nothing was hit."""
_MOST_BYTES: Final = 1_280_000_000
"""Of all channels of a file together: floats of red, green, blue, alpha and depth of the largest picture that is read.
"""
_CHANNEL: Final = rb"[^\0]+\0([\0-\2])\0\0\0.{12}"
"""An entry of a header's list of channels; its kind, which OpenEXR tells of read pixels alone, is 1 for half floats."""
_CHANNELS: Final = re.compile(rb"channels\0chlist\0.{4}((?:%b)+)" % _CHANNEL, re.DOTALL)


def sequence_metadata(index: int, frames_per_second: float) -> dict[str, object]:
    """Return the attributes of a frame of a sequence: `framesPerSecond`, `roomlight:frame`, and `timeCode` from 0 on.

    Time code (SMPTE ST 12-1) counts up to 30 frames a second; up to 60 it counts pairs, and marks their second frame as
    a field. Faster sequences have none. Rates such as 29.97 count as 30, without dropped numbers.

    Args:
        index: of the frame, 0 the first of the recording.
        frames_per_second: rate at which indices count.
    """
    metadata: dict[str, object] = {"framesPerSecond": exact_rate(frames_per_second), "roomlight:frame": index}
    whole = round(frames_per_second)
    if 1 <= whole <= 60:
        seconds, rest = divmod(index, whole)
        frame, field = (rest, 0) if whole <= 30 else divmod(rest, 2)
        clock = (seconds // 3600 % 24, seconds // 60 % 60, seconds % 60, frame)
        metadata["timeCode"] = OpenEXR.TimeCode(*clock, 0, 0, field, *[0] * 11)
    return metadata


@dataclass(frozen=True)
class ExrChannels:
    """The full-size channels of all parts by name, as stored; `cropped`: where those lie that do not fill it."""

    name: str
    channels: dict[str, Shaped[np.ndarray, "h w"]]
    primaries: tuple[float, ...]
    cropped: dict[str, tuple[slice, slice]]
    notes: tuple[Note, ...] = ()

    def colour(self) -> Float[np.ndarray, "h w 3"]:
        """Return linear Rec. 709 RGB; a grey channel is repeated.

        Raises:
            ImageError: The file has no colour, or several and none is the main one.
        """
        image = self.stored_colour()
        layer = self._colour_layer()
        if layer is not None:
            if image.dtype.kind != "f":
                raise ImageError(f"{self.name}: the EXR holds integers, whose white is not stated; export half floats")
            alpha = self.channels.get(f"{layer}A")
            if alpha is not None:
                image = image / np.where((alpha > 0) & (alpha < 1), alpha, 1)[..., None]
            return self._to_rec709(image.astype(np.float32))
        return image.astype(np.float32)

    def stored_colour(self) -> Shaped[np.ndarray, "h w 3"]:
        """Return the channels of the colour as stored; a grey one is repeated. Raises ImageError as `colour`."""
        return np.stack([self.channels[key] for key in self._colour_channels()], axis=-1)

    def seen(self) -> Bool[np.ndarray, "h w"] | None:
        """Return where the colour's data window has pixels; None if that is everywhere. Raises ImageError as `colour`.

        Data windows that have no pixel of the picture hide nothing.
        """
        red = self._colour_channels()[0]
        if red not in self.cropped:
            return None
        seen = np.zeros(self.channels[red].shape, bool)
        seen[self.cropped[red]] = True
        return seen

    def alpha(self) -> Float[np.ndarray, "h w"] | None:
        """Return the alpha of the colour's layer; None without one. Raises ImageError as `colour`."""
        layer = self._colour_layer()
        return None if layer is None else self.channels.get(f"{layer}A")

    def _colour_channels(self) -> list[str]:
        """Return the names of red, green and blue, the only channel three times without them. Raises ImageError."""
        layer = self._colour_layer()
        if layer is not None:
            return [f"{layer}{key}" for key in "RGB"]
        known = [key for key in self.channels if key != "A"]
        if len(known) != 1:
            raise ImageError(f"{self.name}: the EXR has no colour (R, G, B); its channels are {_listed(self.channels)}")
        return known * 3

    def _colour_layer(self) -> str | None:
        """Return the prefix of the colour's channels; None if no layer has R, G and B."""
        layers = sorted({key[:-1] for key in self.channels if key[-1:] == "R"})
        layers = [layer for layer in layers if f"{layer}G" in self.channels and f"{layer}B" in self.channels]
        if "" in layers:
            return ""
        chosen = [layer for layer in layers if _last(layer) in _COMBINED]
        chosen = chosen or [layer for layer in layers if not _PASSES.search(_last(layer))]
        if layers and not chosen:
            raise ImageError(f"{self.name}: the EXR has only the passes {_listed(layers)}; export the combined picture")
        if len(chosen) > 1:
            raise ImageError(f"{self.name}: the EXR has the layers {_listed(chosen)}; keep the one that is the picture")
        return chosen[0] if chosen else None

    def depth(self) -> Float[np.ndarray, "h w"]:
        """Return the depth as stored; what was not hit is 0.

        Raises:
            ImageError: No channel, or more than one, can be the depth.
        """
        names = self._depth_channels()
        if len(names) != 1:
            what = "several channels that can be the depth" if names else "no depth channel (Z, Depth.Z or Depth.V)"
            listed = _listed(names or self.channels)
            raise ImageError(f"{self.name}: the EXR has {what}: {listed}; export depth in a file of its own")
        return self._depth_of(names[0])

    def depth_of_colour(self) -> Float[np.ndarray, "h w"] | None:
        """Return the depth beside the colour as `depth` does; None without, and where several channels can be it."""
        names = self._depth_channels()
        if self._colour_layer() is None or len(names) != 1 or names == ["R"]:
            return None
        return self._depth_of(names[0])

    def _depth_of(self, name: str) -> Float[np.ndarray, "h w"]:
        depth = self.channels[name].astype(np.float32)
        return np.where(depth >= _DEEPEST, np.float32(0), depth)

    def _depth_channels(self) -> list[str]:
        ranked: dict[int, list[str]] = {}
        names = [key for key in self.channels if not _NO_DEPTH.search(key.lower())]
        for key in names:
            layer, _, last = key.rpartition(".")
            vector, called = f"{layer}.X" if layer else "X", _last(f"{layer}.")
            inexact = int(called != "depth")
            if last.lower() in ("z", "depth") and vector not in self.channels:
                ranked.setdefault(0 if layer == "" else 1 + inexact if "depth" in called else 5, []).append(key)
            elif last.lower() in ("v", "y") and "depth" in called:
                ranked.setdefault((1 if last.lower() == "v" else 3) + inexact, []).append(key)
            elif last == "R" and "depth" in called and self._is_grey(f"{layer}."):
                ranked.setdefault(3 + inexact, []).append(key)
        if ranked:
            return ranked[min(ranked)]
        if len(self.channels) == 1:
            return names
        return ["R"] if set(self.channels) - {"A"} == {"R", "G", "B"} and self._is_grey("") else []

    def _is_grey(self, layer: str) -> bool:
        red, *others = (self.channels[f"{layer}{key}"] for key in "RGB" if f"{layer}{key}" in self.channels)
        return all(np.array_equal(red, other, equal_nan=True) for other in others)

    def _to_rec709(self, image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
        if max(abs(a - b) for a, b in zip(self.primaries, REC709, strict=True)) < 0.002:
            return image
        try:
            matrix = to_rec709(self.primaries)  # pyright: ignore[reportArgumentType]  (eight numbers)
        except ValueError as error:
            raise ImageError(f"{self.name}: the EXR {error}") from error
        return image @ matrix.T.astype(np.float32)


def exr_size(data: bytes, name: str) -> tuple[int, int]:
    """Read (width, height) of the larger of data and display window, without decoding pixels. Raises ImageError."""
    sizes: list[tuple[int, int]] = []
    for window in (b"dataWindow", b"displayWindow"):
        at = data.find(window + b"\x00box2i\x00")
        start = at + len(window) + 11
        if at >= 0 and len(data) >= start + 16:
            x0, y0, x1, y1 = struct.unpack_from("<iiii", data, start)
            sizes.append((x1 - x0 + 1, y1 - y0 + 1))
    if len(sizes) < 2:
        raise ImageError(f"{name}: the EXR header has no data window; the file is truncated or damaged")
    if any(min(size) < 1 for size in sizes):
        return 0, 0
    return max(sizes, key=lambda size: size[0] * size[1])


def read_exr(data: bytes, name: str) -> ExrChannels:
    """Decode all channels of a file whose size has been checked. Raises ImageError, also for too many channels."""
    path = Path(name)
    own_copy = None
    named = name.encode(errors="ignore").decode() == name  # the library takes names in UTF-8 alone
    if not named or not path.is_file() or path.stat().st_size != len(data):  # bytes from an archive or the network
        handle, own_name = tempfile.mkstemp(suffix=".exr")
        os.close(handle)
        own_copy = path = Path(own_name)
        own_copy.write_bytes(data)
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            _check_size([part.header for part in file.parts], data, name)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # copies of the headers: leaving the block empties them
            parts = [
                (dict(part.header), {key: np.asarray(channel.pixels) for key, channel in part.channels.items()})
                for part in file.parts
            ]
    except ImageError:
        raise
    except Exception as error:  # the binding raises bare RuntimeError, ValueError or Iex's own by version
        raise ImageError(f"{name}: the EXR does not decode ({error})") from error
    finally:
        if own_copy is not None:
            own_copy.unlink(missing_ok=True)
    if not parts or not all(planes for _, planes in parts):  # the binding prints what went wrong and goes on
        raise ImageError(f"{name}: the EXR does not decode; it is truncated or damaged")
    return _joined(parts, name)


def _check_size(headers: list[dict[str, Any]], data: bytes, name: str) -> None:
    """Refuse parts that take too many bytes, each channel in the larger of its own and the picture's window.

    Half floats take two bytes a value, four where they are laid into the picture's window, as the others do.
    """
    lists: list[bytes] = [match[1] for match in _CHANNELS.finditer(data[: 1 << 16])]
    size = 0
    for at, header in enumerate(headers):
        windows = (_window(header["dataWindow"]), _window(headers[0]["displayWindow"]))
        halves = 0
        if len(lists) == len(headers) and windows[0] == windows[1]:
            halves = re.findall(_CHANNEL, lists[at], re.DOTALL).count(b"\1")
        of_pixel = 4 * len(header["channels"]) - 2 * halves
        size += of_pixel * max((x1 - x0 + 1) * (y1 - y0 + 1) for x0, y0, x1, y1 in windows)
    if size > _MOST_BYTES:
        raise ImageError(
            f"{name}: the channels of the EXR take {size / 1e9:.2f} GB; up to {_MOST_BYTES / 1e9} GB are read: "
            "export fewer passes"
        )


def _joined(parts: list[tuple[dict[str, Any], dict[str, np.ndarray]]], name: str) -> ExrChannels:
    """Join the parts' channels, each laid into the first part's display window."""
    display = _window(parts[0][0]["displayWindow"])
    width, height = display[2] - display[0] + 1, display[3] - display[1] + 1
    channels: dict[str, np.ndarray] = {}
    cropped: dict[str, tuple[slice, slice]] = {}
    for header, planes in parts:
        x0, y0, x1, y1 = _window(header["dataWindow"])
        for key, pixels in planes.items():
            if pixels.dtype.kind not in "fu" or pixels.shape != (y1 - y0 + 1, x1 - x0 + 1):
                raise ImageError(
                    f"{name}: the EXR is deep, subsampled or damaged; plain half or float channels are read"
                )
            label = str(header.get("name", ""))
            full = key if len(parts) == 1 or not label or key.startswith(f"{label}.") else f"{label}.{key}"
            if len(parts) > 1 and len(planes) >= 3 and label.lower() in _COMBINED:
                full = key
            if (x0, y0, x1, y1) == display:
                channels[full] = pixels
                continue
            whole = np.zeros((height, width), pixels.dtype if pixels.dtype.kind == "u" else np.float32)
            rows = slice(max(y0, display[1]), min(y1, display[3]) + 1)
            columns = slice(max(x0, display[0]), min(x1, display[2]) + 1)
            if rows.start < rows.stop and columns.start < columns.stop:
                target = (
                    slice(rows.start - display[1], rows.stop - display[1]),
                    slice(columns.start - display[0], columns.stop - display[0]),
                )
                whole[target] = pixels[rows.start - y0 : rows.stop - y0, columns.start - x0 : columns.stop - x0]
                cropped[full] = target
            channels[full] = whole
    stated = parts[0][0].get("chromaticities")
    default = ACES_AP0 if parts[0][0].get("acesImageContainerFlag") == 1 else REC709
    primaries = tuple(float(value) for value in np.ravel(stated)) if stated is not None else default
    primaries = primaries if len(primaries) == 8 else default
    return ExrChannels(name, channels, primaries, cropped, tuple(_notes(parts[0][0], name)))


def _notes(header: dict[str, Any], name: str) -> Iterator[Note]:
    """Yield what the header says of pixels that no pinhole camera has."""
    yield from oblong_pixels(name, float(header.get("pixelAspectRatio", 1.0)))
    if "envmap" in header:
        yield Note(
            f"{name}: it is an environment map", "it is read as the picture of a pinhole", "cut a view out of it"
        )


def _window(box: Any) -> tuple[int, int, int, int]:
    (x0, y0), (x1, y1) = np.asarray(box[0]).tolist(), np.asarray(box[1]).tolist()
    return int(x0), int(y0), int(x1), int(y1)


def _last(layer: str) -> str:
    """Return the last name of `Layer.Pass.`, in lower case."""
    return layer.rstrip(".").rpartition(".")[2].lower()


def _listed(names: Any) -> str:
    texts = [str(name).rstrip(".") or "(no layer)" for name in names]
    return ", ".join(texts[:6]) + (f" and {len(texts) - 6} more" if len(texts) > 6 else "")
