"""curl sends the files of a capture to a server and gets the same light as an offline replay of that capture."""

import json
import subprocess

import numpy as np
import pytest

from http_servers import RunningServer
from roomlight.captures import CaptureOptions
from roomlight.engine.session import SessionOptions
from roomlight.sample import sample_capture
from roomlight.wire.frame_message import column_major
from roomlight_cli.replays.replay import ReplayOptions, replay

SAMPLE = sample_capture()
INDEX = json.loads((SAMPLE / "capture.json").read_text())
PROBE = tuple(INDEX["probes"][0]["position"])
EVERY, FRAMES, HEIGHT = 5, 4, 32


def curl(*arguments):
    """Run curl and return the body of the response."""
    command = ["curl", "--silent", "--show-error", "--fail-with-body", "--max-time", "60", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, check=False, timeout=90)
    assert done.returncode == 0, done.stdout.decode(errors="replace")[-2000:] + done.stderr.decode()
    return done.stdout


def send(address, number):
    """Send a frame of the sample; the header needs no lengths."""
    entry = INDEX["frames"][number]
    header = {
        "colour": {"encoding": "jpeg"},
        "depth": {"format": "uint16_mm", "encoding": "png", "width": 320, "height": 240},
        "intrinsics": entry["intrinsics"],
        "camera_to_world": column_major(np.array(entry["camera_to_world"])),
        "timestamp_s": entry["timestamp_s"],
        "exposure": entry["exposure"],
    }
    colour, depth = f"colour=@{SAMPLE / entry['colour']}", f"depth=@{SAMPLE / entry['depth']}"
    target = f"{address}/frames/{number}"
    answer = curl("-X", "PUT", target, "-F", f"header={json.dumps(header)}", "-F", colour, "-F", depth)
    assert json.loads(answer)["status"] == "processed"


@pytest.mark.slow
@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("model", ["classical", "video"])
def test_curl_gets_the_light_of_an_offline_replay(model, tiny_video, tmp_path):
    weights = {} if model == "classical" else {"weights": tiny_video[1]}
    options = ReplayOptions(
        CaptureOptions(every=EVERY, max_frames=FRAMES),
        session=SessionOptions(model=model, height=HEIGHT, **weights),
        probes=(PROBE,),
    )
    replay(SAMPLE, tmp_path / "offline", options)
    offline = {int(path.stem): path.read_bytes() for path in (tmp_path / "offline/probe-00").glob("*.exr")}
    assert sorted(offline) == list(range(0, EVERY * FRAMES, EVERY))
    with RunningServer(model=model, **weights) as server:
        address = f"http://127.0.0.1:{server.port}/v1/sessions/room"
        json_type = ("-H", "Content-Type: application/json")
        wanted = json.dumps({"height": HEIGHT, "reference_exposure": 1.0})
        assert json.loads(curl("-X", "PUT", address, *json_type, "-d", wanted))["model"] == model
        curl("-X", "PUT", f"{address}/probes/table", *json_type, "-d", json.dumps({"position": PROBE}))
        for number, panorama in sorted(offline.items()):
            send(address, number)
            assert curl(f"{address}/probes/table?format=exr") == panorama
        curl("-X", "DELETE", address)
