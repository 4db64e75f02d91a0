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


class Restorer:
    """Makes sessions from saved states, with the weights of this server."""

    def __init__(self, workers: Workers) -> None:
        """Use the decoding threads and processes of these workers."""
        self._workers = workers

    async def restore(self, reading: Reading, graphs: LightingGraphs | None) -> tuple[Session, LiveState]:
        """Return the engine and the state of a session; 24 keyframes take 0.3 to 0.5 s.

        Raises:
            ProblemError: The state was saved with other weights, or its frames have other pixels now (409), or a frame
                cannot be decoded now (503).
        """
        values = reading.values
        base = self._workers.base_options
        options = replace(
            reading.session.options,
            weights=base.weights,
            provider=base.provider,
            parts=base.parts,
        )
        try:
            bases = await self._bases(reading, options)
            engine, snapshot = await self._workers.run_in_decode_pool(_engine, reading, bases, options, graphs)
        except (StateError, ModelError) as error:
            text = str(error) if values.name in str(error) else f"saved state of session {values.name}: {error}"
            raise refused(StateError(text), values.name) from error
        except WireError as error:
            detail = f"a saved frame cannot be decoded now ({error}); retry later"
            raise ProblemError("state-unavailable", detail, retry_after_s=5) from error
        kept = values.reference, values.probes, values.queue, values.light_frame
        latest = _latest(reading, snapshot)
        return engine, LiveState(snapshot, *kept, latest, values.scene, values.depth_scale)

    async def _bases(self, reading: Reading, options: SessionOptions) -> dict[int, FrameMesh]:
        messages = reading.messages.keys() - reading.pixels
        wanted = [index for index in reading.session.elsewhere if index in messages]
        made = await asyncio.gather(*(self._base(reading, index, options) for index in wanted))
        return reading.pixels | dict(zip(wanted, made, strict=True))

    async def _base(self, reading: Reading, index: int, options: SessionOptions) -> FrameMesh:
        message, processes = reading.messages[index], self._workers.decode_processes
        if message.depth is None:
            raise StateError(f"frame {index} came without depth, and what was estimated for it is not saved")
        reference = reading.values.reference or message.header.exposure
        least = reading.values.request.min_confidence

        def make() -> FrameMesh:
            return base_of_frame(decode_to_size(message, index, reference, least, processes), options)

        return await self._workers.run_in_decode_pool(make)


def _engine(
    reading: Reading, bases: dict[int, FrameMesh], options: SessionOptions, graphs: LightingGraphs | None
) -> tuple[Session, SessionSnapshot]:
    snapshot = reading.session.snapshot(bases)
    return Session.from_snapshot(snapshot, options, graphs=graphs), snapshot


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
