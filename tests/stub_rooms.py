"""A renderer for tests: small recordings made quickly, called by its name in the workers of a generator.

Tests control it from outside its process through `steer.json` in the folder that the environment variable STUB_ROOMS
names:

    {"fails": {room: walk}}   raise at that walk, on the first attempt
    {"hopeless": room}        raise on every attempt
    {"dies": {room: times}}   kill the process at the first walk, that many times
    {"limit": bytes}          limit on the size of a written file
    {"gate": [room, walk]}    write a line to the pipe `reached`, then wait at the pipe `go`
"""

import json
import os
import resource
import signal
import sys
from pathlib import Path
from pkgutil import resolve_name
from unittest import mock

import numpy as np

from roomlight.camera import Intrinsics
from roomlight.dataset.recording import GLASS, LIGHT, Recording

NAME = f"{__name__}:render_room"
VIEWS = f"{__name__}:render_views"
FOREIGN = {"torch", "av", "onnxruntime", "fastapi", "lzfse", "filelock", "roomlight.captures", "roomlight_server"}
TYPES = ("kitchen", "study", "hall")


def recording(rng, *, name="one", frames=4, height=24, width=32, probes=2, facts=None):
    """A plausible recording: smooth colours, a slanted wall, one lamp, one pane of glass."""
    y, x = np.mgrid[:height, :width] / height
    phase = rng.uniform(0, 6, (frames, 1, 1, 3))
    colour = np.rint(127 + 100 * np.sin(3 * x[..., None] + 2 * y[..., None] + phase)).astype(np.uint8)
    depth_mm = np.rint(2000 + 500 * x + rng.uniform(0, 100, (frames, 1, 1))).astype(np.uint16)
    depth_mm[:, 0, 0] = 0
    surface = np.zeros((frames, height, width), np.uint8)
    surface[:, 2:5, 2:6], surface[:, 10, 10] = GLASS, LIGHT
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, 3] = np.cumsum(rng.normal(0, 0.05, (frames, 3)), axis=0)
    panoramas = rng.uniform(0.05, 0.5, (probes, 16, 32, 3)).astype(np.float32)
    panoramas[:, 3, 5] = (400.0, 300.0, 200.0)
    return Recording(
        name=name,
        colour=colour,
        depth_mm=depth_mm,
        surface=surface,
        intrinsics=Intrinsics(0.8 * width, 0.8 * width, width / 2, height / 2, width, height),
        camera_to_world=poses,
        exposure=np.concatenate([[1.0], rng.uniform(0.5, 2, frames - 1)]),
        timestamp_s=np.arange(frames) / 3.0,
        probe_positions=rng.uniform(-0.5, 0.5, (probes, 3)) - (0, 0, 1.5),
        probe_panoramas=panoramas,
        facts=facts or {},
    )


def render_room(request):
    """Yield recordings as the generator's own `render_room` does."""
    room_index, seed, furniture = request.index, request.seed, request.furniture
    steer = _steer()
    if "limit" in steer:
        resource.setrlimit(resource.RLIMIT_FSIZE, (steer["limit"], steer["limit"]))
    facts = {
        "room_type": TYPES[room_index % 3],
        "furniture": {"chair": 2, "lamp": 1},
        "light": {"scenario": "night", "sources": [{"kind": "table_lamp", "kelvin": 2700 + 100 * room_index}]},
        "foreign": sorted(FOREIGN & sys.modules.keys()),
        "threads": os.environ.get("ROOMLIGHT_THREADS"),
        "furniture_file": None if furniture is None else furniture.name,
    }
    for walk in range(request.count):
        sys.stdout.write("libraries print at times\n")
        if steer.get("hopeless") == room_index or (
            steer.get("fails", {}).get(str(room_index)) == walk and seed < 1000  # a retry's seed has 64 bits
        ):
            raise ArithmeticError(f"no light reaches room {room_index}")
        if steer.get("gate") == [room_index, walk]:
            _wait_at_gate()
        if walk == 0 and _dies_again(room_index, steer.get("dies", {})):
            os.kill(os.getpid(), signal.SIGKILL)
        rng = np.random.default_rng([seed, request.split == "train", room_index, walk])
        yield recording(rng, frames=request.frames, facts=facts)


def render_views(request):
    """Yield recordings without probes."""
    for view in range(request.count):
        yield recording(np.random.default_rng([request.seed, request.index, view]), frames=request.frames, probes=0)


def without_workers():
    """Let datasets be made in this process, without workers, whose start takes a second."""
    from roomlight_generator import generate, worker

    class InThisProcess:
        def __init__(self, _, on_message):
            self.on_message = on_message

        def run(self, tasks):
            for task in tasks:
                worker.make_shard(task, resolve_name(task.options.renderer_name), self.on_message)

    return mock.patch.object(generate, "WorkerPool", InThisProcess)


def make_dataset(folder, sequences, **options):
    """A dataset of such recordings, or of another renderer, made without workers."""
    from roomlight.dataset.loader import Dataset
    from roomlight_generator.generate import GenerateOptions, generate

    given = {"seed": 3, "shard_size": 2, "sequences_per_room": 2, "frames": 2, "renderer": NAME, **options}
    with without_workers():
        generate(folder, GenerateOptions(sequences, **given))
    return Dataset(folder, given.get("split", "train"))


def _steer():
    folder = os.environ.get("STUB_ROOMS")
    path = Path(folder) / "steer.json" if folder else None
    return json.loads(path.read_text()) if path and path.exists() else {}


def _wait_at_gate():
    folder = Path(os.environ["STUB_ROOMS"])
    with (folder / "reached").open("w") as reached:
        reached.write("here\n")
    with (folder / "go").open() as go:
        go.read()


def _dies_again(room, dies):
    """Whether the process is to be killed once more; counts this time first."""
    path = Path(os.environ.get("STUB_ROOMS", ".")) / f"died-{room}"
    done = len(path.read_text()) if path.exists() else 0
    if done >= dies.get(str(room), 0):
        return False
    path.write_text("x" * (done + 1))
    return True
