"""Images that take long to decode, and decoders that die: each costs one frame, over a real socket."""

import json
import os
import signal

import cv2
import numpy as np
import pytest
from slow_images import jpeg_of_scans, png_of_texts

from http_servers import SMALL, RunningServer, box_shot, header_of, parts_of
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import pack
from roomlight_server.work import decode_processes


def colour_frame(encoding, data, width=48, height=36):
    """Return a frame message of the box room with this image file."""
    scale = width / 48
    lens = {"fx": 30.0 * scale, "fy": 30.0 * scale, "cx": width / 2, "cy": height / 2, "width": width, "height": height}
    changes = {"colour": {"encoding": encoding, "bytes": len(data)}, "intrinsics": lens}
    header = FrameHeader.model_validate_json(json.dumps(header_of(box_shot(0)) | changes))
    return pack(header, data, parts_of(box_shot(0))[1])


def jpeg(width=48, height=36):
    noise = np.random.default_rng(5).integers(0, 255, (height, width, 3), np.uint8)
    return cv2.imencode(".jpg", noise)[1].tobytes()


@pytest.mark.parametrize(
    ("encoding", "data", "rule"),
    [
        ("jpeg", jpeg_of_scans(6842), "more than 64 scans"),
        ("png", png_of_texts(500, 7_900_000), "more than 8 compressed"),
    ],
    ids=["scans", "texts"],
)
def test_an_image_built_to_decode_slowly_is_rejected(encoding, data, rule):
    """Two JPEGs of 6,842 scans held another session's frame for 92 s, a PNG of 500 compressed texts for 22 s."""
    with RunningServer() as server:
        server.open()
        answer = server.push(0, colour_frame(encoding, data))
        assert (answer.status, answer.kind, answer.json["field"]) == (422, "bad-frame", "colour")
        assert rule in answer.json["rule"]
        assert server.push(0).json["status"] == "processed"


def test_a_frame_beyond_the_time_limit_is_rejected(caplog):
    """A decoder in C cannot be interrupted: SIGTERM took 59 s. Its process is killed, and costs one frame."""
    with RunningServer(decode_timeout_s=0.001) as server:
        server.open()
        answer = server.push(0, colour_frame("jpeg", jpeg(2000, 1500), 2000, 1500))
        assert (answer.status, answer.kind, answer.json["rule"]) == (422, "bad-frame", "must decode within 0.001 s")
        assert server.push(0).json["status"] == "processed"
        assert server.state()["status"] == "open"
    assert [r.getMessage() for r in caplog.records].count("decoding process killed") == 1


def test_a_decoder_that_dies_is_replaced(monkeypatch):
    with RunningServer(decode_threads=1) as server:
        server.open()
        assert server.push(0, colour_frame("jpeg", jpeg())).json["status"] == "processed"
        (process,) = server.app.state.context.workers.decode_processes._idle
        os.kill(process._process.pid, signal.SIGKILL)
        process._process.wait()
        assert server.push(1, colour_frame("jpeg", jpeg())).json["status"] == "processed"
        with monkeypatch.context() as patched:
            patched.setattr(decode_processes._Process, "request", lambda *_: _raise(OSError("ended")))
            answer = server.push(2, colour_frame("jpeg", jpeg()))
            assert (answer.status, answer.json["rule"]) == (422, "the decoder crashed")
        assert server.push(2, colour_frame("jpeg", jpeg())).json["status"] == "processed"


def _raise(error):
    raise error


def test_the_processes_end_with_the_server():
    with RunningServer() as server:
        server.open()
        assert server.push(0, colour_frame("jpeg", jpeg())).json["status"] == "processed"
        processes = [each._process for each in server.app.state.context.workers.decode_processes._all]
    assert processes
    assert all(process.returncode is not None for process in processes)


def test_an_image_has_the_same_light_from_thread_and_process(monkeypatch):
    def light(server):
        server.open(options=SMALL)
        assert server.push(0, colour_frame("jpeg", jpeg(800, 600), 800, 600)).json["status"] == "processed"
        return server.call("GET", "/v1/sessions/room/probe?x=0.2&y=1.2&z=-0.2&format=npy").headers["etag"]

    with RunningServer() as server:
        from_process = light(server)
    from roomlight_server.work.decode_worker import decode_to_box

    monkeypatch.setattr(decode_processes.DecodeProcesses, "decode", lambda _, *given: decode_to_box(*given))
    with RunningServer() as server:
        assert light(server) == from_process
