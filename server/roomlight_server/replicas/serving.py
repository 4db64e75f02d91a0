"""Several replicas of the server under Ray Serve, on one machine or on a cluster (extra `ray`).

Ray's proxies route by the header `X-Session-Id` on a consistent-hash ring without fallback, so that all requests of a
session reach one replica. When a replica is added or lost, its share of the sessions moves; the new owner restores them
from the state directory, and the fence (`state.fence`) keeps the old one from answering.
"""

import hashlib
import importlib
import logging
import os
import secrets
import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI

from roomlight import __version__
from roomlight.errors import OutputError, ServerError
from roomlight.files import write_durable
from roomlight_server.base.logs import configure_logging
from roomlight_server.base.settings import ServerSettings
from roomlight_server.base.tls import warn_if_expired
from roomlight_server.serving import KEEP_ALIVE_S, STOP_S, address_of, listen

_log = logging.getLogger("roomlight.server")
APPLICATION: Final = "roomlight"
ADDRESS_VARIABLE: Final = "RAY_ADDRESS"
OBJECT_STORE_BYTES: Final = 256 * 2**20
"""Shared memory for bodies of requests and answers on their way between a proxy and a replica."""
VARIABLES: Final = {
    "RAY_USAGE_STATS_ENABLED": "0",  # Ray would report its use to its makers
    "RAY_SERVE_HTTP_PROXY_CALLBACK_IMPORT_PATH": "roomlight_server.replicas.proxy.middlewares",
    "RAY_SERVE_SESSION_ID_HEADER_KEY": "x-session-id",
    "RAY_SERVE_ENABLE_HA_PROXY": "0",  # it routes POST alone by session
    "RAY_SERVE_QUEUE_LENGTH_RESPONSE_DEADLINE_S": "1",  # of 0.1: a busy replica is asked again and again otherwise
    "RAY_SERVE_PROXY_READY_CHECK_TIMEOUT_S": "60",  # of 5: on a busy machine the proxy was killed before it was ready
    "RAY_SERVE_PROXY_HEALTH_CHECK_TIMEOUT_S": "30",
    "RAY_DEDUP_LOGS": "0",  # a line of the log is one event
    "RAY_COLOR_PREFIX": "0",
}
"""Variables of all processes of the cluster; on a cluster of its own `ray start` needs them too."""
LOCAL_VARIABLES: Final = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # the node's address is that of loopback; otherwise Ray replaces it
    "RAY_worker_niceness": "0",  # of 15: replicas would get no time beside other programs
    "RAY_worker_register_timeout_seconds": "300",  # of 60: a busy machine starts them slowly
    "RAY_enable_metrics_collection": "0",  # `/metrics` has them
}
"""Variables of a cluster of this machine alone."""


def serve_on_ray(settings: ServerSettings, *, replicas: int, listening: Callable[[str], object]) -> None:
    """Serve until SIGINT, SIGTERM or SIGHUP. If the cluster serves already, change the number of replicas and return.

    Without `RAY_ADDRESS`, a cluster of this machine is started, which listens on loopback, and stopped at the end.

    Args:
        settings: Settings of each replica; `state_dir` is shared by all.
        listening: Called with the URL of the server once all replicas are ready; not if the cluster serves already,
            whose port can be another.

    Raises:
        ServerError: Ray is not installed, a setting is missing or has no effect here, the address cannot be used, or
            the replicas do not start.
    """
    settings = shared_settings(settings, replicas)
    if _is_local() and settings.state_dir is not None:
        _set_token(settings.state_dir)
    ray, serve = load_ray()
    configure_logging(settings.log_level)
    if settings.tls_cert is not None:
        warn_if_expired(settings.tls_cert)
    port = _free_port(settings)
    settings = settings.model_copy(update={"port": port})
    stopped = threading.Event()
    with _cluster(ray, replicas):
        running = APPLICATION in serve.status().applications
        _deploy(ray, serve, settings, replicas)
        _log.info("ready", extra={"replicas": replicas, "ray": ray.get_runtime_context().gcs_address})
        if running:
            _log.info("replicas changed", extra={"replicas": replicas})
            return
        listening(address_of(settings, port))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # below `nohup`
                signal.signal(number, lambda _number, _frame: stopped.set())
        try:
            stopped.wait()
        finally:
            _log.info("stopping")
            serve.shutdown()


def shared_settings(settings: ServerSettings, replicas: int) -> ServerSettings:
    """Return the settings of replicas.

    Raises:
        ServerError: There is no state directory, a setting has no effect, or the number of replicas is below 1.
    """
    if replicas < 1:
        raise ServerError(f"--replicas: {replicas}: must be at least 1")
    if settings.state_dir is None:
        raise ServerError("--ray needs --state-dir: a folder that all replicas share, from which sessions are restored")
    if settings.on_lan:
        raise ServerError("--ray listens on one address: unset on_lan, and use --host and --token-file")
    return settings.model_copy(update={"state_dir": settings.state_dir.absolute(), "state_shared": True})


def load_ray() -> tuple[Any, Any]:
    """Import Ray and Ray Serve, which a plain installation lacks. Its usage reports are off.

    Raises:
        ServerError: Ray is not installed.
    """
    os.environ.update(VARIABLES | LOCAL_VARIABLES if _is_local() else VARIABLES)
    try:
        return importlib.import_module("ray"), importlib.import_module("ray.serve")
    except ImportError as error:
        advice = "install it with: pip install 'roomlight[ray]'"
        raise ServerError(f"--ray needs Ray Serve, which is not installed ({error}); {advice}") from error


def _is_local() -> bool:
    address = os.environ.get(ADDRESS_VARIABLE, "")
    return not address or address.startswith("127.")


def _set_token(state_dir: Path) -> None:
    """Let Ray use a token that only this user can read; Ray's own would be readable by all in `~/.ray`.

    Raises:
        ServerError: The state directory cannot be used.
    """
    os.environ["RAY_AUTH_MODE"] = "token"
    if os.environ.get("RAY_AUTH_TOKEN") or os.environ.get("RAY_AUTH_TOKEN_PATH"):
        return
    path = state_dir / "ray-token"
    if os.environ.get(ADDRESS_VARIABLE) and not path.exists():
        return  # the cluster was not started by this command
    try:
        state_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not path.exists():
            write_durable(path, secrets.token_hex(32).encode())
    except (OSError, OutputError) as error:
        raise ServerError(f"state_dir: {state_dir}: cannot be used ({error}); choose another folder") from error
    os.environ["RAY_AUTH_TOKEN_PATH"] = str(path)


@contextmanager
def _cluster(ray: Any, replicas: int) -> Generator[None]:
    """Connect to the cluster of `RAY_ADDRESS`, or start one on this machine and stop it at the end."""
    quiet: dict[str, Any] = {"logging_level": logging.WARNING, "configure_logging": False, "namespace": APPLICATION}
    address = os.environ.get(ADDRESS_VARIABLE)
    try:
        if not address:
            ray.init(
                address="local",
                num_cpus=max(replicas + 1, 4),  # a unit is a replica; one more can be added
                object_store_memory=OBJECT_STORE_BYTES,
                include_dashboard=False,
                _system_config={"automatic_object_spilling_enabled": False},  # pictures of rooms stay off the disk
                **quiet,
            )
        else:
            ray.init(**quiet)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        advice = f"; unset {ADDRESS_VARIABLE} to start a cluster of this machine"
        failed = f"{ADDRESS_VARIABLE}: {address}: Ray cannot be reached: {error}{advice}"
        raise ServerError(failed if address else f"Ray cannot be started on this machine: {error}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _deploy(ray: Any, serve: Any, settings: ServerSettings, replicas: int) -> None:
    """Start the proxy and the replicas, or change their number; return when all are ready."""
    config = importlib.import_module("ray.serve.config")
    router = importlib.import_module("ray.serve.experimental.consistent_hash_router").ConsistentHashRouter
    schema = importlib.import_module("ray.serve.schema")
    options = config.HTTPOptions(
        host=settings.host.strip("[]"),
        port=settings.port,
        keep_alive_timeout_s=KEEP_ALIVE_S,
        ssl_certfile=_text(settings.tls_cert),
        ssl_keyfile=_text(settings.tls_key),
    )
    deployment = serve.deployment(
        serve.ingress(app_builder(settings, local=_is_local()))(),
        name=APPLICATION,
        num_replicas=replicas,
        max_ongoing_requests=settings.max_connections,  # a WebSocket counts as long as it is open
        ray_actor_options={"num_cpus": 1},
        graceful_shutdown_timeout_s=STOP_S,
        graceful_shutdown_wait_loop_s=0.1,
        health_check_period_s=2,
        request_router_config=config.RequestRouterConfig(
            request_router_class=router, request_router_kwargs={"num_fallback_replicas": 0}
        ),
        logging_config=schema.LoggingConfig(log_level="WARNING", enable_access_log=False),
    )
    # `serve.run` gives each deployment a new version, which would restart all replicas to change their number
    deployment = deployment.options(version=_version(settings), _internal=True)
    try:
        quiet = schema.LoggingConfig(log_level="WARNING")
        serve.start(http_options=options, proxy_location="EveryNode", logging_config=quiet)
        serve.run(deployment.bind(), name=APPLICATION, route_prefix="/")
    except (RuntimeError, TimeoutError, ray.exceptions.RayError) as error:
        raise ServerError(f"the replicas do not start: {error}") from error


def app_builder(settings: ServerSettings, *, local: bool) -> Callable[[], FastAPI]:
    """Return the function that makes the application in the process of a replica."""

    def build() -> FastAPI:
        from roomlight_server.replicas.replica import replica_app

        return replica_app(settings, local=local)

    return build


def _version(settings: ServerSettings) -> str:
    """Return a name that changes with the release and the settings, so that replicas are restarted for them."""
    settings_json = settings.model_copy(update={"port": 0}).model_dump_json()
    return hashlib.sha256(f"{__version__} {settings_json}".encode()).hexdigest()[:16]


def _free_port(settings: ServerSettings) -> int:
    """Return the port of the settings, or a free one in place of 0.

    Raises:
        ServerError: The server cannot listen on the address.
    """
    if os.environ.get(ADDRESS_VARIABLE):
        return settings.port or 8090
    with listen(settings) as bound:
        return bound.getsockname()[1]


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())
