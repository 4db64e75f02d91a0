"""What a server may be told: by `ROOMLIGHT_*` in the environment, and by flags, which go before it."""

from collections.abc import Mapping
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from roomlight.engine.keyframes import DEFAULT_KEYFRAMES
from roomlight.engine.providers import Provider
from roomlight.engine.session import ModelName
from roomlight.errors import ServerError
from roomlight.wire.frame_message import FrameLimits

PREFIX: Final = "ROOMLIGHT_"
_LISTS: Final = ("tokens", "allow_origins")


class ServerSettings(BaseModel):
    """Everything about a server; the field `max_sessions` is `ROOMLIGHT_MAX_SESSIONS` and `--max-sessions`.

    tokens:          bearer tokens; sessions belong to the token that made them. None: loopback only.
    token_file:      more tokens, one a line; `#` begins a comment.
    allow_origins:   web origins whose pages may use the server (CORS and WebSocket), or `*`.
    model, weights, provider, allow_untrained: what `mode: auto` means, and where weights come from.
    max_sessions:    each holds up to 130 MB of keyframes and 20 MB of volume with the default options.
    max_session_bytes: sessions whose options could come to more are refused.
    max_probes:      named probes of one session: each takes its share of every frame.
    frames_in_flight: of one session, being uploaded, decoded or awaited, before 429.
    idle_expiry_s:   a session without a request for so long is deleted.
    body_timeout_s:  a request's body must have arrived by then.
    engine_threads:  sessions whose frames are worked on at once; each already spreads its work over
                     `ROOMLIGHT_THREADS`, so more than 1 trades a frame's latency for less waiting.
    decode_threads:  images decoded, and light encoded, at once.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8090
    tokens: tuple[str, ...] = ()
    token_file: Path | None = None
    allow_origins: tuple[str, ...] = ()
    model: ModelName = "auto"
    weights: Path | None = None
    provider: Provider = "auto"
    allow_untrained: bool = False
    keyframes: Annotated[int, Field(ge=1, le=1000)] = DEFAULT_KEYFRAMES
    max_sessions: Annotated[int, Field(ge=1, le=100_000)] = 16
    max_session_bytes: Annotated[int, Field(ge=2**20)] = 512 * 2**20
    max_probes: Annotated[int, Field(ge=1, le=1024)] = 16
    frames_in_flight: Annotated[int, Field(ge=1, le=64)] = 4
    idle_expiry_s: Annotated[float, Field(gt=0, le=1e7)] = 600.0
    body_timeout_s: Annotated[float, Field(gt=0, le=3600)] = 30.0
    max_body_bytes: Annotated[int, Field(ge=2**16, le=2**30)] = FrameLimits().max_body_bytes
    max_colour_pixels: Annotated[int, Field(ge=1)] = FrameLimits().max_colour_pixels
    max_depth_pixels: Annotated[int, Field(ge=1)] = FrameLimits().max_depth_pixels
    engine_threads: Annotated[int, Field(ge=1, le=64)] = 1
    decode_threads: Annotated[int, Field(ge=1, le=64)] = 2
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    access_log: bool = False

    @model_validator(mode="after")
    def _tokens_are_tokens(self) -> "ServerSettings":
        for token in self.tokens:
            if not 16 <= len(token) <= 512 or not token.isascii() or not token.isprintable() or " " in token:
                raise ValueError("a token is 16 to 512 printable ASCII characters without spaces")
        return self

    @property
    def frame_limits(self) -> FrameLimits:
        """What a frame may be at most."""
        return FrameLimits(self.max_body_bytes, self.max_colour_pixels, self.max_depth_pixels)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the address."""
        try:
            return ip_address(self.host.strip("[]")).is_loopback
        except ValueError:
            return self.host == "localhost"


def load_settings(environment: Mapping[str, str], **flags: Any) -> ServerSettings:
    """Settings from `ROOMLIGHT_*` and flags (None: not given), with the tokens of the token file.

    Raises ServerError: for a value that is none, a token file that cannot be read, and for an address beyond
    loopback without a token.
    """
    given: dict[str, Any] = {}
    for name in ServerSettings.model_fields:
        text = environment.get(PREFIX + name.upper(), "").strip()
        if text:
            given[name] = tuple(text.replace(",", " ").split()) if name in _LISTS else text
    given |= {name: value for name, value in flags.items() if value not in (None, ())}
    if "token_file" in given:
        given["tokens"] = (*given.get("tokens", ()), *_tokens_in(Path(given["token_file"])))
    try:
        settings = ServerSettings(**given)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        name = str(first["loc"][0]) if first["loc"] else "tokens"
        raise ServerError(f"{name} ({PREFIX}{name.upper()} or --{name.replace('_', '-')}): {first['msg']}") from None
    if not settings.tokens and not settings.is_loopback:
        raise ServerError(
            f"--host {settings.host} can be reached from other machines, and there is no token: anyone could use the "
            f"server and see the room. Give {PREFIX}TOKENS or --token-file, or stay on --host 127.0.0.1"
        )
    return settings


def _tokens_in(path: Path) -> list[str]:
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ServerError(f"{path}: the token file cannot be read ({error})") from error
    tokens = [line.partition("#")[0].strip() for line in lines]
    if not any(tokens):
        raise ServerError(f"{path}: the token file holds no token; one a line, 16 characters or more")
    return [token for token in tokens if token]
