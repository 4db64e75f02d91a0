"""`roomlight serve`: the session server, from flags and `ROOMLIGHT_*`. Registered by `cli`."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from roomlight_cli import arguments as given
from roomlight_cli.console import err

_LIMITS = "Limits"
_ACCESS = "Who may use it"


def _flag(kind: str, text: str, **bounds: Any) -> Any:
    return typer.Option(rich_help_panel=kind, help=text, show_default=False, **bounds)


def serve(
    host: Annotated[str | None, _flag(_ACCESS, "Address to listen on [127.0.0.1]; others need a token.")] = None,
    port: Annotated[int | None, _flag(_ACCESS, "Port [8090]; 0: any that is free.", min=0, max=65535)] = None,
    token_file: Annotated[Path | None, _flag(_ACCESS, "Bearer tokens, one a line; or ROOMLIGHT_TOKENS.")] = None,
    allow_origins: Annotated[
        list[str] | None, _flag(_ACCESS, "Web origin whose pages may use the server; repeatable.")
    ] = None,
    model: Annotated[str | None, _flag("How to estimate the light", "What `mode: auto` means [auto].")] = None,
    weights: given.Weights = None,
    provider: Annotated[
        str | None, _flag("How to estimate the light", "Where networks run: auto, cpu, openvino.")
    ] = None,
    allow_untrained: given.AllowUntrained = False,
    keyframes: Annotated[int | None, _flag(_LIMITS, "Frames kept for probes asked late [24], 5.4 MB each.")] = None,
    max_sessions: Annotated[int | None, _flag(_LIMITS, "Sessions at once [16].")] = None,
    max_probes: Annotated[int | None, _flag(_LIMITS, "Named probes of a session [16].")] = None,
    idle_expiry_s: Annotated[float | None, _flag(_LIMITS, "Seconds until an idle session is deleted [600].")] = None,
    max_body_bytes: Annotated[int | None, _flag(_LIMITS, "Largest frame [16 MiB].")] = None,
    engine_threads: Annotated[int | None, _flag(_LIMITS, "Sessions worked on at once [1].")] = None,
    log_level: Annotated[str | None, _flag("Logs", "debug, info [default], warning or error.")] = None,
    access_log: Annotated[bool, _flag("Logs", "A line for each request.")] = False,
) -> None:
    """Serve sessions over HTTP and WebSocket: frames in, light out.

    Every flag is also ROOMLIGHT_NAME in the environment, as are max_session_bytes, frames_in_flight, body_timeout_s,
    max_colour_pixels, max_depth_pixels and decode_threads.
    """
    from roomlight_server.serving import serve as run_server
    from roomlight_server.settings import load_settings

    settings = load_settings(
        os.environ,
        host=host,
        port=port,
        token_file=token_file,
        allow_origins=tuple(allow_origins or ()),
        model=model,
        weights=weights,
        provider=provider,
        allow_untrained=allow_untrained or None,
        keyframes=keyframes,
        max_sessions=max_sessions,
        max_probes=max_probes,
        idle_expiry_s=idle_expiry_s,
        max_body_bytes=max_body_bytes,
        engine_threads=engine_threads,
        log_level=log_level,
        access_log=access_log or None,
    )
    run_server(settings, listening=_tell)


def _tell(address: str) -> None:
    err.print(f"Serving on {address} (documentation at /docs); stop with Ctrl-C", soft_wrap=True)
