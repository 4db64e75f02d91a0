"""How both clients wait between attempts; tests replace these functions."""

import asyncio
import random
import time


def wait(seconds: float) -> None:
    """Wait in this thread."""
    time.sleep(seconds)


async def wait_async(seconds: float) -> None:
    """Wait in this task."""
    await asyncio.sleep(seconds)


def jitter() -> float:
    """Return the random part of a delay, from 0 to 1."""
    return random.random()
