"""Kept frames on disk: a base, written once, and what has changed since, written with each snapshot.

The base of a kept frame is its camera, depth and image as the sensor measured them. It is stored as pixels
(`base_arrays`), or made again from the frame as it was pushed (`base_of_frame`), for example from the message of a
client. A session changes only pixels that were clipped, and the brightness of the whole where exposure drifts: the
change is their present values, and a gain. A checksum of the texture holds all together, so that a restored frame has
the same bits or is refused.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.engine.models.interface import Arrays
from roomlight.engine.options import SessionOptions
from roomlight.engine.preparation import at_working_size
from roomlight.engine.state.snapshot import KeptFrame
from roomlight.engine.surface.drift import Gain, with_gain
from roomlight.engine.surface.mesh import FrameMesh, MeshGrid
from roomlight.engine.surface.texture import Texture
from roomlight.errors import StateError
from roomlight.frame import Frame


def base_of_frame(frame: Frame, options: SessionOptions) -> FrameMesh:
    """Make the base from a frame as it was pushed to a session with these options."""
    measured, depth_m = at_working_size(frame, options.unknown_depth)
    mesh = FrameMesh(replace(measured, depth_m=depth_m), sensor_depth_m=measured.depth_m)
    mesh.texture = Texture(measured.image)
    return mesh


def brightened(base: FrameMesh, gain: Gain | None) -> FrameMesh:
    """Return the base with the gain that its frame had against drift, as `Drift.corrected` applies it."""
    if gain is not None:
        base.texture = Texture(with_gain(base.texture.image, gain))
        base.gain = gain
    return base


def base_values(mesh: FrameMesh) -> dict[str, Any]:
    """Return the camera of a base and the size of its depth image, as plain JSON values."""
    k = mesh.image_camera
    return {
        "intrinsics": [float(k.fx), float(k.fy), float(k.cx), float(k.cy), int(k.width), int(k.height)],
        "camera_to_world": mesh.camera_to_world.tolist(),
        "depth_shape": list(mesh.grid.depth_shape),
    }


def base_arrays(kept: KeptFrame) -> Arrays:
    """Return the pixels of a base: image, depth, where it was measured, and the clipped pixels if there are any."""
    grid, clipped = kept.mesh.grid, kept.mesh.sensor_clipped
    arrays: Arrays = {"image": kept.texture.image, "depth_m": grid.depth_m, "measured": grid.measured}
    return arrays if clipped is None else arrays | {"sensor_clipped": clipped}


def base_of(values: dict[str, Any], arrays: Arrays) -> FrameMesh:
    """Make the base from `base_values` and `base_arrays`."""
    fx, fy, cx, cy, width, height = values["intrinsics"]
    rows, columns = values["depth_shape"]
    return FrameMesh.of_grid(
        Texture(arrays["image"]),
        Intrinsics(fx, fy, cx, cy, width, height),
        np.array(values["camera_to_world"], np.float64),
        MeshGrid(arrays["depth_m"], arrays["measured"], (rows, columns)),
        sensor_clipped=arrays.get("sensor_clipped"),
    )


def change_arrays(kept: KeptFrame) -> Arrays:
    """Return the present values of the pixels that were clipped; nothing if there are none."""
    where, texture = kept.mesh.sensor_clipped, kept.texture
    if where is None:
        return {}
    arrays: Arrays = {"changed": texture.image[where]}
    if texture.clipped is not None and texture.guessed is not None:
        arrays |= {"clipped": texture.clipped[where], "guessed": texture.guessed[where]}
    return arrays


def changed(base: FrameMesh, arrays: Arrays, checksum: int, source: str) -> FrameMesh:
    """Return the base with the values of `change_arrays` in its texture.

    Raises:
        StateError: The texture has another checksum than when it was saved.
    """
    where, image = base.sensor_clipped, base.texture.image
    values = arrays.get("changed")
    fits = where is None if values is None else where is not None and len(values) == int(where.sum())
    if fits and where is not None and values is not None:
        image = image.copy()
        image[where] = values
        base.texture = Texture(image)
        if "clipped" in arrays:
            clipped, guessed = np.zeros(where.shape, bool), np.zeros(where.shape, np.float32)
            clipped[where], guessed[where] = arrays["clipped"], arrays["guessed"]
            base.texture = Texture(image, clipped, guessed)
    if not fits or base.texture.checksum != checksum:
        raise StateError(f"{source}: its pixels differ from those of the session that was saved")
    return base
