"""`roomlight serve`: the session server, from flags and `ROOMLIGHT_*` environment variables."""

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from roomlight_cli import arguments
from roomlight_cli.console import err
from roomlight_cli.lazy import single_command_app
from roomlight_server.base.settings import ServerSettings, load_settings
from roomlight_server.base.tls import fingerprint
from roomlight_server.replicas.serving import serve_on_ray
from roomlight_server.serving import serve as run_server
from roomlight_server.transport.lan import lan_options, phone_url, qr_text

app = single_command_app()

_ACCESS: Final = "Who may use it"
_LIMITS: Final = "Limits"
_LOGS: Final = "Logs"
_STATE: Final = "Saved sessions"
_REPLICAS: Final = "More than one server"


def _flag(panel: str, text: str, *names: str, **bounds: Any) -> Any:
    """Declare an option without a default: the environment variable or the server's default applies."""
    return typer.Option(*names, rich_help_panel=panel, help=text, show_default=False, **bounds)


@app.command()
def serve(
    host: Annotated[
        str | None, _flag(_ACCESS, "Address to listen on (default: 127.0.0.1). Any other needs a token.")
    ] = None,
    port: Annotated[int | None, _flag(_ACCESS, "Port (default: 8090); 0 takes any free one.", min=0, max=65535)] = None,
    token_file: Annotated[
        Path | None, _flag(_ACCESS, "File of bearer tokens, one per line. Or set ROOMLIGHT_TOKENS.")
    ] = None,
    allow_origins: Annotated[
        list[str] | None, _flag(_ACCESS, "Web origin whose pages may use the server, or *. Repeatable.")
    ] = None,
    allow_hosts: Annotated[
        list[str] | None,
        _flag(_ACCESS, "Name of this server; others are refused (default with a token: any). Repeatable."),
    ] = None,
    lan: Annotated[
        bool,
        _flag(
            _ACCESS,
            "Serve the local network over HTTPS, with a token, and print a QR code that opens the page of a phone.",
            "--lan",
        ),
    ] = False,
    tls_cert: Annotated[
        Path | None, _flag(_ACCESS, "Certificate chain in PEM, for HTTPS (default with --lan: made and kept).")
    ] = None,
    tls_key: Annotated[Path | None, _flag(_ACCESS, "Private key of the certificate in PEM.")] = None,
    model: Annotated[
        str | None,
        _flag(
            arguments.MODEL_PANEL,
            "Model of sessions that ask for auto: auto, classical, single or video (default: auto).",
        ),
    ] = None,
    weights: arguments.Weights = None,
    provider: Annotated[
        str | None, _flag(arguments.MODEL_PANEL, "Where networks run: auto, cpu or openvino (default: auto).")
    ] = None,
    keyframes: Annotated[
        int | None, _flag(_LIMITS, "Frames kept per session for probes added later (default: 24), 5.4 MB each.")
    ] = None,
    max_sessions: Annotated[int | None, _flag(_LIMITS, "Sessions at the same time (default: 16).")] = None,
    max_probes: Annotated[int | None, _flag(_LIMITS, "Named probes per session (default: 16).")] = None,
    idle_expiry_s: Annotated[
        float | None, _flag(_LIMITS, "Delete a session after this many seconds without a request (default: 600).")
    ] = None,
    state_dir: Annotated[
        Path | None,
        _flag(_STATE, "Folder in which sessions are saved, so that they survive a restart (default: none)."),
    ] = None,
    state_interval_s: Annotated[
        float | None, _flag(_STATE, "A change is on disk after this many seconds at the latest (default: 5).")
    ] = None,
    state_expiry_s: Annotated[
        float | None,
        _flag(_STATE, "Erase a saved session after this many seconds without a request (default: 86400, a day)."),
    ] = None,
    state_shared: Annotated[
        bool,
        _flag(
            _REPLICAS,
            "Other servers use --state-dir too; a session belongs to one of them at a time.",
            "--state-shared",
        ),
    ] = False,
    ray: Annotated[
        bool,
        _flag(_REPLICAS, "Run replicas under Ray Serve; needs --state-dir and the extra roomlight[ray].", "--ray"),
    ] = False,
    replicas: Annotated[int, _flag(_REPLICAS, "Number of replicas with --ray (default: 2).", min=1, max=1000)] = 2,
    max_body_bytes: Annotated[int | None, _flag(_LIMITS, "Largest frame in bytes (default: 16 MiB).")] = None,
    engine_threads: Annotated[
        int | None, _flag(_LIMITS, "Sessions whose frames are processed at the same time (default: 1).")
    ] = None,
    log_level: Annotated[str | None, _flag(_LOGS, "debug, info, warning or error (default: info).")] = None,
    access_log: Annotated[bool, _flag(_LOGS, "Log a line for each request.", "--access-log")] = False,
) -> None:
    """Serve lighting sessions over HTTP and WebSocket: frames in, light out.

    Every flag can be set in the environment as ROOMLIGHT_NAME, for example ROOMLIGHT_MAX_SESSIONS; a flag wins over
    its variable. These settings have a variable only: max_session_bytes, frames_in_flight, body_timeout_s,
    max_colour_pixels, max_depth_pixels, decode_threads, decode_timeout_s, max_connections,
    max_connections_per_address, max_header_bytes, header_timeout_s, send_timeout_s, max_pending_bytes,
    wrong_token_delay_s, max_object_file_bytes, max_owner_object_bytes, max_object_bytes, object_expiry_s,
    object_timeout_s, composite_threads, encode_threads, max_owner_sessions, max_owner_session_bytes, max_owner_probes,
    max_owner_rows, max_owner_late_probes, max_owner_pending_bytes, drain_s, public_url, on_lan, history_bytes,
    max_recording_bytes, max_owner_recording_bytes, max_all_recording_bytes, recording_expiry_s and recordings_folder.
    """
    options: dict[str, Any] = {
        "host": host,
        "port": port,
        "token_file": token_file,
        "allow_origins": tuple(allow_origins or ()),
        "model": model,
        "weights": weights,
        "provider": provider,
        "keyframes": keyframes,
        "max_sessions": max_sessions,
        "max_probes": max_probes,
        "idle_expiry_s": idle_expiry_s,
        "state_dir": state_dir,
        "state_shared": state_shared or None,
        "state_interval_s": state_interval_s,
        "state_expiry_s": state_expiry_s,
        "max_body_bytes": max_body_bytes,
        "engine_threads": engine_threads,
        "log_level": log_level,
        "access_log": access_log or None,
        "allow_hosts": tuple(allow_hosts or ()),
        "tls_cert": tls_cert,
        "tls_key": tls_key,
    }
    if ray:
        if lan:
            raise typer.BadParameter("--ray cannot be used with --lan; use --host, --token-file, --tls-cert, --tls-key")
        serve_on_ray(load_settings(**options), replicas=replicas, listening=_print_address)
        return
    if not lan:
        run_server(load_settings(**options), listening=_print_address)
        return
    before = load_settings(**options | {"host": None})
    found = lan_options(
        host=host,
        tokens=before.tokens,
        tls=(before.tls_cert, before.tls_key),
        folder=before.state_dir,
        allow_hosts=before.allow_hosts,
    )
    settings = load_settings(**options | found)
    run_server(settings, listening=lambda address: _print_lan(address, settings))


def _print_address(address: str) -> None:
    err.print(f"Serving on {address} (documentation at /docs); stop with Ctrl-C", soft_wrap=True, markup=False)


def _print_lan(address: str, settings: ServerSettings) -> None:
    """Print the addresses, the fingerprint of the certificate, and on a terminal the QR code for a phone."""
    token = settings.tokens[0]
    phone = phone_url(address, token)
    if err.is_terminal:
        err.file.write(qr_text(phone))
    lines = [f"On this network: {address}/#token={token}", f"On a phone: {phone}"]
    if settings.tls_cert is not None:
        lines.append(f"Fingerprint (SHA-256) of the certificate: {fingerprint(settings.tls_cert)}")
        lines.append("A browser warns once of a certificate that no authority has signed: compare the fingerprint.")
    for line in lines:
        err.print(line, soft_wrap=True, markup=False)
    _print_address(address)
