"""Kinds of damage to a capture, drawn by a seeded generator; `damaged` damages one to three files of a copy."""

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

VALUES = [
    float("nan"),
    float("inf"),
    10**400,
    -1,
    0,
    1e308,
    1e-308,
    True,
    None,
    "x",
    "",
    [],
    {},
    [[]],
    2**63,
    "../../x",
]
TOKENS = ["nan", "inf", "-inf", "0", "1e308", "1e999", "-1", "abc", "", "9" * 400, "\x00", "../../etc/passwd", "é"]


def truncated(file: Path, rng: random.Random) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: rng.randrange(len(data))] if data else b"")


def flipped(file: Path, rng: random.Random) -> None:
    data = bytearray(file.read_bytes())
    reach = len(data) if rng.random() < 0.5 else min(len(data), 200)
    for _ in range(rng.randrange(1, 12) if data else 0):
        data[rng.randrange(reach)] ^= 1 << rng.randrange(8)
    file.write_bytes(bytes(data))


def emptied(file: Path, _rng: random.Random) -> None:
    file.write_bytes(b"")


def noise(file: Path, rng: random.Random) -> None:
    file.write_bytes(rng.randbytes(rng.randrange(1, 3000)))


def extended(file: Path, rng: random.Random) -> None:
    file.write_bytes(file.read_bytes() + rng.randbytes(rng.randrange(1, 500)))


def zeroed(file: Path, rng: random.Random) -> None:
    data = bytearray(file.read_bytes())
    start = rng.randrange(max(1, len(data)))
    stop = min(len(data), start + rng.randrange(1, 400))
    data[start:stop] = bytes(stop - start)
    file.write_bytes(bytes(data))


def deleted(file: Path, _rng: random.Random) -> None:
    file.unlink()


def made_a_folder(file: Path, _rng: random.Random) -> None:
    file.unlink()
    file.mkdir()


def made_a_pipe(file: Path, _rng: random.Random) -> None:
    file.unlink()
    os.mkfifo(file)


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
    width, height = rng.choice([(60000, 60000), (2**31 - 1, 2**31 - 1), (0, 24), (33, 24), (1, 1), (32, 2**30)])
    if data[:4] == b"\x89PNG":
        data = bytearray(formats.png_with_size(bytes(data), width, height))
    elif data[:2] == b"\xff\xd8":
        at = data.index(b"\xff\xc0") if b"\xff\xc0" in data else 0
        data[at + 5 : at + 9] = struct.pack(">HH", height & 0xFFFF, width & 0xFFFF)
    elif data[:4] == b"\x76\x2f\x31\x01":
        at = data.index(b"dataWindow\x00box2i\x00") + 21
        corners = struct.pack("<iiii", *rng.choice([(0, 0, width - 1, height - 1), (-(2**31), 0, 2**31 - 1, 1)]))
        data[at : at + 16] = corners
    elif data[:4] == b"bvx-" or data[:3] == b"bvx":
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
        flipped(file, rng)


def json_of(data: bytes):
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return tree if isinstance(tree, dict) else None


def json_places(tree):
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield tree, key
        if isinstance(value, dict | list):
            yield from json_places(value)


def nested(file: Path, _rng: random.Random) -> None:
    depth = 200_000
    file.write_bytes(b'{"frames": ' + b"[" * depth + b"]" * depth + b"}")


def swapped(file: Path, rng: random.Random) -> None:
    other = rng.choice(sorted(path for path in file.parent.iterdir() if path.is_file()))
    first, second = file.read_bytes(), other.read_bytes()
    file.write_bytes(second)
    other.write_bytes(first)


DAMAGE = [truncated, flipped, emptied, noise, extended, zeroed, deleted, made_a_folder, made_a_pipe, linked_outside]
DAMAGE += [absurd_size, wrong_values, wrong_values, wrong_values, nested, swapped]
IN_ARCHIVE = [truncated, flipped, emptied, noise, extended, zeroed, deleted, absurd_size, wrong_values, nested, swapped]


def damaged_folder(folder: Path, damages: list, rng: random.Random) -> None:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    # The index and the few files that all frames share count as much as the many of one frame each.
    shared = [file for file in files if file.suffix in (".json", ".csv", ".txt", ".mp4", "")]
    for _ in range(rng.choice([1, 1, 2, 3])):
        file = rng.choice(shared if shared and rng.random() < 0.5 else files)
        if file.is_file() and not file.is_symlink():
            rng.choice(damages)(file, rng)


def damaged_archive(archive: Path, scratch: Path, rng: random.Random) -> None:
    if rng.random() < 0.35:
        rng.choice([truncated, flipped, emptied, noise, extended, zeroed, huge_member])(archive, rng)
        return
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(scratch)
    damaged_folder(scratch, IN_ARCHIVE, rng)
    archive.unlink()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(scratch.rglob("*")):
            if file.is_file():
                packed.write(file, file.relative_to(scratch))


def huge_member(archive: Path, rng: random.Random) -> None:
    """The central directory declares a size that is not so (a bomb's, or too small)."""
    data = bytearray(archive.read_bytes())
    entries = [at for at in range(len(data) - 4) if data[at : at + 4] == b"PK\x01\x02"]
    at = rng.choice(entries)
    data[at + 24 : at + 28] = struct.pack("<I", rng.choice([2**32 - 2, 2**30, 0, 1, 10]))
    archive.write_bytes(bytes(data))


def damaged(original: Path, scratch: Path, rng: random.Random) -> Path:
    """Copy a capture (folder or archive) below `scratch` and damage the copy."""
    path = scratch / "broken" / original.name
    if original.is_file():
        path.parent.mkdir()
        shutil.copy(original, path)
        if path.suffix == ".r3d":
            damaged_archive(path, scratch / "members", rng)
        else:
            rng.choice([truncated, flipped, flipped, emptied, noise, extended, zeroed, zeroed])(path, rng)
    else:
        shutil.copytree(original, path)
        damaged_folder(path, DAMAGE, rng)
    return path
