"""300 damaged files: each is read or refused with ObjectError, without a crash or memory beyond the file's own."""

import base64
import json
import tracemalloc
from typing import Any

import cv2
import numpy as np
import pytest
from gltf_files import GltfFile, packed, textured_quad
from test_loading import OBJ, OBJ_FACE, PLY

from roomlight.compositing.loading import load_object
from roomlight.errors import ObjectError

_VALUES = [0, -1, 1, 7, 2**31 - 1, 2**32, 2**63, 1e38, -0.5, "x", "", None, [], {}, True, [0] * 16, "data:;base64,AAAA"]


def _damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip, overwrite, cut or repeat bytes."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(0, len(out)))
        kind = rng.integers(0, 5)
        if kind == 0:
            out[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            out[at : at + 4] = rng.bytes(4)
        elif kind == 2:
            out[at : at + 4] = b"\xff\xff\xff\x7f"
        elif kind == 3:
            del out[at : at + int(rng.integers(1, 40))]
        else:
            out[at:at] = out[at : at + int(rng.integers(1, 40))]
    return bytes(out)


def _changed(tree: Any, rng: np.random.Generator) -> None:
    """Replace a value somewhere in a JSON tree by another."""
    while True:
        keys = list(tree) if isinstance(tree, dict) else list(range(len(tree)))
        key = keys[int(rng.integers(0, len(keys)))]
        below = tree[key]
        if not isinstance(below, dict | list) or not below or rng.random() < 0.1:
            tree[key] = _VALUES[int(rng.integers(0, len(_VALUES)))]
            return
        tree = below


def _is_refused(data: bytes, kind: Any) -> bool:
    tracemalloc.start()
    try:
        load_object(data, kind)
    except ObjectError:
        return True
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 20_000_000
    return False


@pytest.mark.parametrize("seed", range(5))
def test_damaged_bytes_are_read_or_refused(seed: int) -> None:
    load_object(OBJ + OBJ_FACE, "obj")  # imports of the loader are not its memory
    rng = np.random.default_rng(seed)
    glb = textured_quad().glb()
    binary_ply = PLY.replace(b"ascii", b"binary_little_endian")
    sources = [(glb, None), (OBJ + OBJ_FACE, "obj"), (PLY, "ply"), (binary_ply, "ply")]
    refused = 0
    for _ in range(40):
        data, kind = sources[int(rng.integers(0, len(sources)))]
        refused += _is_refused(_damaged(data, rng), kind)
    assert refused > 5  # the damage does damage


@pytest.mark.parametrize("seed", range(5))
def test_changed_declarations_are_read_or_refused(seed: int) -> None:
    load_object(textured_quad().glb())
    rng = np.random.default_rng(100 + seed)
    refused = 0
    for _ in range(30):
        file = textured_quad()
        file.glb()
        for _ in range(int(rng.integers(1, 4))):
            _changed(file.tree, rng)
        refused += _is_refused(packed(json.dumps(file.tree).encode(), bytes(file.content)), None)
    assert refused > 5


BMP = (
    "data:image/bmp;base64,"
    + base64.b64encode(cv2.imencode(".bmp", np.zeros((2, 2, 3), np.uint8))[1].tobytes()).decode()
)


@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("textures", [], "texture 0 of 0 does not exist"),
        ("textures", [{}], "texture 0 has no image"),
        ("textures", [{"source": 99}], "texture 0 has no image"),
        ("textures", [{"extensions": {"MSFT_texture_dds": {"source": 0}}}], "texture 0 has no image"),
        ("images", [{"bufferView": 99}], "images.0: bufferViews.99 of "),
        ("images", [{"uri": "textures/a.png"}], "images.0 is at 'textures/a.png', outside the file"),
        ("images", [{"uri": "file:///a.png"}], "images.0 is at 'file:///a.png'"),
        ("images", [{"uri": BMP}], "images.0 is neither PNG, JPEG"),
    ],
)
def test_a_texture_that_cannot_be_read_is_noted(part: str, change: list[dict], message: str) -> None:
    file = GltfFile().quad(
        pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.25, 1, 1]},
        emissiveTexture={"index": 0},
        emissiveFactor=[1, 1, 1],
    )
    file.image(np.zeros((2, 2, 3), np.uint8))
    file.tree[part] = change
    one = load_object(file.glb())
    ((_, material),) = one.parts
    assert material.base_colour_texture is None
    assert material.base_colour == pytest.approx((0.5, 0.25, 1))
    assert material.emissive == (0, 0, 0)
    told = {note.effect: note.left_out for note in one.notes if note.effect != "it is not read"}
    assert told.keys() == {"the factor alone is used", "it does not glow"}
    assert all(message in text for text in told.values())
