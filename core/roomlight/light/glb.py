"""glTF: light as a GLB file, an image-based light (EXT_lights_image_based) and lights (KHR_lights_punctual).

The image-based light is the room without its lamps and windows, so that all together shed the room's light and nothing
counts twice. Its specular images are the levels of `prefilter`, evenly over roughness, and its nine coefficients are
of irradiance. Images are PNGs in RGBD: radiance = RGB ^ 2.2 / alpha, up to 255; a brighter room is scaled by the
light's `intensity`.

The extension does not say where its axes lie in the scene. Babylon.js, which renders it, shows glTF's x mirrored in its
left-handed world, as three.js does in its cube maps: faces are those of OpenGL with +X and -X swapped and each flipped
left to right, and coefficients are in these mirrored axes. The extension also has each image flipped against OpenGL's
rows, and Babylon.js turns them back.

A directional light shines along its node's -z; its intensity in lux is the irradiance on a surface that faces it, in
the unit of radiance x steradian.
"""

import json
import struct
from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight import __version__
from roomlight.errors import OutputError
from roomlight.light.cube import DEFAULT_SIZE, CubeMap
from roomlight.light.main_light import MainLight, without_lights
from roomlight.light.prefilter import prefilter
from roomlight.light.spherical_harmonics import project

_LARGEST: Final = 255.0
"""The brightest radiance of RGBD in 8 bits: alpha is at least 1/255."""
_GAMMA: Final = 2.2
_IMAGE_BASED: Final = "EXT_lights_image_based"
_PUNCTUAL: Final = "KHR_lights_punctual"
_MIRROR: Final = np.array([1, 1, 1, -1, -1, 1, 1, -1, 1], np.float64)
"""Signs of harmonics whose x points the other way: C11, C2-2 and C21 are odd in x."""
_MIRRORED_FACES: Final = (1, 0, 2, 3, 4, 5)


def to_glb(panorama: Float[np.ndarray, "h w 3"], lights: Sequence[MainLight], *, size: int | None = None) -> bytes:
    """Encode a panorama and its lights.

    Args:
        panorama: linear RGB [H, 2H, 3].
        lights: its lights.
        size: pixels of a cube's face: 16, 32 (default), 64, 128 or 256.

    Raises:
        OptionError: no cube map of this size is made.
    """
    rest, lights = without_lights(panorama, lights)
    mips = prefilter(CubeMap.from_panorama(rest, size=DEFAULT_SIZE if size is None else size))
    scale = max(1.0, max(float(level.faces.max()) for level in mips.levels) / _LARGEST)
    harmonics = project(rest).irradiance().coefficients * _MIRROR[:, None] / scale
    images = [
        _rgbd(level.faces[face, ::-1, ::-1] / np.float32(scale)) for level in mips.levels for face in _MIRRORED_FACES
    ]
    light = {
        "name": "room",
        "intensity": scale,
        "irradianceCoefficients": harmonics.tolist(),
        "specularImageSize": mips.levels[0].size,
        "specularImages": [[6 * level + face for face in range(6)] for level in range(len(mips.levels))],
    }
    scene: dict[str, Any] = {"name": "light", "extensions": {_IMAGE_BASED: {"light": 0}}}
    extensions: dict[str, Any] = {_IMAGE_BASED: {"lights": [light]}}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"RoomLight {__version__}"},
        "scene": 0,
        "scenes": [scene],
        "extensions": extensions,
        "images": [{"bufferView": number, "mimeType": "image/png"} for number in range(len(images))],
    }
    if lights:
        extensions[_PUNCTUAL] = {"lights": [_directional(light) for light in lights]}
        document["nodes"] = [
            {
                "name": f"light {number}",
                "rotation": list(light.quaternion),
                "extensions": {_PUNCTUAL: {"light": number}},
            }
            for number, light in enumerate(lights)
        ]
        scene["nodes"] = list(range(len(lights)))
    document["extensionsUsed"] = sorted(extensions)
    return glb_file(document, images)


def _directional(light: MainLight) -> dict[str, Any]:
    strongest = float(light.intensity.max())
    return {"type": "directional", "color": (light.intensity / strongest).tolist(), "intensity": strongest}


def _rgbd(radiance: Float[np.ndarray, "s s 3"]) -> bytes:
    """Encode up to 255 as PNG: alpha is the largest eighth-bit step at which no channel exceeds 1."""
    brightest = np.maximum(radiance.max(axis=-1, keepdims=True), 1)
    alpha = np.maximum(np.floor(_LARGEST / brightest), 1)
    colour = np.clip(radiance * alpha / _LARGEST, 0, 1) ** (1 / _GAMMA)
    rgba = np.concatenate([np.rint(colour * 255), alpha], axis=-1).astype(np.uint8)
    ok, data = cv2.imencode(".png", np.ascontiguousarray(rgba[..., [2, 1, 0, 3]]))
    if not ok:
        raise OutputError(f"PNG encoding of {rgba.shape} failed")
    return data.tobytes()


def glb_file(document: dict[str, Any], parts: list[bytes]) -> bytes:
    """Return a GLB file whose buffer views are these parts, in order."""
    body = b""
    views: list[dict[str, int]] = []
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(part)})
        body += part + bytes(-len(part) % 4)
    document |= {"bufferViews": views, "buffers": [{"byteLength": len(body)}]}
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(body))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
