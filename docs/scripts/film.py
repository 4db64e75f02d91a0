"""Put objects into the room of `film_room.py`: the film of docs/index.md and the picture of README.md.

`film.sh` runs it: python film.py ROOM IMAGES [final]
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

import roomlight as rl
from roomlight.compositing.picture.layers import encode_srgb8
from roomlight.imaging.video_writer import VideoWriter

SCENE = Path(__file__).with_name("film-scene.json")
STILLS = 20, 56
GAP_PX = 8


def main(room: Path, images: Path, quality: str) -> None:
    """Write film.mp4, its first frame and composite.jpg to the folder `images`."""
    rows: list[UInt8[np.ndarray, "h w 3"]] = []
    capture = rl.open_capture(room)
    with VideoWriter(images / "film.mp4", frames_per_second=capture.frames_per_second or 8, crf=27) as film:
        for number, picture in enumerate(rl.composite_capture(room, rl.load_scene(SCENE), quality=quality)):
            film.write(picture.image)
            if number == 0:
                _write(images / "film.jpg", picture.image, 80)
            if number in STILLS:
                pair = encode_srgb8(picture.frame.image), picture.image
                rows.append(np.hstack([pair[0], np.full((len(pair[0]), GAP_PX, 3), 255, np.uint8), pair[1]]))
    gap = np.full((GAP_PX, rows[0].shape[1], 3), 255, np.uint8)
    _write(images / "composite.jpg", np.vstack([rows[0], gap, *rows[1:]]), 85)


def _write(path: Path, image: UInt8[np.ndarray, "h w 3"], quality: int) -> None:
    cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *(sys.argv[3:] or ["good"]))
