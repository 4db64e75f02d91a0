"""Stream a capture to a RoomLight server and fetch the light after each frame.

    roomlight serve                                       # in another terminal
    python examples/stream_to_server.py [CAPTURE] [--server URL] [--token TOKEN] [--frames N] [--out FOLDER]

Needs only the client on this machine: frames are sent as JPEG with depth, the engine runs on the server. Output: the
main light after each frame as text, and the last panorama as FOLDER/light.exr.
"""

import argparse
from pathlib import Path

import roomlight as rl
from roomlight_client import Client


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("capture", type=Path, nargs="?", default=rl.sample_capture())
    parser.add_argument("--server", default="http://localhost:8090")
    parser.add_argument("--token", help="bearer token, if the server asks for one")
    parser.add_argument("--frames", type=int, help="at most this many frames")
    parser.add_argument("--out", type=Path, default=Path("out/stream_to_server"))
    args = parser.parse_args()

    frames = rl.open_capture(args.capture, rl.CaptureOptions(max_frames=args.frames))
    with Client(args.server, token=args.token) as client, client.open() as session:
        for number, frame in enumerate(frames):
            if number == 0:
                session.track("table", rl.point_in_view(frame))
            session.push(frame, colour="jpeg")
            light = session.light_at("table", ["main_light", "sh"])  # 1 kB: what an application shades with
            x, y, z = light.main_light.direction
            print(f"frame {frame.index}: {light.coverage:.0%} observed, main light from ({x:.2f}, {y:.2f}, {z:.2f})")
        session.light_at("table", ["exr"]).save(args.out / "light.exr")
    print(args.out / "light.exr")


if __name__ == "__main__":
    main()
