"""Restoring of a saved session: its kept frames are decoded from the messages again, then its engine continues."""

import asyncio
from dataclasses import replace

import numpy as np

from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.options import SessionOptions
from roomlight.engine.session import Session
from roomlight.engine.state.kept_frames import base_of_frame
from roomlight.engine.state.snapshot import SessionSnapshot
from roomlight.engine.surface.mesh import FrameMesh
from roomlight.errors import ModelError, StateError, WireError
from roomlight_server.base.problems import ProblemError
from roomlight_server.state.live_state import LiveState
from roomlight_server.state.session_folder import Reading
from roomlight_server.state.store import refused
from roomlight_server.work.intake import LatestFrame, decode_to_size
from roomlight_server.work.workers import Workers


async def restore(workers: Workers, reading: Reading, graphs: LightingGraphs | None) -> tuple[Session, LiveState]:
    """Return the engine, with the weights of this server, and the state of a session; 24 keyframes take 0.3 to 0.5 s.

    Raises:
        ProblemError: The state was saved with other weights, or its frames have other pixels now (409), or a frame
            cannot be decoded now (503).
    """
    values, base = reading.values, workers.base_options
    options = replace(reading.session.options, weights=base.weights, provider=base.provider, parts=base.parts)

    def make_engine(bases: dict[int, FrameMesh]) -> tuple[Session, SessionSnapshot]:
        snapshot = reading.session.snapshot(bases)
        return Session.from_snapshot(snapshot, options, graphs=graphs), snapshot

    try:
        bases = await _bases(workers, reading, options)
        engine, snapshot = await workers.run_in_decode_pool(make_engine, bases)
    except (StateError, ModelError) as error:
        text = str(error) if values.name in str(error) else f"saved state of session {values.name}: {error}"
        raise refused(StateError(text), values.name) from error
    except WireError as error:
        detail = f"a saved frame cannot be decoded now ({error}); retry later"
        raise ProblemError("state-unavailable", detail, retry_after_s=5) from error
    return engine, LiveState(snapshot, values, _latest(reading, snapshot))


async def _bases(workers: Workers, reading: Reading, options: SessionOptions) -> dict[int, FrameMesh]:
    reference, least = reading.values.reference, reading.values.request.min_confidence

    def make_base(index: int) -> FrameMesh:
        message = reading.messages[index]
        if message.depth is None:
            raise StateError(f"frame {index} came without depth, and what was estimated for it is not saved")
        exposure = reference or message.header.exposure
        return base_of_frame(decode_to_size(message, index, exposure, least, workers.decode_processes), options)

    messages = reading.messages.keys() - reading.pixels
    wanted = [index for index in reading.session.elsewhere if index in messages]
    made = await asyncio.gather(*(workers.run_in_decode_pool(make_base, index) for index in wanted))
    return reading.pixels | dict(zip(wanted, made, strict=True))


def _latest(reading: Reading, snapshot: SessionSnapshot) -> LatestFrame | None:
    """Return the last frame; one that came without depth has the estimate of its mesh."""
    index = reading.values.latest
    if index is None:
        return None
    message = reading.messages[index]
    if message.depth is not None:
        return LatestFrame(index, message)
    mesh = next(kept.mesh for kept in snapshot.kept if kept.index == index)
    return LatestFrame(index, message, np.where(mesh.measured, mesh.grid_depth_m, np.float32(0)))
