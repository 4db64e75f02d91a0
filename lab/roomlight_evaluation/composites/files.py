"""Rendered scenes of the comparison of composites with the truth, kept in files: a scene takes a minute to render.

A scene is `scene-<seed>-<number>.npz` in a folder. A scene for which no room was found is not kept.
"""

from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.compositing.placement.scene import AtPixel, Scene, SceneObject
from roomlight.errors import OutputError
from roomlight.files import write_atomic
from roomlight.frame import Frame
from roomlight_evaluation.composites.scenes import NAME, CompositeScene, scene_for, virtual_object

_TEXT = ("name", "shape", "material")
_ARRAYS = ("truth", "covered", "true_light")


def kept_scene(folder: Path | None, number: int, *, seed: int) -> CompositeScene:
    """Read the scene of this number from a folder, or render it and keep it there; None: render it.

    Raises:
        SceneError: as `scene_for`.
        OutputError: A file of the folder is damaged, or cannot be written.
    """
    if folder is None:
        return scene_for(number, seed=seed)
    path = folder / f"scene-{seed}-{number:03d}.npz"
    if path.is_file():
        try:
            return read_scene(path)
        except (BadZipFile, EOFError, KeyError, OSError, ValueError) as error:
            raise OutputError(f"{path}: is damaged ({error}); remove it, and the scene is rendered again") from error
    scene = scene_for(number, seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    write_scene(path, scene)
    return scene


def write_scene(path: Path, scene: CompositeScene) -> None:
    """Write a scene whose object was placed by a pixel.

    Raises:
        OutputError: The file cannot be written.
    """
    place, lens = scene.objects.objects[0].place, scene.frame.intrinsics
    assert isinstance(place, AtPixel)
    file = BytesIO()
    arrays: dict[str, Any] = {
        **{name: getattr(scene, name) for name in (*_TEXT, *_ARRAYS)},
        **{f"mask-{region}": mask for region, mask in scene.masks.items()},
        "with": scene.clean[0],
        "without": scene.clean[1],
        "position": scene.position,
        "pixel": (place.u, place.v),
        "shown": [frame is scene.frame for frame in scene.frames].index(True),
        "shift_m": scene.shift_m,
        "lens": (lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height),
        "images": np.stack([frame.image for frame in scene.frames]),
        "clipped": np.stack([frame.clipped for frame in scene.frames]),
        "depth_m": np.stack([frame.depth_m for frame in scene.frames]),
        "poses": np.stack([frame.camera_to_world for frame in scene.frames]),
        "timestamps_s": [frame.timestamp_s for frame in scene.frames],
    }
    np.savez_compressed(file, **arrays)
    write_atomic(path, file.getvalue())


def read_scene(path: Path) -> CompositeScene:
    """Read what `write_scene` wrote."""
    with np.load(BytesIO(path.read_bytes())) as archive:
        data = {name: archive[name] for name in archive.files}
    fx, fy, cx, cy, width, height = data["lens"].tolist()
    lens = Intrinsics(fx, fy, cx, cy, int(width), int(height))
    columns = zip(data["images"], data["clipped"], data["depth_m"], data["poses"], data["timestamps_s"], strict=True)
    name, shape, material = (str(data[key]) for key in _TEXT)
    frames = tuple(
        Frame(number, image, clipped, depth_m, lens, pose, timestamp_s=float(seconds), source=name)
        for number, (image, clipped, depth_m, pose, seconds) in enumerate(columns)
    )
    u, v = data["pixel"].tolist()
    x, y, z = data["position"].tolist()
    archive = SceneObject(NAME, virtual_object(shape, material), AtPixel(u, v))
    masks = {key.removeprefix("mask-"): array for key, array in data.items() if key.startswith("mask-")}
    return CompositeScene(
        name=name,
        shape=shape,
        material=material,
        frame=frames[int(data["shown"])],
        objects=Scene((archive,)),
        position=(x, y, z),
        clean=(data["with"], data["without"]),
        masks=masks,
        frames=frames,
        shift_m=float(data["shift_m"]),
        **{key: data[key] for key in _ARRAYS},
    )
