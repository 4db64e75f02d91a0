"""Run the comparison of composites with the truth over numbered scenes; finished scenes are kept and not repeated."""

import hashlib
import pickle
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float

from roomlight.compositing.picture.camera_match import add_noise, measure_camera
from roomlight.conventions import linear_to_srgb, linear_to_srgb8
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graphs import PARTS, LightingGraphs, part_folder
from roomlight.engine.session import Session, SessionOptions
from roomlight.errors import OutputError, SceneError
from roomlight.files import check_writable, write_atomic
from roomlight_evaluation.composites.methods import HARMONICS, OURS, TRUE_LIGHT, composites
from roomlight_evaluation.composites.regions import SHADOW, darker_part
from roomlight_evaluation.composites.scenes import CompositeScene, scene_for, scenes_digest
from roomlight_evaluation.composites.scores import (
    CompositeScores,
    SceneScore,
    darkening_of,
    errors_of,
    read_lines,
    write_lines,
)

Picture = Float[np.ndarray, "h w 3"]
_ROOMS_IN_A_ROW: Final = 20
"""So many rooms without a scene are no chance: one of a few has no place for the object."""


def evaluate_composites(
    count: int,
    out: Path,
    *,
    seed: int = 0,
    options: SessionOptions | None = None,
    keep: Path | None = None,
    pictures: Path | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> CompositeScores:
    """Score `count` scenes; results are kept in `out`, a file of JSON lines, and scenes in it are not repeated.

    Args:
        count: Scenes. A room without a place for the object is replaced by the next room.
        keep: A folder for the rendered scenes: those in it are not rendered again, so that several models are scored
            on the same scenes.
        pictures: A folder for a PNG of each new scene: truth, ours, true panorama, SH + directional.
        progress: Called as (scenes done, scenes in all, what was done) after each room.

    Raises:
        OutputError: `out` has scores of other settings, weights, furniture or of another generator, or is damaged; it,
            `keep` or `pictures` cannot be written.
        SceneError: `_ROOMS_IN_A_ROW` rooms one after the other give no scene.
        ModelError: The weights cannot be used.
    """
    for path in (out, *(folder / "scene" for folder in (keep, pictures) if folder is not None)):
        check_writable(path)
    options = options or SessionOptions()
    graphs = choose_graphs(options)
    done, settings = read_lines(out), settings_of(options, seed, graphs)
    for scene in done:
        if scene.settings != settings:
            raise OutputError(f"{out}: has scores of {scene.settings}, not of {settings}; use another file")
    number = 1 + max((scene.number for scene in done), default=-1)
    failed = 0
    while len(done) < count:
        try:
            scene = kept_scene(keep, number, seed=seed)
            score = replace(_score(number, scene, scene.session(options, graphs), pictures), settings=settings)
        except SceneError as error:
            note, failed = f"room {number}: {error}", failed + 1
            if failed == _ROOMS_IN_A_ROW:
                raise SceneError(f"{failed} rooms one after the other give no scene; the last: {error}") from error
        else:
            failed = 0
            done.append(score)
            write_lines(out, done)
            note = f"{score.room}: {score.material} {score.shape}"
        number += 1
        if progress is not None:
            progress(len(done), count, note)
    return CompositeScores(tuple(done[:count]))


def settings_of(options: SessionOptions, seed: int, graphs: LightingGraphs | None) -> str:
    """Return what the scores of a file have in common, in words: the options, and the content of what they name."""
    files = [file for name in PARTS for file in sorted(part_folder(options.parts, name).iterdir())]
    networks = [file.read_bytes() for file in files if file.suffix in (".onnx", ".npz")]
    parts = hashlib.sha256(b"".join(networks)).hexdigest()
    weights = "none" if graphs is None else graphs.digest
    scenes = scenes_digest()
    return f"seed {seed} and {options} with weights {weights[:12]}, parts {parts[:12]} and scenes {scenes[:12]}"


def kept_scene(folder: Path | None, number: int, *, seed: int) -> CompositeScene:
    """Read the rendered scene of this number from a folder, or render it and keep it there; None: render it.

    Scenes of another generator or furniture do not count.

    Raises:
        SceneError: as `scene_for`.
        OutputError: A file of the folder is damaged, or cannot be written.
    """
    if folder is None:
        return scene_for(number, seed=seed)
    path = folder / f"scene-{seed}-{number:03d}-{scenes_digest()[:12]}.pickle"
    if path.is_file():
        try:
            return pickle.loads(zlib.decompress(path.read_bytes()))
        except Exception as error:  # what a pickle raises depends on where it is damaged
            raise OutputError(f"{path}: is damaged ({error}); remove it, and the scene is rendered again") from error
    scene = scene_for(number, seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(path, zlib.compress(pickle.dumps(scene), level=1))
    return scene


def _score(number: int, scene: CompositeScene, session: Session, pictures: Path | None) -> SceneScore:
    """Compare the composites of a scene with its truth."""
    images = composites(scene, session)
    if pictures is not None:
        write_scene_picture(pictures / f"{number:03d}-{scene.material}-{scene.shape}.png", scene, images)
    clean, without = scene.clean
    masks = scene.masks
    darker = darker_part(clean, without, scene.covered, masks[SHADOW])
    before = np.clip(scene.frame.image, 0, 1)
    return SceneScore(
        number=number,
        room=scene.name,
        shape=scene.shape,
        material=scene.material,
        pixels={region: int(mask.sum()) for region, mask in masks.items()},
        errors={method: errors_of(image, scene.truth, masks) for method, image in images.items()},
        darkening={
            "truth": darkening_of(scene.truth, before, darker),
            **{method: darkening_of(np.clip(image, 0, 1), before, darker) for method, image in images.items()},
        },
        shift_m=scene.shift_m,
    )


def write_scene_picture(path: Path, scene: CompositeScene, images: dict[str, Picture]) -> None:
    """Write truth, ours, the true panorama's and SH + directional side by side, twice enlarged, with the frame's grain
    on all objects, as `Composite.image` has it: without, the true one would be told by it."""
    camera = measure_camera(linear_to_srgb(scene.frame.image).astype(np.float32))
    alpha, index = scene.covered.astype(np.float32), scene.frame.index
    made: Sequence[Picture] = [
        add_noise(linear_to_srgb(images[method]), alpha, camera, frame_index=index)
        for method in (OURS, TRUE_LIGHT, HARMONICS)
    ]
    columns = [linear_to_srgb8(np.clip(scene.truth, 0, 1)), *(np.rint(255 * image).astype(np.uint8) for image in made)]
    row = np.concatenate(columns, axis=1)
    large = cv2.resize(row, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    _, encoded = cv2.imencode(".png", large[..., ::-1])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, encoded.tobytes())
