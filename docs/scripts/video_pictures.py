"""Draw docs/images/video-*: what the recurrent networks know after 1, 8, 16 and 31 frames, a mirror sphere that moves
through the room, and a film of the light.

    roomlight dataset generate --split test --sequences 4 --out test-walks
    python docs/scripts/video_pictures.py test-walks [--walk 0] [--weights FOLDER]     two minutes on two cores

Rooms lit by real panoramas are refused: the pictures of the documentation show generated rooms alone.
"""

from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from roomlight.camera import Intrinsics, transform_points
from roomlight.conventions import Position, linear_to_srgb8, srgb8_to_linear
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from roomlight.engine.session import Session, SessionOptions
from roomlight.frame import Frame
from roomlight.imaging.drawing import HEADING, LABEL_ROWS, Canvas, text_width
from roomlight.metrics import log_l2, smoothness
from roomlight.spheres import SphereRenderer, view_toward
from roomlight_evaluation.captures.estimators import EngineEstimator
from roomlight_evaluation.walks import FrameAlone, WalkModels, walk_frames

IMAGES = Path(__file__).parents[1] / "images"
FRAMES = (1, 8, 16, 31)
"""Frames, counted from 1, of the still picture."""
PANORAMA = (288, 144)
FRAME = (192, 144)
GAP = 6
FILM_MS = 160
FILM_PANORAMA = (400, 200)
SPHERE_STEPS = 20
SPHERE_MS = 120
SPHERE_SHARE = 0.24
"""A sphere's diameter as a share of its distance."""
SPHERE_COLUMNS = 480

Panorama = np.ndarray


@dataclass(frozen=True)
class Streamed:
    """One walk, streamed to every method: panoramas [h, 2h, 3] by method, a frame each."""

    recording: Recording
    frames: list[Frame]
    truth: Panorama
    panoramas: dict[str, list[Panorama]]
    session: Session


def main() -> None:
    """Write the three pictures."""
    parser = ArgumentParser(description="Draw docs/images/video-*.")
    parser.add_argument("dataset", type=Path, help="walks of 31 frames through test rooms of the generator")
    parser.add_argument("--walk", type=int, default=0)
    parser.add_argument("--probe", type=int, default=0)
    parser.add_argument("--weights", type=Path, default=None, help="default: the shipped ones")
    parser.add_argument("--out", type=Path, default=IMAGES)
    given = parser.parse_args()
    recording = Dataset(given.dataset, "test")[given.walk]
    if "panorama" in recording.facts:
        raise SystemExit(f"{recording.name}: this room is lit by a real panorama; give generated rooms")
    models = WalkModels.load(SessionOptions(model="video", weights=given.weights))
    streamed = stream(recording, models, given.probe)
    draw_progress(streamed).save(given.out / "video-panoramas.jpg", quality=86)
    save_film(given.out / "video-film.webp", draw_film(streamed), FILM_MS)
    save_film(given.out / "video-sphere.webp", draw_sphere(streamed), SPHERE_MS)


def stream(recording: Recording, models: WalkModels, probe: int) -> Streamed:
    """Stream the walk to every method."""
    x, y, z = (float(value) for value in recording.probe_positions[probe])
    truth = recording.probe_panoramas[probe].astype(np.float32) * np.float32(recording.exposure[0])
    session = Session(models.video, graphs=models.video_graphs)
    handle = session.track((x, y, z))
    others = {
        "each frame alone": FrameAlone(models.single, models.single_graphs),
        "classical": EngineEstimator(SessionOptions(model="classical"), None),
    }
    panoramas: dict[str, list[Panorama]] = {"video": [], **{name: [] for name in others}}
    frames = list(walk_frames(recording, "exact"))
    for frame in frames:
        session.push(frame)
        panoramas["video"].append(session.light(handle).panorama)
        for name, estimator in others.items():
            estimator.push(frame)
            panoramas[name].append(estimator.light_at((x, y, z)))
    return Streamed(recording, frames, truth, panoramas, session)


def draw_progress(streamed: Streamed) -> Image.Image:
    """Draw a row per shown frame: the frame, the panorama of every method, and the truth."""
    names = list(streamed.panoramas)
    height = LABEL_ROWS + len(FRAMES) * (PANORAMA[1] + GAP)
    width = FRAME[0] + (len(names) + 1) * (PANORAMA[0] + GAP)
    canvas = Canvas(width + 2 * GAP, height + GAP)
    lefts = [GAP + FRAME[0] + GAP + column * (PANORAMA[0] + GAP) for column in range(len(names) + 1)]
    for left, title in zip([GAP, *lefts], ["frame", *names, "truth"], strict=True):
        canvas.text((left, 4), title, grey=HEADING)
    for row, number in enumerate(FRAMES):
        top = LABEL_ROWS + GAP + row * (PANORAMA[1] + GAP)
        canvas.picture((GAP, top), streamed.frames[number - 1].image, size=FRAME)
        draw_label(canvas, (GAP, top), str(number))
        for left, name in zip(lefts, names, strict=False):
            panorama = streamed.panoramas[name][number - 1]
            canvas.picture((left, top), panorama, size=PANORAMA)
            draw_label(canvas, (left, top), f"log-L2 {10 * log_l2(panorama, streamed.truth):.2f}")
        canvas.picture((lefts[-1], top), streamed.truth, size=PANORAMA)
    return Image.fromarray(canvas.image)


def draw_label(canvas: Canvas, corner: tuple[int, int], text: str) -> None:
    """Draw a label in a picture's top left corner, on a dark ground that bright pictures do not hide."""
    canvas.box(corner, (text_width(text) + 12, LABEL_ROWS), 0.0, opacity=0.55)
    canvas.text((corner[0] + 6, corner[1] + 4), text, grey=1.0)


def draw_film(streamed: Streamed) -> list[Image.Image]:
    """Draw a picture per frame: the frame and the truth above the panoramas of each frame alone and of video."""
    alone, video = (streamed.panoramas[name] for name in ("each frame alone", "video"))
    rows, (columns, height) = LABEL_ROWS + 4, FILM_PANORAMA
    pictures: list[Image.Image] = []
    for number, frame in enumerate(streamed.frames):
        canvas = Canvas(2 * columns + 3 * GAP, 2 * (height + rows) + GAP)
        frame_columns = height * frame.image.shape[1] // frame.image.shape[0]
        parts = (
            ("frame", frame.image, frame_columns, 0, 0),
            ("truth", streamed.truth, columns, 1, 0),
            ("each frame alone" + _change(alone, number), alone[number], columns, 0, 1),
            ("video" + _change(video, number), video[number], columns, 1, 1),
        )
        for title, image, wide, column, row in parts:
            at = (GAP + column * (columns + GAP), row * (height + rows))
            canvas.text((at[0], at[1] + 4), title, grey=HEADING)
            canvas.picture((at[0], at[1] + rows), image, size=(wide, height))
        pictures.append(Image.fromarray(canvas.image))
    return pictures


def _change(panoramas: list[Panorama], number: int) -> str:
    """Return the mean squared change of log(1 + light) over the frames so far."""
    changes = [1e3 * smoothness(panoramas[k], panoramas[k - 1]) for k in range(1, number + 1)]
    return f": changes {np.mean(changes):.2f} a frame" if changes else ""


def draw_sphere(streamed: Streamed) -> list[Image.Image]:
    """Draw the last frame with a mirror sphere at points of a line, lit at each point by the session."""
    frame = streamed.frames[-1]
    k = frame.intrinsics.resized(SPHERE_COLUMNS, SPHERE_COLUMNS * frame.intrinsics.height // frame.intrinsics.width)
    canvas = Canvas(k.width, k.height)
    canvas.picture((0, 0), frame.image, size=(k.width, k.height))
    plain = srgb8_to_linear(canvas.image)
    there = [_with_sphere(plain, streamed.session, frame, k, pixel) for pixel in sphere_path(frame, k)]
    return there + there[-2:0:-1]


def sphere_path(frame: Frame, k: Intrinsics) -> list[tuple[float, float, float]]:
    """Return (column, row, depth in metres) of the sphere's centres: on a line in front of all surfaces behind it."""
    row, columns = 0.55 * k.height, np.linspace(0.18, 0.82, SPHERE_STEPS) * k.width
    depth = frame.depth_m
    band = depth[int(0.35 * len(depth)) : int(0.75 * len(depth))]
    nearest_m = float(np.percentile(band[band > 0], 2))
    return [(float(column), row, 0.7 * nearest_m) for column in columns]


def _with_sphere(
    plain: Panorama, session: Session, frame: Frame, k: Intrinsics, pixel: tuple[float, float, float]
) -> Image.Image:
    column, row, depth_m = pixel
    local = np.array([[(column - k.cx) / k.fx, -(row - k.cy) / k.fy, -1.0]]) * depth_m
    x, y, z = (float(value) for value in transform_points(frame.camera_to_world, local)[0])
    position: Position = (x, y, z)
    size = 2 * round(SPHERE_SHARE * k.fy / 2)
    sphere = SphereRenderer(view_toward(frame.camera_to_world, position), size=size)
    picture = sphere.render(session.light_at(position).panorama, "mirror")
    image, share = plain.copy(), sphere.coverage[..., None]
    top, left = round(row) - size // 2, round(column) - size // 2
    part = image[top : top + size, left : left + size]
    part += share * (np.minimum(picture, 1) - part)
    return Image.fromarray(linear_to_srgb8(image))


def save_film(path: Path, pictures: list[Image.Image], milliseconds: int) -> None:
    """Write an animated WebP that repeats."""
    first, *rest = pictures
    first.save(path, save_all=True, append_images=rest, duration=milliseconds, quality=60, method=6, loop=0)


if __name__ == "__main__":
    main()
