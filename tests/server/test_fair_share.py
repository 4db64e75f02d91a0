"""Sharing of slots by time, with a clock that the tests set."""

import asyncio
import functools
import threading

import pytest

from roomlight_server.base.request_context import Flow, current_flow
from roomlight_server.work import fair_share
from roomlight_server.work.fair_share import FairShare


class Clock:
    """A clock that only `advance` moves."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s

    def advance(self, seconds):
        self.now_s += seconds


def in_loop(test):
    """Run an async test in an event loop of its own."""

    @functools.wraps(test)
    def run(*args, **kwargs):
        asyncio.run(test(*args, **kwargs))

    return run


@pytest.fixture
def clock():
    return Clock()


class Jobs:
    """Jobs on a FairShare: `add` queues one, `run` lets queued jobs run to their end, each for its time."""

    def __init__(self, share, clock):
        self._share, self._clock = share, clock
        self.order: list[str] = []
        self.tasks: list[asyncio.Task[None]] = []

    async def add(self, name, seconds, *, owner="a", session="s", gate=None, order=0):
        async def job():
            current_flow.set(Flow(owner, session))
            async with self._share.slot(order):
                self.order.append(name)
                if gate is not None:
                    await gate.wait()
                self._clock.advance(seconds)

        self.tasks.append(asyncio.create_task(job()))
        await asyncio.sleep(0)
        return self.tasks[-1]

    async def run(self):
        await asyncio.gather(*self.tasks)


@in_loop
async def test_the_owner_with_the_least_time_is_served(clock):
    jobs, gate = Jobs(FairShare(1, clock=clock), clock), asyncio.Event()
    await jobs.add("a0", 1.0, gate=gate)
    for number in range(1, 4):
        await jobs.add(f"a{number}", 1.0)
    for number in range(4):
        await jobs.add(f"b{number}", 0.25, owner="b")
    gate.set()
    await jobs.run()
    order = jobs.order
    assert order == ["a0", "b0", "b1", "b2", "b3", "a1", "a2", "a3"]


@in_loop
async def test_a_lower_order_comes_first_until_the_others_lose_patience(clock):
    jobs, gate = Jobs(FairShare(1, clock=clock), clock), asyncio.Event()
    await jobs.add("final0", 1.0, gate=gate, order=1)
    await jobs.add("final1", 1.0, order=1, session="t")
    for number in range(3):
        await jobs.add(f"preview{number}", 9.5)
    gate.set()
    await jobs.run()
    # after 1 + 2 * 9.5 s the second final has waited for 20 s, and its session has used less
    assert jobs.order == ["final0", "preview0", "preview1", "final1", "preview2"]


@pytest.mark.parametrize("slots", [1, 2])
@in_loop
async def test_a_job_of_a_higher_order_does_not_wait_for_owners_that_have_used_more(slots, clock):
    """It waited for 20 s behind the frames of another owner."""
    jobs, gates = Jobs(FairShare(slots, clock=clock), clock), [asyncio.Event() for _ in range(slots)]
    for number, gate in enumerate(gates):
        await jobs.add(f"frame{number}", 1.0, owner="b", gate=gate)
    await jobs.add("late", 1.0, order=1)
    await jobs.add("frame", 1.0, owner="b")
    gates[0].set()
    for _ in range(3):
        await asyncio.sleep(0)
    assert jobs.order[slots] == "late"  # beside the frame in the other slot
    gates[-1].set()
    await jobs.run()


@in_loop
async def test_a_job_of_a_higher_order_runs_alone(clock):
    jobs, gates = Jobs(FairShare(2, clock=clock), clock), [asyncio.Event() for _ in range(2)]
    await jobs.add("frame0", 1.0, gate=gates[0])
    await jobs.add("late", 1.0, order=1, session="t")
    await jobs.add("frame1", 1.0, gate=gates[1])
    assert jobs.order == ["frame0", "frame1"]  # beside each other
    gates[0].set()
    await jobs.tasks[0]
    await asyncio.sleep(0)
    assert jobs.order == ["frame0", "frame1"]
    gates[1].set()
    await jobs.run()
    assert jobs.order == ["frame0", "frame1", "late"]


@in_loop
async def test_a_running_job_of_a_higher_order_pauses_while_a_lower_one_runs():
    share, steps, entered = FairShare(2), threading.Event(), threading.Event()
    late = asyncio.create_task(paused_job(share, owner="a", steps=steps, entered=entered, order=1))
    await asyncio.to_thread(entered.wait)
    current_flow.set(Flow("b", "s"))
    async with share.slot():
        while share.waiting == 0:  # until it has paused
            await asyncio.sleep(0)
        steps.set()
        assert not late.done()
    await late
    assert (share.waiting, share._running) == (0, [])


@in_loop
async def test_a_job_that_has_lost_patience_asks_to_pause_only_after_a_slice(clock, monkeypatch):
    share, asked = FairShare(3, clock=clock), []

    async def ask(turn):
        asked.append(turn.order)

    monkeypatch.setattr(share, "_pause", ask)
    async with share.slot(1) as late:
        clock.advance(fair_share.PATIENCE_S)  # from now on it counts as one of order 0
        late.since_s = clock()
        async with share.slot():
            await asyncio.to_thread(late.pause)
            assert asked == []
        jobs, gate = Jobs(share, clock), asyncio.Event()
        await jobs.add("later", 1.0, order=1, gate=gate)  # waits, as it may only run alone
        await asyncio.to_thread(late.pause)
        assert asked == []
        clock.advance(2 * fair_share.SLICE_S)
        await asyncio.to_thread(late.pause)
        assert asked == [1]
    gate.set()
    await jobs.run()


@in_loop
async def test_the_session_with_the_least_time_is_served(clock):
    jobs, gate = Jobs(FairShare(1, clock=clock), clock), asyncio.Event()
    await jobs.add("large0", 1.0, session="large", gate=gate)
    await jobs.add("large1", 1.0, session="large")
    await jobs.add("small0", 0.1, session="small")
    await jobs.add("small1", 0.1, session="small")
    gate.set()
    await jobs.run()
    assert jobs.order == ["large0", "small0", "small1", "large1"]


@in_loop
async def test_the_next_job_is_told_that_it_is_next(clock):
    share, gate, told = FairShare(1, clock=clock), asyncio.Event(), []

    async def job(name, session):
        current_flow.set(Flow("a", session))
        async with share.slot(on_next=lambda: told.append(name)):
            await gate.wait()
            clock.advance(1.0)

    tasks = [asyncio.create_task(job(name, session)) for name, session in (("1", "s"), ("2", "s"), ("3", "t"))]
    for _ in range(3):
        await asyncio.sleep(0)
    assert told == ["2", "2"]  # the third has used as much time, and came later
    told.clear()
    gate.set()
    await asyncio.gather(*tasks)
    assert told == ["2"]  # after the first, the session of the third has used less


@in_loop
async def test_an_idle_owner_saves_no_time_up(clock):
    jobs = Jobs(FairShare(1, clock=clock), clock)
    for number in range(10):  # b is idle for ten seconds
        await jobs.add(f"a{number}", 1.0)
        await jobs.run()
    jobs.order.clear()
    gate = asyncio.Event()
    await jobs.add("a", 1.0, gate=gate)
    for number in range(4):
        await jobs.add(f"b{number}", 1.0, owner="b")
        await jobs.add(f"a{number}", 1.0)
    gate.set()
    await jobs.run()
    order = jobs.order
    for end in range(1, len(order)):  # alternating, not all of b first
        assert abs(sum(1 if name[0] == "a" else -1 for name in order[:end])) <= 2


@in_loop
async def test_one_slot_is_left_for_other_owners(clock):
    jobs, gate = Jobs(FairShare(2, slots_per_owner=1, clock=clock), clock), asyncio.Event()
    for number in range(3):
        await jobs.add(f"a{number}", 1.0, gate=gate)
    await (await jobs.add("b", 1.0, owner="b"))
    assert jobs.order == ["a0", "b"]
    gate.set()
    await jobs.run()


@in_loop
async def test_a_cancelled_job_leaves_the_queue(clock):
    share = FairShare(1, clock=clock)
    jobs, gate = Jobs(share, clock), asyncio.Event()
    await jobs.add("a", 1.0, gate=gate)
    waiting = await jobs.add("b", 1.0)
    running = jobs.tasks.pop(0)
    jobs.tasks.clear()
    assert share.waiting == 1
    waiting.cancel()
    await asyncio.wait([waiting])
    assert share.waiting == 0
    running.cancel()  # its slot is free again
    await asyncio.wait([running])
    await jobs.add("c", 1.0)
    await jobs.run()
    assert jobs.order == ["a", "c"]


@in_loop
async def test_a_slot_granted_to_a_cancelled_job_is_free_again(clock):
    jobs, gate = Jobs(FairShare(1, clock=clock), clock), asyncio.Event()
    first = await jobs.add("a", 1.0, gate=gate)
    second = await jobs.add("b", 1.0)
    first.add_done_callback(lambda _: second.cancel())  # after the slot was granted, before the job runs
    gate.set()
    await asyncio.wait([first, second])
    jobs.tasks.clear()
    await jobs.add("c", 1.0)
    await jobs.run()
    assert jobs.order[-1] == "c"


async def paused_job(share, *, owner, steps, entered, order=0):
    """Run a job on a thread that pauses until `steps` is set."""
    current_flow.set(Flow(owner, "s"))
    async with share.slot(order) as turn:

        def work():
            entered.set()
            while not steps.is_set():
                turn.pause()

        try:
            await asyncio.shield(asyncio.get_running_loop().run_in_executor(None, work))
        except asyncio.CancelledError:
            turn.abandon()
            raise


@in_loop
async def test_closing_lets_paused_jobs_finish(monkeypatch):
    monkeypatch.setattr(fair_share, "SLICE_S", 0.0)
    share, steps, entered = FairShare(1), threading.Event(), threading.Event()
    long = asyncio.create_task(paused_job(share, owner="a", steps=steps, entered=entered))
    await asyncio.to_thread(entered.wait)
    current_flow.set(Flow("b", "s"))
    async with share.slot():
        steps.set()
        share.close()
        await long
