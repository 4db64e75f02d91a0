"""Metrics for Prometheus. Each server has its own registry, so that two servers can run in one process."""

from functools import partial
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

from roomlight.engine.session import FrameReport

_SECONDS: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


class Metrics:
    """Counters, gauges and histograms of a server. Labels are closed sets, without session ids and addresses."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)  # memory, CPU time and open files of the process, on Linux
        counter, gauge = partial(Counter, registry=registry), partial(Gauge, registry=registry)
        histogram = partial(Histogram, registry=registry)
        seconds = partial(histogram, buckets=_SECONDS)
        self.sessions = gauge("roomlight_sessions", "Open sessions.")
        self.session_bytes = gauge("roomlight_session_bytes", "Memory of all sessions.")
        self.sessions_ended = counter("roomlight_sessions_ended", "Ended sessions, by reason.", ["reason"])
        self.state_writes = counter(
            "roomlight_state_writes", "Sessions written to the state directory, by outcome.", ["outcome"]
        )
        self.state_write_seconds = seconds("roomlight_state_write_seconds", "Time for writing a session.")
        self.state_session_bytes = histogram(
            "roomlight_state_session_bytes",
            "Size of a session on disk.",
            buckets=tuple(2.0**power for power in range(16, 28)),
        )
        self.state_unsaved_seconds = gauge(
            "roomlight_state_unsaved_seconds", "Age of the oldest change that is not on disk."
        )
        self.frames = counter("roomlight_frames", "Accepted frames, by status.", ["status"])
        self.refused = counter("roomlight_frames_refused", "Rejected frames, by kind of problem.", ["kind"])
        self.frame_seconds = seconds("roomlight_frame_engine_seconds", "Engine time per frame.")
        self.stage_seconds = seconds("roomlight_frame_stage_seconds", "Engine time per stage.", ["stage"])
        self.light_seconds = seconds("roomlight_light_seconds", "Time per batch of probes.")
        self.composite_seconds = histogram(
            "roomlight_composite_seconds",
            "Time per composite without its waiting, by quality.",
            ["quality"],
            buckets=(*_SECONDS, 10.0, 30.0, 60.0),
        )
        self.objects = gauge("roomlight_objects", "Uploaded objects.")
        self.object_bytes = gauge("roomlight_object_bytes", "Memory of uploaded objects.")
        self.objects_refused = counter("roomlight_objects_refused", "Rejected object files.")
        self.requests = seconds(
            "roomlight_request_seconds", "Time per request, by method, route and status.", ["method", "route", "status"]
        )
        self.queued = gauge("roomlight_queued_jobs", "Jobs waiting for a thread, by pool.", ["pool"])
        self.queue_seconds = seconds("roomlight_queue_seconds", "Waiting time for a thread, by pool.", ["pool"])
        self.decode_seconds = seconds("roomlight_decode_seconds", "Time to decode a frame, without its waiting.")
        self.problems = counter("roomlight_problems", "Problems sent to clients, by kind.", ["kind"])
        self.messages = counter(
            "roomlight_stream_messages", "WebSocket messages, by direction and type.", ["direction", "type"]
        )
        self.abandoned = counter("roomlight_requests_abandoned", "Requests whose client was gone before the answer.")
        self.late_points = gauge("roomlight_late_points", "Points without a named probe that are computed or wait.")
        self.connections = gauge("roomlight_connections", "Open connections.")
        self.loop_lag = gauge(
            "roomlight_event_loop_lag_seconds", "Largest lateness of the event loop in the last 10 seconds."
        )
        self.pending_bytes = gauge("roomlight_pending_bytes", "Memory of requests and answers in progress.")
        self.connections_refused = counter(
            "roomlight_connections_refused", "Connections that were refused or closed, by reason.", ["kind"]
        )
        self.unauthorized = counter("roomlight_unauthorized", "Requests without a valid token, by reason.", ["reason"])
        self.streams = gauge("roomlight_streams", "Open WebSockets.")

    def observe_frame(self, report: FrameReport) -> None:
        """Record a processed frame."""
        self.frames.labels("processed").inc()
        self.frame_seconds.observe(sum(report.stage_ms.values()) / 1e3)
        for stage, milliseconds in report.stage_ms.items():
            self.stage_seconds.labels(stage).observe(milliseconds / 1e3)

    def text(self) -> bytes:
        """Return all metrics in the text format of Prometheus."""
        return generate_latest(self.registry)
