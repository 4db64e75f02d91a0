"""Images that take long to decode, and decoders that die: each costs one frame, over a real socket."""

import errno
import fcntl
import mmap
import os
import re
import resource
import signal
import struct
import subprocess
import termios
from dataclasses import fields, replace
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from http_servers import InThread, RunningServer, box_shot, with_parts
from present import present
from roomlight.errors import ServerError, WireError
from roomlight.frame import Frame
from roomlight.wire.frame_encoding import pack_frame
from roomlight.wire.frame_message import FrameLimits, parse
from roomlight_server.base.settings import ServerSettings
from roomlight_server.work import decode_worker, processes
from roomlight_server.work.decode_processes import DecodeProcesses
from roomlight_server.work.decode_worker import MAX_MEMORY_BYTES, decode_to_box
from roomlight_server.work.shared_block import SharedBlock


def colour_frame(encoding, data, width=48, height=36):
    """Return a frame message of the box room with this image file."""
    focal = 30.0 * width / 48
    lens = {"fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2, "width": width, "height": height}
    return with_parts(({"encoding": encoding}, data), intrinsics=lens)


def jpeg(width=48, height=36):
    noise = np.random.default_rng(5).integers(0, 255, (height, width, 3), np.uint8)
    return cv2.imencode(".jpg", noise)[1].tobytes()


@pytest.mark.parametrize("masked", [False, True])
def test_a_frame_of_a_decoder_process_is_the_decoded_frame(masked):
    seen = np.indices((36, 48)).sum(0) % 5 > 0
    message = parse(pack_frame(replace(box_shot(0), seen=seen if masked else None), colour="png"), FrameLimits())
    decoded = decode_to_box(message, 3, 2.0, 1, (40, 30))
    assert (decoded.seen is not None) == masked
    text, parts = decode_worker.pack_frame(decoded)
    received = decode_worker.unpack_frame(text, b"".join(parts), message, 3)
    for field in fields(Frame):
        np.testing.assert_equal(getattr(received, field.name), getattr(decoded, field.name), field.name)


def test_a_frame_beyond_the_time_limit_is_rejected(caplog):
    """A decoder in C cannot be interrupted: SIGTERM took 59 s. Its process is killed, and costs one frame."""
    with RunningServer(decode_timeout_s=0.001) as server:
        server.open()
        answer = server.push(0, colour_frame("jpeg", jpeg(2000, 1500), 2000, 1500))
        assert (answer.status, answer.kind, answer.json["rule"]) == (422, "bad-frame", "must decode within 0.001 s")
        assert server.push(0).json["status"] == "processed"
        assert server.state()["status"] == "open"
    assert [r.getMessage() for r in caplog.records].count("decoding process killed") == 1


@pytest.fixture
def one_decoder():
    with RunningServer(decode_threads=1, decode_timeout_s=60) as server:
        server.open()
        assert server.push(0, colour_frame("jpeg", jpeg())).json["status"] == "processed"
        (pid,) = server.app.state.context.workers.decode_processes.pids
        yield server, pid


@pytest.mark.slow
def test_a_frame_whose_decoder_is_killed_is_decoded_by_another(one_decoder, caplog):
    """It was refused with 422, as if its image had ended the decoder."""
    server, pid = one_decoder
    os.kill(pid, signal.SIGSTOP)
    push = InThread(server.push, 1, colour_frame("jpeg", jpeg(800, 600), 800, 600))
    while not is_reading(pid):
        pass
    os.kill(pid, signal.SIGKILL)
    assert push.result().json["status"] == "processed"
    assert [vars(r)["reason"] for r in caplog.records if "reason" in vars(r)] == ["the decoder crashed"]
    (other,) = server.app.state.context.workers.decode_processes.pids
    os.kill(other, signal.SIGKILL)  # while it is idle
    assert server.push(2, colour_frame("jpeg", jpeg())).json["status"] == "processed"


def test_a_decoder_that_answers_more_than_it_states_is_replaced(one_decoder, monkeypatch, caplog):
    server, pid = one_decoder
    read, longer = os.read, [b"x"]

    def read_more(descriptor, size):
        return read(descriptor, size) + (longer.pop() if longer else b"")

    with monkeypatch.context() as patched:
        patched.setattr(processes.os, "read", read_more)
        answer = server.push(1, colour_frame("jpeg", jpeg()))
    assert answer.json["status"] == "processed"
    assert [vars(r)["reason"] for r in caplog.records if "reason" in vars(r)] == ["the decoder crashed"]
    assert server.app.state.context.workers.decode_processes.pids != [pid]


def is_reading(pid):
    """Whether something waits in the pipe of a process's standard input."""
    with Path(f"/proc/{pid}/fd/0").open("rb", buffering=0) as pipe:
        return struct.unpack("i", fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)))[0] > 0


def test_an_image_that_crashes_the_decoder_is_rejected(one_decoder, monkeypatch):
    server, _ = one_decoder
    with monkeypatch.context() as patched:
        patched.setattr(processes.WorkerProcess, "request", Mock(side_effect=OSError("ended")))
        answer = server.push(2, colour_frame("jpeg", jpeg()))
        assert (answer.status, answer.json["rule"]) == (422, "the decoder crashed")
    assert server.push(2, colour_frame("jpeg", jpeg())).json["status"] == "processed"


def test_a_decoder_that_does_not_read_is_killed():
    """Writing to a stopped decoder had no deadline: a frame waited for 60 s."""
    with RunningServer(decode_threads=1, decode_timeout_s=0.5) as server:
        server.open()
        decoders = server.app.state.context.workers.decode_processes
        decoders.start(1)
        while server.push(0, colour_frame("jpeg", jpeg())).status != 200:
            pass  # a process that still starts may take more than this limit
        for pid in decoders.pids:
            os.kill(pid, signal.SIGSTOP)
        answer = server.push(1, colour_frame("jpeg", jpeg(800, 600), 800, 600))
        assert (answer.status, answer.json["rule"]) == (422, "must decode within 0.5 s")


def test_a_decoding_process_has_a_limit_on_memory(one_decoder):
    """A GLB of 31 MiB took 3.3 GB, and its memory was charged with 33 MB."""
    server, pid = one_decoder
    assert resource.prlimit(pid, resource.RLIMIT_AS) == (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES)
    status = Path(f"/proc/{pid}/status").read_text("utf-8")
    assert re.search(r"Threads:\s+1\b", status)  # one for each core took all of its address space on 11 cores
    size = present(re.search(r"VmSize:\s+(\d+) kB", status))
    now = 1024 * int(size[1])
    resource.prlimit(pid, resource.RLIMIT_AS, (now + 2**24, MAX_MEMORY_BYTES))
    answer = server.push(1, colour_frame("jpeg", jpeg(4000, 3000), 4000, 3000))
    assert (answer.status, answer.json["rule"]) == (422, "must decode within the memory of a decoding process")
    assert server.push(1, colour_frame("jpeg", jpeg())).json["status"] == "processed"


def test_a_decoder_that_cannot_start_is_no_fault_of_the_file(monkeypatch):
    decoders = DecodeProcesses(ServerSettings())
    try:
        with monkeypatch.context() as patched:
            patched.setattr(processes, "with_few_threads", lambda _: {"PYTHONHOME": "/nowhere"})
            with pytest.raises(RuntimeError, match="ended with exit code 1 at its start"):
                decoders.decode_object(b"v 0 0 0\n", "obj")
        with pytest.raises(WireError, match="face"):
            decoders.decode_object(b"v 0 0 0\n", "obj")
    finally:
        decoders.stop()


def test_the_processes_end_with_the_server():
    with RunningServer() as server:
        server.open()
        assert server.push(0, colour_frame("jpeg", jpeg())).json["status"] == "processed"
        pids = server.app.state.context.workers.decode_processes.pids
    assert pids
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_process_cannot_cut_the_memory_that_the_server_reads():
    block = SharedBlock()
    other = SharedBlock(os.dup(block.descriptor))
    other.write(b"abc", bytearray(b"de"))
    assert block.read(5) == b"abcde"
    with pytest.raises(PermissionError):
        os.ftruncate(other.descriptor, 0)
    other.close()
    assert block.read(2) == b"ab"
    with block.view(5) as view:
        assert (bytes(view), view.readonly) == (b"abcde", True)
    block.close()


def test_a_large_result_gives_its_memory_back():
    block = SharedBlock()
    block.write(bytes([7]) * 2**23)
    assert 512 * os.fstat(block.descriptor).st_blocks >= 2**23
    block.release(2**10)
    assert block.read(1) == b"\7"
    block.release(2**23)
    assert (os.fstat(block.descriptor).st_blocks, block.read(1)) == (0, b"\0")
    block.close()


def test_a_refused_object_does_not_stay_in_shared_memory():
    decoders = DecodeProcesses(ServerSettings())
    try:
        with pytest.raises(WireError, match="vertices are limited"):
            decoders.decode_object(b"v 0 0 0\n" * 1_000_000, "obj")
        (pid,) = decoders.pids
        shared = [file.stat() for file in Path(f"/proc/{pid}/fd").iterdir() if "memfd:" in str(file.readlink())]
        assert 512 * max(block.st_blocks for block in shared) < 2**20
    finally:
        decoders.stop()


def test_a_decoded_frame_has_arrays_of_its_own(one_decoder):
    """A kept image kept the depth of its frame too, in one buffer."""
    server, _ = one_decoder
    processes = server.app.state.context.workers.decode_processes
    message = parse(colour_frame("jpeg", jpeg()), FrameLimits(2**30, 2**30, 2**30))
    frame = processes.decode(message, 1, 1.0, 0, (320, 240))
    assert all(array.base is None for array in (frame.image, frame.clipped, frame.depth_m))


@pytest.mark.parametrize(("module", "call"), [(os, "ftruncate"), (mmap, "mmap"), (subprocess, "Popen")])
def test_a_process_that_cannot_start_leaves_no_open_file(monkeypatch, module, call):
    made, make = [], os.memfd_create
    with monkeypatch.context() as patched:
        patched.setattr(os, "memfd_create", lambda *args: made.append(make(*args)) or made[-1])
        patched.setattr(module, call, Mock(side_effect=BlockingIOError("no process, no memory")))
        with pytest.raises((ServerError, BlockingIOError)):
            DecodeProcesses(ServerSettings()).start(1)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(made[0])


def test_memory_that_the_system_refuses_is_named(monkeypatch):
    """A limit of the size of files (`ulimit -f`) applies to it too, and ended the server in a traceback."""
    monkeypatch.setattr(os, "ftruncate", Mock(side_effect=OSError(errno.EFBIG, os.strerror(errno.EFBIG))))
    with pytest.raises(ServerError, match=r"268435456 bytes cannot be made \(File too large\); raise .*ulimit -f"):
        SharedBlock()
