"""Light many recordings and collect the results in one table.

    python examples/batch_of_recordings.py [CAPTURE ...] [--frames N] [--out FOLDER]

Every recording gets a session of its own, and is lit in front of its first camera after its last frame. Output:
FOLDER/<recording>.exr, numbered where recordings have one name, and FOLDER/lights.csv with the file, the coverage, the
main light and the number of skipped frames. A recording that cannot be read is reported, and the others continue.
"""

import argparse
import csv
import sys
from itertools import chain, count
from pathlib import Path

import roomlight as rl


def light_recording(path: Path, frames: int | None) -> tuple[rl.Light, int]:
    """Return the light after the last frame, and the number of frames that were skipped as unusable."""
    session = rl.Session()
    capture = rl.open_capture(path, rl.CaptureOptions(max_frames=frames))
    position = None
    for frame in capture:
        position = position or rl.point_in_view(frame)
        session.push(frame)
    assert position is not None  # a capture without a usable frame raises CaptureError
    return session.light_at(position), len(capture.skipped)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("captures", type=Path, nargs="*", default=[rl.sample_capture()])
    parser.add_argument("--frames", type=int, help="at most this many frames of each")
    parser.add_argument("--out", type=Path, default=Path("out/batch_of_recordings"))
    args = parser.parse_args()

    args.out.mkdir(parents=True, exist_ok=True)
    failures = 0
    with (args.out / "lights.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["recording", "file", "coverage", "direction_x", "direction_y", "direction_z", "skipped"])
        names: set[str] = set()
        for path in args.captures:
            base = path.stem if path.is_file() else path.resolve().name
            numbered = (f"{base}-{number}" for number in count(2))
            name = next(name for name in chain([base], numbered) if name not in names)
            names.add(name)
            try:
                light, skipped = light_recording(path, args.frames)
            except rl.RoomLightError as error:
                print(f"error: {error}", file=sys.stderr)
                failures += 1
                continue
            light.save(args.out / f"{name}.exr")
            table.writerow(
                [path, f"{name}.exr", f"{light.coverage:.3f}", *light.main_light.direction.round(4), skipped]
            )
            print(f"{path}: {light.coverage:.0%} of the directions observed")
    sys.exit(failures > 0)


if __name__ == "__main__":
    main()
