"""`roomlight serve`: the session server, from flags and `ROOMLIGHT_*` environment variables."""

import logging
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Annotated, Any, Final

import typer
from annotated_types import Interval

from roomlight.engine.models.choosing import choose_graphs
from roomlight.rules import Rule
from roomlight_cli.console import err
from roomlight_cli.options import Build, CommandOptions, command_app, described
from roomlight_server.base.settings import PREFIX, ServerSettings, load_settings
from roomlight_server.base.tls import fingerprint
from roomlight_server.transport.lan import lan_options, qr_text
from roomlight_server.transport.phones import LINK_S

FLAGS: Final = {
    "Who may use it": (
        "host", "port", "token_file", "allow_origins", "allow_hosts", "tls_cert", "tls_key",
    ),
    "How to estimate the light": ("model", "weights", "parts", "provider"),
    "Limits": ("keyframes", "max_sessions", "max_probes", "idle_expiry_s", "max_body_bytes", "engine_threads"),
    "Saved sessions": ("state_dir", "state_interval_s", "state_expiry_s", "state_shared"),
    "Logs": ("log_level", "access_log"),
}  # fmt: skip
"""Settings that have a flag, by heading; the others have an environment variable only."""
_VARIABLES: Final = sorted(
    set(ServerSettings.model_fields) - {"on_lan"} - {name for names in FLAGS.values() for name in names}
)  # on_lan is what --lan sets


def _add_settings(options: CommandOptions) -> Build:
    """Add the flags of `ServerSettings`. One that is not given leaves the setting to its variable or default."""
    texts, builds = described(ServerSettings, "Attributes"), dict[str, Build]()
    for panel, names in FLAGS.items():
        for name in names:
            field = ServerSettings.model_fields[name]
            rule = Rule.of(field.annotation, field.metadata)
            builds[name] = options.add_option(
                name,
                Rule(rule.kind, optional=True, notes=rule.notes),
                texts[name],
                default=None,
                panel=panel,
                flag="--" + name.replace("_", "-"),
                show_default=str(field.default) if field.default not in (None, False, ()) else False,
            )
    return lambda values: {name: build(values) for name, build in builds.items()}


def serve(
    settings: Annotated[dict[str, Any], _add_settings],
    *,
    lan: bool = False,
    ray: bool = False,
    replicas: Annotated[int, Interval(ge=1, le=1000)] | None = None,
) -> None:
    """Serve lighting sessions over HTTP and WebSocket: frames in, light out.

    Every flag but --lan, --ray and --replicas can be set in the environment as ROOMLIGHT_NAME, for example
    ROOMLIGHT_MAX_SESSIONS; a flag wins over its variable.

    Args:
        settings: Of the server.
        lan: Serve the local network over HTTPS, with a token, and print a QR code that opens the page of a phone.
        ray: Run replicas under Ray Serve; needs --state-dir and the extra roomlight[ray].
        replicas: Number of replicas with --ray. Default: 2.
    """
    if replicas is not None and not ray:
        raise typer.BadParameter("--replicas needs --ray: without it there is one server")
    if ray:
        if lan:
            raise typer.BadParameter("--ray cannot be used with --lan; use --host, --token-file, --tls-cert, --tls-key")
        from roomlight_server.replicas.serving import serve_on_ray

        serve_on_ray(load_settings(**settings), replicas=replicas or 2, listening=_announce)
        return
    if not lan:
        local = load_settings(**settings)
        run_server(local, listening=_print_address, read_tokens=_token_reader(local, settings))
        return
    before = load_settings(**settings | {"host": None})
    lan_fields = lan_options(
        host=settings["host"],
        tokens=before.tokens,
        tls=(before.tls_cert, before.tls_key),
        folder=before.state_dir,
        allow_hosts=before.allow_hosts,
    )
    on_lan = load_settings(**settings | lan_fields)
    run_server(
        on_lan,
        listening=lambda address, phone: _print_lan(address, phone, on_lan),
        read_tokens=_token_reader(before, settings | {"host": None}),
    )


def run_server(
    settings: ServerSettings,
    *,
    listening: Callable[[str, str | None], object],
    read_tokens: Callable[[], tuple[str, ...]] | None,
) -> None:
    """Serve, as `roomlight_server.serving.serve`; the networks load while its modules are imported, 0.3 s each."""
    with ThreadPoolExecutor(1) as loader:
        graphs = loader.submit(choose_graphs, settings.session_options)
        from roomlight_server.serving import serve

        serve(settings, listening=listening, read_tokens=read_tokens, graphs=graphs)


def _token_reader(settings: ServerSettings, options: dict[str, Any]) -> Callable[[], tuple[str, ...]] | None:
    """Return what reads the tokens again at SIGHUP; None without a token file, or where a terminal sends it."""
    if settings.token_file is None:
        return None
    with suppress(OSError):
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY))
        return None
    return lambda: load_settings(**options).tokens


def _print_address(address: str, phone: str | None = None) -> None:
    """Print the address on a terminal; elsewhere all lines are the log's, which are JSON."""
    del phone
    if err.is_terminal:
        _announce(address)


def _announce(address: str) -> None:
    err.print(f"Serving on {address} (documentation at /docs); stop with Ctrl-C", soft_wrap=True, markup=False)


def _print_lan(address: str, phone: str | None, settings: ServerSettings) -> None:
    """Print addresses, the fingerprint of the certificate and the QR code for a phone (None: no more can be paired).

    Without a terminal they are logged. On a loopback address there is no code: no phone can open it.
    """
    token = settings.tokens[0]
    phone = None if settings.is_loopback else phone
    if not err.is_terminal:
        certificate = None if settings.tls_cert is None else fingerprint(settings.tls_cert)
        fields = {"url": f"{address}/#token={token}", "phone": phone, "fingerprint": certificate}
        logging.getLogger("roomlight.server").info("on this network", extra=fields)
        return
    where = "Only this computer can open it; for phones leave out --host" if settings.is_loopback else "On this network"
    lines = [f"{where}: {address}/#token={token}"]
    if phone is not None:
        err.file.write(qr_text(phone))
        lines.append(f"On a phone, once within {LINK_S / 60:g} minutes: {phone}")
        lines.append("For further phones, the page shows further codes.")
    if settings.tls_cert is not None:
        lines.append(f"Fingerprint (SHA-256) of the certificate: {fingerprint(settings.tls_cert)}")
        lines.append("A browser warns once of a certificate that no authority has signed: compare the fingerprint.")
    for line in lines:
        err.print(line, soft_wrap=True, markup=False)
    _print_address(address)


app = command_app(
    serve, epilog=f"These settings have a variable only: {', '.join(PREFIX + name.upper() for name in _VARIABLES)}."
)
