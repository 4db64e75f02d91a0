"""Metrics for Prometheus. Each server has its own registry, so that two servers can run in one process."""

from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST

from roomlight.engine.session import FrameReport

CONTENT_TYPE: Final = CONTENT_TYPE_LATEST
_SECONDS: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


class Metrics:
    """Counters, gauges and histograms of a server. Labels are closed sets, without session ids and addresses."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)  # memory, CPU time and open files of the process, on Linux
        self.sessions = Gauge("roomlight_sessions", "Open sessions.", registry=registry)
        self.session_bytes = Gauge("roomlight_session_bytes", "Memory of all sessions.", registry=registry)
        self.sessions_ended = Counter(
            "roomlight_sessions_ended", "Ended sessions, by reason.", ["reason"], registry=registry
        )
        self.state_writes = Counter(
            "roomlight_state_writes",
            "Sessions written to the state directory, by outcome.",
            ["outcome"],
            registry=registry,
        )
        self.state_write_seconds = Histogram(
            "roomlight_state_write_seconds", "Time for writing a session.", buckets=_SECONDS, registry=registry
        )
        self.state_session_bytes = Histogram(
            "roomlight_state_session_bytes",
            "Size of a session on disk.",
            buckets=tuple(2.0**power for power in range(16, 28)),
            registry=registry,
        )
        self.state_unsaved_seconds = Gauge(
            "roomlight_state_unsaved_seconds", "Age of the oldest change that is not on disk.", registry=registry
        )
        self.frames = Counter("roomlight_frames", "Accepted frames, by status.", ["status"], registry=registry)
        self.refused = Counter(
            "roomlight_frames_refused", "Rejected frames, by kind of problem.", ["kind"], registry=registry
        )
        self.frame_seconds = Histogram(
            "roomlight_frame_engine_seconds", "Engine time per frame.", buckets=_SECONDS, registry=registry
        )
        self.stage_seconds = Histogram(
            "roomlight_frame_stage_seconds",
            "Engine time per stage.",
            ["stage"],
            buckets=_SECONDS,
            registry=registry,
        )
        self.light_seconds = Histogram(
            "roomlight_light_seconds",
            "Time per batch of probes.",
            buckets=_SECONDS,
            registry=registry,
        )
        self.composite_seconds = Histogram(
            "roomlight_composite_seconds",
            "Time per composite without its waiting, by quality.",
            ["quality"],
            buckets=(*_SECONDS, 10.0, 30.0, 60.0),
            registry=registry,
        )
        self.objects = Gauge("roomlight_objects", "Uploaded objects.", registry=registry)
        self.object_bytes = Gauge("roomlight_object_bytes", "Memory of uploaded objects.", registry=registry)
        self.objects_refused = Counter("roomlight_objects_refused", "Rejected object files.", registry=registry)
        self.requests = Histogram(
            "roomlight_request_seconds",
            "Time per request, by method, route and status.",
            ["method", "route", "status"],
            buckets=_SECONDS,
            registry=registry,
        )
        self.queued = Gauge("roomlight_queued_jobs", "Jobs waiting for a thread, by pool.", ["pool"], registry=registry)
        self.queue_seconds = Histogram(
            "roomlight_queue_seconds",
            "Waiting time for a thread, by pool.",
            ["pool"],
            buckets=_SECONDS,
            registry=registry,
        )
        self.decode_seconds = Histogram(
            "roomlight_decode_seconds",
            "Time to decode a frame, without its waiting.",
            buckets=_SECONDS,
            registry=registry,
        )
        self.problems = Counter("roomlight_problems", "Problems sent to clients, by kind.", ["kind"], registry=registry)
        self.messages = Counter(
            "roomlight_stream_messages",
            "WebSocket messages, by direction and type.",
            ["direction", "type"],
            registry=registry,
        )
        self.abandoned = Counter(
            "roomlight_requests_abandoned", "Requests whose client was gone before the answer.", registry=registry
        )
        self.late_points = Gauge(
            "roomlight_late_points", "Points without a named probe that are computed or wait.", registry=registry
        )
        self.connections = Gauge("roomlight_connections", "Open connections.", registry=registry)
        self.loop_lag = Gauge(
            "roomlight_event_loop_lag_seconds",
            "Largest lateness of the event loop in the last 10 seconds.",
            registry=registry,
        )
        self.pending_bytes = Gauge(
            "roomlight_pending_bytes", "Memory of requests and answers in progress.", registry=registry
        )
        self.connections_refused = Counter(
            "roomlight_connections_refused",
            "Connections that were refused or closed, by reason.",
            ["kind"],
            registry=registry,
        )
        self.unauthorized = Counter(
            "roomlight_unauthorized", "Requests without a valid token, by reason.", ["reason"], registry=registry
        )
        self.streams = Gauge("roomlight_streams", "Open WebSockets.", registry=registry)

    def observe_frame(self, report: FrameReport) -> None:
        """Record a processed frame."""
        self.frames.labels("processed").inc()
        self.frame_seconds.observe(sum(report.stage_ms.values()) / 1e3)
        for stage, milliseconds in report.stage_ms.items():
            self.stage_seconds.labels(stage).observe(milliseconds / 1e3)

    def text(self) -> bytes:
        """Return all metrics in the text format of Prometheus."""
        return generate_latest(self.registry)
