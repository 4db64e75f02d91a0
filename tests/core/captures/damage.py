"""Kinds of damage to a capture, drawn by a seeded generator; `damaged` damages one to three files of a copy."""

import contextlib
import json
import os
import random
import shutil
import struct
import zipfile
from pathlib import Path

import cv2
import formats
import numpy as np

VALUES = [np.nan, np.inf, 10**400, -1, 0, 1e308, 1e-308, True, None, "x", "", [], {}, [[]], 2**63, "../../x"]
TOKENS = ["nan", "inf", "-inf", "0", "1e308", "1e999", "-1", "abc", "", "9" * 400, "\x00", "../../etc/passwd", "é"]
SIZES = [(60000, 60000), (2**31 - 1, 2**31 - 1), (0, 24), (33, 24), (1, 1), (32, 2**30)]


def other_bytes(file: Path, rng: random.Random) -> None:
    """Cut, flipped, emptied, replaced, extended or blanked."""
    data = file.read_bytes()
    at = rng.randrange(max(1, len(data)))
    end = at + rng.randrange(1, 400)
    flipped, reach = bytearray(data), rng.choice([len(data), min(len(data), 200)])
    for _ in range(rng.randrange(1, 12) if data else 0):
        flipped[rng.randrange(reach)] ^= 1 << rng.randrange(8)
    blanked = data[:at] + bytes(len(data[at:end])) + data[end:]
    noise = rng.randbytes(rng.randrange(1, 3000))
    file.write_bytes(rng.choice([data[:at], bytes(flipped), b"", noise, data + noise[:500], blanked]))


def no_file(file: Path, rng: random.Random) -> None:
    file.unlink()
    rng.choice([lambda _: None, Path.mkdir, os.mkfifo])(file)


def linked_outside(file: Path, rng: random.Random) -> None:
    """A link to a perfectly good file that is not in the capture, to /dev/zero, to nothing, or to itself."""
    target = rng.choice(["good", "/dev/zero", "missing", "loop", "/"])
    if target == "good":
        folder = next(parent for parent in file.parents if parent.name == "broken").parent
        target = str(shutil.copy(file, folder / f"outside-{file.name}"))
    file.unlink()
    file.symlink_to(file if target == "loop" else target)


def absurd_size(file: Path, rng: random.Random) -> None:
    """The header declares a gigantic or impossible image; everything else stays whole."""
    data = bytearray(file.read_bytes())
    width, height = rng.choice(SIZES)
    if data[:4] == b"\x89PNG":
        data = bytearray(formats.png_with_size(bytes(data), width, height))
    elif data[:2] == b"\xff\xd8":
        at = data.index(b"\xff\xc0") if b"\xff\xc0" in data else 0
        data[at + 5 : at + 9] = struct.pack(">HH", height & 0xFFFF, width & 0xFFFF)
    elif data[:4] == b"\x76\x2f\x31\x01":
        at = data.index(b"dataWindow\x00box2i\x00") + 21
        data[at : at + 16] = struct.pack(
            "<iiii", *rng.choice([(0, 0, width - 1, height - 1), (-(2**31), 0, 2**31 - 1, 1)])
        )
    elif data[:3] == b"bvx":
        data[4:8] = struct.pack("<I", rng.choice([0, 1, 2**31, 2**32 - 1]))
    elif b"avc1" in data:
        at = data.index(b"avc1") + 28
        data[at : at + 4] = struct.pack(">HH", width & 0xFFFF, height & 0xFFFF)
    file.write_bytes(bytes(data))


def wrong_values(file: Path, rng: random.Random) -> None:
    """Another value somewhere in a JSON or text index, or another unit in a depth map; damage for the rest."""
    data = file.read_bytes()
    tree = json_of(data)
    if tree:
        nodes = list(json_places(tree))
        for _ in range(rng.randrange(1, 4)):
            container, key = rng.choice(nodes)
            if rng.random() < 0.15 and isinstance(container, dict):
                container.pop(key, None)
            else:
                container[key] = rng.choice(VALUES)
        file.write_text(json.dumps(tree))
    elif file.suffix in (".txt", ".csv"):
        lines = data.decode(errors="replace").splitlines() or [""]
        row = rng.randrange(len(lines))
        words = lines[row].replace(",", " , ").split() or [""]
        words[rng.randrange(len(words))] = rng.choice(TOKENS)
        lines[row] = " ".join(words)
        if rng.random() < 0.2:
            del lines[rng.randrange(len(lines))]
        file.write_text("\n".join(lines))
    elif data[:4] == b"\x89PNG":
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if pixels is None:
            return
        grey = pixels if pixels.ndim == 2 else pixels[..., 0]
        changed = [grey.astype(np.uint16) // 1000, grey * 0, pixels[::2], grey.astype(np.uint8), np.dstack([grey] * 3)]
        ok, encoded = cv2.imencode(".png", rng.choice(changed))
        assert ok
        file.write_bytes(encoded.tobytes())
    else:
        other_bytes(file, rng)


def json_of(data: bytes):
    with contextlib.suppress(ValueError, RecursionError):
        tree = json.loads(data)
        return tree if isinstance(tree, dict) else None


def json_places(tree):
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield tree, key
        if isinstance(value, dict | list):
            yield from json_places(value)


def swapped(file: Path, rng: random.Random) -> None:
    other = rng.choice(sorted(path for path in file.parent.iterdir() if path.is_file()))
    first, second = file.read_bytes(), other.read_bytes()
    file.write_bytes(second)
    other.write_bytes(first)


IN_ARCHIVE = [*[other_bytes] * 5, lambda file, _: file.unlink(), absurd_size, *[wrong_values] * 3, swapped]
DAMAGE = [*IN_ARCHIVE, no_file, no_file, linked_outside]


def damaged_folder(folder: Path, damages: list, rng: random.Random) -> None:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    # The index and the few files that all frames share count as much as the many of one frame each.
    shared = [file for file in files if file.suffix in (".json", ".csv", ".txt", ".mp4", "")]
    for _ in range(rng.choice([1, 1, 2, 3])):
        file = rng.choice(shared if shared and rng.random() < 0.5 else files)
        if file.is_file() and not file.is_symlink():
            rng.choice(damages)(file, rng)


def damaged_archive(archive: Path, scratch: Path, rng: random.Random) -> None:
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(scratch)
    damaged_folder(scratch, IN_ARCHIVE, rng)
    files = sorted(path for path in scratch.rglob("*") if path.is_file())
    formats.zipped(archive, {str(file.relative_to(scratch)): file.read_bytes() for file in files})


def copied(original: Path, folder: Path) -> Path:
    """Copy a capture (folder or archive)."""
    path = folder / original.name
    folder.mkdir(parents=True, exist_ok=True)
    return Path(shutil.copytree(original, path) if original.is_dir() else shutil.copy(original, path))


def damaged(original: Path, scratch: Path, rng: random.Random) -> Path:
    """Copy a capture below `scratch` and damage the copy."""
    path = copied(original, scratch / "broken")
    if path.is_dir():
        damaged_folder(path, DAMAGE, rng)
    elif path.suffix == ".r3d" and rng.random() < 0.65:
        damaged_archive(path, scratch / "members", rng)
    else:
        other_bytes(path, rng)
    return path
