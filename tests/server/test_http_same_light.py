"""Light over a socket equals that of the engine bit-exactly: a capture, classical model and networks."""

import io
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from http_servers import RunningServer
from roomlight.captures import CaptureOptions, open_capture
from roomlight.engine.session import Session, SessionOptions
from roomlight.images import write_exr
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import column_major, pack

SAMPLE = Path(str(files("roomlight") / "data" / "sample"))
INDEX = json.loads((SAMPLE / "capture.json").read_text())
PROBES = [tuple(probe["position"]) for probe in INDEX["probes"][:2]]
EVERY, FRAMES = 4, 4


def messages():
    """Yield the files of the sample as frame messages: JPEG and PNG as on disk."""
    for number in range(0, EVERY * FRAMES, EVERY):
        entry = INDEX["frames"][number]
        colour, depth = ((SAMPLE / entry[part]).read_bytes() for part in ("colour", "depth"))
        size = dict(zip(("width", "height"), _png_size(depth), strict=True))
        header = {
            "colour": {"encoding": "jpeg", "bytes": len(colour)},
            "depth": {"format": "uint16_mm", "encoding": "png", "bytes": len(depth), **size},
            "intrinsics": entry["intrinsics"],
            "camera_to_world": column_major(np.array(entry["camera_to_world"])),
            "exposure": entry.get("exposure", 1.0),
        }
        yield number, pack(FrameHeader.model_validate_json(json.dumps(header)), colour, depth)


def _png_size(data):
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def exact_messages():
    """Yield the decoded frames as lossless messages, like a replay over the network."""
    for shot in open_capture(SAMPLE, CaptureOptions(every=EVERY, max_frames=FRAMES)):
        height, width = shot.image.shape[:2]
        colour = shot.image.astype("<f4").tobytes() + shot.clipped.astype(np.uint8).tobytes()
        depth = shot.depth_m.astype("<f4").tobytes()
        k = shot.intrinsics
        header = {
            "colour": {"encoding": "linear_f32", "bytes": len(colour)},
            "depth": {
                "format": "float32_m", "width": shot.depth_m.shape[1], "height": shot.depth_m.shape[0],
                "bytes": len(depth),
            },
            "intrinsics": {"fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "width": width, "height": height},
            "camera_to_world": column_major(shot.camera_to_world),
        }  # fmt: skip
        yield shot.index, pack(FrameHeader.model_validate_json(json.dumps(header)), colour, depth)


def direct(options):
    """Return the light of the tracked probe after each frame, and of the other probe at the end."""
    session = Session(options)
    handle = session.track(PROBES[0])
    tracked = []
    for shot in open_capture(SAMPLE, CaptureOptions(every=EVERY, max_frames=FRAMES)):
        session.push(shot)
        tracked.append(session.light(handle))
    return tracked, session.light_at(PROBES[1])


def compare(server, model, bodies, expected, tmp_path):
    tracked, late = expected
    height = tracked[0].panorama.shape[0]
    server.open("room", {"model": model, "height": height, "reference_exposure": 1.0})
    server.call("PUT", "/v1/sessions/room/probes/table", {"position": PROBES[0]})
    for (index, body), light in zip(bodies, tracked, strict=True):
        assert server.push(index, body).json["status"] == "processed"
        answer = server.call("GET", "/v1/sessions/room/probes/table?format=npy")
        assert np.load(io.BytesIO(answer.body)).tobytes() == light.panorama.tobytes()
        assert server.state()["coverage"]["table"] == round(light.coverage, 4)
    x, y, z = PROBES[1]
    exr = server.call("GET", f"/v1/sessions/room/probe?x={x}&y={y}&z={z}&format=exr").body
    write_exr(
        tmp_path / "late.exr",
        late.panorama,
        metadata={"roomlight:coverage": f"{late.coverage:.4f}", "roomlight:use": "lighting"},
    )
    assert exr == (tmp_path / "late.exr").read_bytes()


@pytest.mark.parametrize("bodies", [messages, exact_messages])
def test_classical_light_equals_the_engine_bit_exactly(tmp_path, bodies):
    expected = direct(SessionOptions(model="classical", height=48))
    with RunningServer() as server:
        compare(server, "classical", bodies(), expected, tmp_path)


@pytest.mark.slow
def test_network_light_equals_the_engine_bit_exactly(tmp_path, tiny_video):
    weights = tiny_video[1]
    expected = direct(SessionOptions(model="video", weights=weights, height=32))
    with RunningServer(model="video", weights=weights) as server:
        compare(server, "auto", messages(), expected, tmp_path)
        assert server.state()["model"] == "video"
