"""Encode a sequence to files and decode it: RoomLight's own capture format with three additions.

    capture.json, colour/*.jpg, depth/*.png, probes/*.exr    as in `roomlight.captures.native`
    surface/000000.png    uint8: kind of surface of each pixel (`recording.ORDINARY`, ...)
    clipped/000000.exr    half float: `Recording.clipped_radiance`; optional, datasets of earlier versions have none
    facts.json            `Recording.facts`

A sequence extracted from its shard is therefore a capture that `roomlight replay` and `roomlight eval` read. The module
writes the format itself because `roomlight.captures` imports video decoders, which a machine that only generates may
lack; a test compares the two.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float16, Shaped

from roomlight.camera import Intrinsics, check_rigid
from roomlight.dataset.recording import Recording
from roomlight.errors import ImageError
from roomlight.images import decode_colour, encode_exr

CAPTURE: Final = "capture.json"
FACTS: Final = "facts.json"
_FORMAT: Final = "roomlight-capture"
_VERSION: Final = 1
_INTRINSICS: Final = ("fx", "fy", "cx", "cy", "width", "height")

JPEG_QUALITY: Final = 95
"""With full chroma: 35 kB for a frame of 320 x 240 with sensor noise. Quality 92 with half chroma lets the edges of
coloured lamps bleed over 4 pixels and removes most of the noise that the networks must learn to handle."""
PNG_LEVEL: Final = 3
"""31 exact depth maps of 320 x 240: 0.95 MB in 0.05 s at level 1, 0.83 MB in 0.08 s at 3, 0.69 MB in 0.17 s at 6."""
HALF_MAX: Final = 65504.0
"""Largest half float. The sun's disc, a tenth of a probe's pixel, can exceed it in units of a dim room's white: such
panoramas are stored as 32-bit floats."""


def encode(recording: Recording) -> dict[str, bytes]:
    """Encode a recording to files by name, the small ones first.

    Raises:
        ValueError: The recording's arrays disagree, or hold values that cannot be stored.
    """
    _check(recording)
    count = len(recording.colour)
    clipped = recording.clipped_radiance
    lens = {key: getattr(recording.intrinsics, key) for key in _INTRINSICS}
    frames = [
        {
            "colour": _frame_name("colour", k),
            "depth": _frame_name("depth", k),
            "surface": _frame_name("surface", k),
            **({} if clipped is None else {"clipped": _frame_name("clipped", k)}),
            "intrinsics": lens,
            "camera_to_world": recording.camera_to_world[k].astype(np.float64).tolist(),
            "timestamp_s": float(recording.timestamp_s[k]),
            "exposure": float(recording.exposure[k]),
        }
        for k in range(count)
    ]
    probes = [
        {"position": position, "panorama": _probe_name(k)}
        for k, position in enumerate(recording.probe_positions.astype(np.float64).tolist())
    ]
    index = {"format": _FORMAT, "version": _VERSION, "name": recording.name, "frames": frames, "probes": probes}
    files = {CAPTURE: _json(index), FACTS: _json(recording.facts)}
    for k, panorama in enumerate(recording.probe_panoramas):
        files[_probe_name(k)] = encode_exr(panorama, half=bool(panorama.max() <= HALF_MAX))
    for k in range(count):
        files[_frame_name("colour", k)] = _jpeg(recording.colour[k])
        files[_frame_name("depth", k)] = _png(recording.depth_mm[k])
        files[_frame_name("surface", k)] = _png(recording.surface[k])
        if clipped is not None:
            files[_frame_name("clipped", k)] = encode_exr(clipped[k])
    return files


def decode(
    files: Mapping[str, bytes | memoryview],
    label: str,
    *,
    frames: Iterable[int] | None = None,
    probes: bool = True,
    clipped: bool = False,
) -> Recording:
    """Decode the requested frames (None: all) of a sequence's files, in the requested order.

    Args:
        files: The files by name.
        label: Prefix of error messages.
        frames: Numbers of the frames to decode.
        probes: Whether to decode the probes; without them the recording has none.
        clipped: Whether to decode the radiance of clipped pixels, where the sequence has it.

    Raises:
        IndexError: A frame does not exist.
        ValueError: The files are not a sequence's.
        ImageError: An image does not decode.
    """
    index: dict[str, Any] = json.loads(bytes(_file(files, CAPTURE)))
    listed: list[dict[str, Any]] = index["frames"]
    chosen = range(len(listed)) if frames is None else list(frames)
    for k in chosen:
        if not 0 <= k < len(listed):
            raise IndexError(f"{label}: there is no frame {k}; frames are 0 to {len(listed) - 1}")
    entries = [listed[k] for k in chosen]
    lens = Intrinsics(**listed[0]["intrinsics"])
    shape = (lens.height, lens.width)
    truths: list[dict[str, Any]] = index["probes"] if probes else []
    panoramas = [
        decode_colour(bytes(_file(files, probe["panorama"])), f"{label}/{probe['panorama']}")[0] for probe in truths
    ]
    return Recording(
        name=index["name"],
        colour=_stack([_image(files, entry["colour"], label, bgr=True) for entry in entries], (*shape, 3), np.uint8),
        depth_mm=_stack([_image(files, entry["depth"], label) for entry in entries], shape, np.uint16),
        surface=_stack([_image(files, entry["surface"], label) for entry in entries], shape, np.uint8),
        intrinsics=lens,
        camera_to_world=np.array([entry["camera_to_world"] for entry in entries], np.float64).reshape(-1, 4, 4),
        exposure=np.array([entry["exposure"] for entry in entries], np.float64),
        timestamp_s=np.array([entry["timestamp_s"] for entry in entries], np.float64),
        probe_positions=np.array([probe["position"] for probe in truths], np.float64).reshape(-1, 3),
        probe_panoramas=np.stack(panoramas) if panoramas else np.zeros((0, 1, 2, 3), np.float32),
        facts=json.loads(bytes(_file(files, FACTS))),
        clipped_radiance=_clipped(files, entries, shape, label) if clipped else None,
    )


def _check(recording: Recording) -> None:
    """Raise ValueError for a recording that the files cannot hold or a reader would refuse."""
    count, height, width, _ = recording.colour.shape
    lens, probes = recording.intrinsics, recording.probe_panoramas
    lengths = {
        "depth_mm": len(recording.depth_mm),
        "surface": len(recording.surface),
        "camera_to_world": len(recording.camera_to_world),
        "exposure": len(recording.exposure),
        "timestamp_s": len(recording.timestamp_s),
    }
    wrong = {name: length for name, length in lengths.items() if length != count}
    if count == 0 or wrong:
        raise ValueError(f"{recording.name}: {count} frames of colour but {wrong or 'no frames'}")
    if (lens.height, lens.width) != (height, width) or recording.depth_mm.shape[1:] != (height, width):
        raise ValueError(
            f"{recording.name}: colour is {width} x {height}, depth {recording.depth_mm.shape[:0:-1]}, intrinsics are "
            f"for {lens.width} x {lens.height}"
        )
    clipped = recording.clipped_radiance
    if clipped is not None and clipped.shape != recording.colour.shape:
        raise ValueError(f"{recording.name}: clipped_radiance is {clipped.shape}, colour {recording.colour.shape}")
    if clipped is not None and (not np.isfinite(clipped).all() or (clipped < 0).any()):
        raise ValueError(f"{recording.name}: clipped_radiance must be finite and not below 0")
    for pose in recording.camera_to_world:
        check_rigid(pose)
    if not (recording.exposure > 0).all() or not np.isfinite(recording.exposure).all():
        raise ValueError(f"{recording.name}: exposures must be positive, got {recording.exposure.min()}")
    if len(probes) != len(recording.probe_positions) or probes.shape[2] != 2 * probes.shape[1]:
        raise ValueError(
            f"{recording.name}: {len(recording.probe_positions)} probes with panoramas of shape {probes.shape}"
        )
    if not np.isfinite(recording.probe_positions).all() or not np.isfinite(probes).all() or (probes < 0).any():
        raise ValueError(f"{recording.name}: probes must be finite and not below 0")


_SUFFIXES: Final = {"colour": "jpg", "clipped": "exr"}


def _frame_name(part: str, number: int) -> str:
    return f"{part}/{number:06d}.{_SUFFIXES.get(part, 'png')}"


def _probe_name(number: int) -> str:
    return f"probes/{number:02d}.exr"


def _json(values: dict[str, Any]) -> bytes:
    return json.dumps(values, default=_plain, allow_nan=False, separators=(",", ":")).encode()


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise ValueError(f"a fact of type {type(value).__name__} cannot be stored")


def _jpeg(image: Shaped[np.ndarray, "h w 3"]) -> bytes:
    full_chroma = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    ok, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), quality + full_chroma)
    if not ok:
        raise ValueError(f"a frame of {image.shape} {image.dtype} does not encode as JPEG")
    return data.tobytes()


def _png(image: Shaped[np.ndarray, "h w"]) -> bytes:
    ok, data = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    if not ok:
        raise ValueError(f"a map of {image.shape} {image.dtype} does not encode as PNG")
    return data.tobytes()


def _file(files: Mapping[str, bytes | memoryview], name: str) -> bytes | memoryview:
    if name not in files:
        raise ValueError(f"the sequence has no {name}")
    return files[name]


def _image(
    files: Mapping[str, bytes | memoryview], name: str, label: str, *, bgr: bool = False
) -> Shaped[np.ndarray, "h w *c"]:
    data = np.frombuffer(_file(files, name), np.uint8)
    image = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR if bgr else cv2.IMREAD_UNCHANGED))
    if not image.ndim:  # OpenCV returns None
        raise ImageError(f"{label}/{name}: does not decode")
    return image[..., ::-1] if bgr else image


def _clipped(
    files: Mapping[str, bytes | memoryview], entries: Sequence[dict[str, Any]], shape: tuple[int, int], label: str
) -> Float16[np.ndarray, "f h w 3"] | None:
    """Decode the radiance of clipped pixels; None if a frame has none stored."""
    if not entries or any("clipped" not in entry for entry in entries):
        return None
    names: list[str] = [entry["clipped"] for entry in entries]
    images = [decode_colour(bytes(_file(files, name)), f"{label}/{name}")[0].astype(np.float16) for name in names]
    return _stack(images, (*shape, 3), np.float16)


def _stack(
    images: Sequence[Shaped[np.ndarray, "..."]], shape: tuple[int, ...], dtype: type[np.generic]
) -> Shaped[np.ndarray, "..."]:
    """Stack frames, also none, into one array. Raises ValueError if one has another shape or type."""
    stacked = np.empty((len(images), *shape), dtype)
    for k, image in enumerate(images):
        if image.shape != shape or image.dtype != dtype:
            raise ValueError(f"frame {k} is {image.dtype} {image.shape}, not {np.dtype(dtype)} {shape}")
        stacked[k] = image
    return stacked
