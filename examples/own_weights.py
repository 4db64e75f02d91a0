"""Run a session on a folder of exported weights, beside the classical model.

    roomlight export runs/my-run/model.pt --out my-model      # your training: docs/training.md
    python examples/own_weights.py [MODEL] [--frames N] [--out FOLDER]

MODEL is a folder written by `roomlight export`, by default the weights that come with the package. Output:
FOLDER/model.exr and FOLDER/classical.exr, the light of both models at the same point, and their difference (log-L2).
"""

import argparse
from pathlib import Path

import roomlight as rl
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.metrics import log_l2


def light_with(options: rl.SessionOptions, frames: int) -> rl.Light:
    """Light the sample room in front of its first camera."""
    session = rl.Session(options)
    position = None
    for frame in rl.open_capture(rl.sample_capture(), rl.CaptureOptions(max_frames=frames)):
        position = position or rl.point_in_view(frame)
        session.push(frame)
    assert position is not None  # the sample room has frames
    return session.light_at(position)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("model", type=Path, nargs="?", default=SHIPPED / "single")
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path("out/own_weights"))
    args = parser.parse_args()

    network = light_with(rl.SessionOptions(weights=args.model), args.frames)
    classical = light_with(rl.SessionOptions(model="classical"), args.frames)
    network.save(args.out / "model.exr")
    classical.save(args.out / "classical.exr")
    print(f"{args.out}: log-L2 between the two models {log_l2(network.panorama, classical.panorama):.3f}")


if __name__ == "__main__":
    main()
