"""What `/metrics` tells Prometheus; one registry a server, so that two in one process do not mix."""

from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST

from roomlight.engine.session import FrameReport

CONTENT_TYPE: Final = CONTENT_TYPE_LATEST
_SECONDS: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


class Metrics:
    """Counters, gauges and histograms of a server. Labels are closed sets: no session id, no address."""

    def __init__(self) -> None:
        """All at zero."""
        self.registry = registry = CollectorRegistry()
        self.sessions = Gauge("roomlight_sessions", "Sessions held.", registry=registry)
        self.session_bytes = Gauge("roomlight_session_bytes", "Memory that the sessions hold.", registry=registry)
        self.sessions_ended = Counter(
            "roomlight_sessions_ended", "Sessions ended, by why.", ["reason"], registry=registry
        )
        self.frames = Counter(
            "roomlight_frames", "Accepted frames, by what became of them.", ["status"], registry=registry
        )
        self.refused = Counter(
            "roomlight_frames_refused", "Frames refused, by kind of problem.", ["kind"], registry=registry
        )
        self.frame_seconds = Histogram(
            "roomlight_frame_engine_seconds", "Engine time of a frame.", buckets=_SECONDS, registry=registry
        )
        self.stage_seconds = Histogram(
            "roomlight_frame_stage_seconds", "Engine time by stage.", ["stage"], buckets=_SECONDS, registry=registry
        )
        self.light_seconds = Histogram(
            "roomlight_light_seconds", "Time to answer for one batch of probes.", buckets=_SECONDS, registry=registry
        )
        self.requests = Histogram(
            "roomlight_request_seconds",
            "Time of a request, by route and status.",
            ["method", "route", "status"],
            buckets=_SECONDS,
            registry=registry,
        )
        self.streams = Gauge("roomlight_streams", "Open WebSockets.", registry=registry)

    def observe_frame(self, report: FrameReport) -> None:
        """A processed frame."""
        self.frames.labels("processed").inc()
        self.frame_seconds.observe(sum(report.stage_ms.values()) / 1e3)
        for stage, milliseconds in report.stage_ms.items():
            self.stage_seconds.labels(stage).observe(milliseconds / 1e3)

    def text(self) -> bytes:
        """In Prometheus's format."""
        return generate_latest(self.registry)
