"""The memory of a history, which is counted as entries come, get their pictures and go."""

import asyncio
import threading

import numpy as np
import pytest

from roomlight.camera import Intrinsics
from roomlight.engine.session import FrameReport
from roomlight.frame import Frame
from roomlight.wire.messages import FrameCounts
from roomlight_server.base.metrics import Metrics
from roomlight_server.base.settings import ServerSettings
from roomlight_server.sessions import history
from roomlight_server.work.workers import Workers

COUNTS = FrameCounts(
    accepted=0, processed=0, superseded=0, skipped=0, gaps=0, replayed=0, refused=0, queued=0, last_index=None
)
LENS = Intrinsics(60.0, 60.0, 32.0, 24.0, 64, 48)


@pytest.fixture
def workers():
    made = Workers(ServerSettings(), Metrics())
    yield made
    made.stop()


@pytest.fixture
def drawn(monkeypatch):
    """Return an event for each frame, which lets its pictures be made."""
    events = [threading.Event(), threading.Event()]

    def pictures(image, _):
        events[int(image[0, 0, 0])].wait()
        return b"p" * 500, {"table": b"l" * 300}

    monkeypatch.setattr(history, "_pictures", pictures)
    return events


def record(kept, index):
    image, depth_m = np.full((48, 64, 3), float(index), np.float32), np.full((48, 64), 2.0, np.float32)
    seen = Frame(
        index=index,
        image=image,
        clipped=np.zeros((48, 64), bool),
        depth_m=depth_m,
        intrinsics=LENS,
        camera_to_world=np.eye(4),
    )
    kept.add(seen, FrameReport(index=index, stage_ms={}, keyframe=True, coverage=()), COUNTS, {})


def test_pictures_count_from_when_they_are_made(workers, drawn):
    async def run():
        kept = history.History(10_000_000, workers)
        record(kept, 0)
        record(kept, 1)
        bare = kept.size
        drawn[1].set()
        assert await kept.picture(1) == b"p" * 500
        assert kept.size == bare + 800
        late = asyncio.create_task(kept.picture(0))
        await asyncio.sleep(0)  # it waits for the picture
        kept.clear()
        assert kept.size == 0
        drawn[0].set()
        assert await late == b"p" * 500
        assert kept.size == 0  # the picture is of an entry that is gone

    asyncio.run(run())


def test_pictures_thin_a_full_history(workers, drawn):
    async def run():
        kept = history.History(10_000_000, workers)
        record(kept, 0)
        record(kept, 1)
        kept._limit_bytes = kept.size + 1000  # for the pictures of one frame
        for index in range(2):
            assert len(kept.listed(-1).entries) == 2
            drawn[index].set()
            assert await kept.picture(index) == b"p" * 500
        assert [entry.index for entry in kept.listed(-1).entries] == [0]
        assert kept.size <= kept._limit_bytes

    asyncio.run(run())


def test_a_frame_that_was_wanted_before_the_history_was_full_is_left_out(workers, monkeypatch):
    monkeypatch.setattr(history, "MAX_DRAWING", 0)

    async def run():
        kept = history.History(10_000_000, workers)
        for index in range(5):
            record(kept, index)
        assert kept.next_handles({}) == {}  # the next frame, 5
        kept._stride = 2  # pictures were made meanwhile
        record(kept, 5)
        assert 5 not in [entry.index for entry in kept.listed(-1).entries]

    asyncio.run(run())


def test_a_full_history_keeps_every_second_frame_and_counts_what_is_left(workers, monkeypatch):
    monkeypatch.setattr(history, "MAX_DRAWING", 0)

    async def run():
        kept = history.History(10_000, workers)
        sizes: list[int] = []
        for index in range(9):
            record(kept, index)
            sizes.append(kept.size)
        listed = kept.listed(-1)
        assert (listed.stride, [entry.index for entry in listed.entries]) == (8, [0, 8])
        assert listed.bytes == 2 * sizes[0] <= listed.limit_bytes == 10_000

    asyncio.run(run())
