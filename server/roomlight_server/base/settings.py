"""Settings of a server: environment variables `ROOMLIGHT_*`, overridden by command-line options."""

import difflib
import math
import os
import re
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.engine.networks.providers import Provider
from roomlight.engine.options import ModelName, SessionOptions
from roomlight.engine.surface.keyframes import DEFAULT_KEYFRAMES
from roomlight.errors import OptionError, ServerError
from roomlight.threads import thread_count
from roomlight.wire.frame_message import FrameLimits, rule_text
from roomlight_server.base.tls import check_certificate
from roomlight_server.base.web_origins import checked_host, checked_origin

PREFIX: Final = "ROOMLIGHT_"
OTHER_VARIABLES: Final = ("ROOMLIGHT_THREADS", "ROOMLIGHT_FURNITURE", "ROOMLIGHT_TOKEN", "ROOMLIGHT_SERVER")
"""Variables with the same prefix that belong to the engine, the generator and clients."""
_FLAGS_ALONE: Final = ("ROOMLIGHT_LAN", "ROOMLIGHT_RAY", "ROOMLIGHT_REPLICAS")
_OF_LAN: Final = {"ROOMLIGHT_ON_LAN", "ROOMLIGHT_PHONES_FILE"}
"""Variables that `--lan` makes needless."""
_OF_LINKS: Final = re.compile(r"ROOMLIGHT_(\w+_)?(SERVICE_(HOST|PORT)|PORT_[0-9]+_|NAME$|ENV_)")
"""What Kubernetes and Docker set in containers beside those whose names begin with roomlight."""
_TOKEN_RULE: Final = (
    "a token must be 16 to 512 of the signs that a browser can send to a WebSocket, A-Z a-z 0-9 !#$%&'*+-.^_`|~; "
    "make one with: openssl rand -hex 32"
)
_LISTS: Final = ("tokens", "allow_origins", "allow_hosts")

WordList = Annotated[tuple[str, ...], NoDecode]
"""Words separated by spaces or commas in the environment, instead of JSON."""


class ServerSettings(BaseSettings):
    """Settings of a server. The field `max_sessions` is the variable `ROOMLIGHT_MAX_SESSIONS`.

    Attributes:
        host: Address to listen on. Any but loopback needs a token.
        port: Port; 0 takes any free one.
        tokens: Bearer tokens. A session belongs to the token that opened it. Without tokens: loopback only.
        token_file: File of more bearer tokens, one per line; `#` starts a comment, but not in a token. Or set
            ROOMLIGHT_TOKENS.
        allow_origins: Web origin whose pages may use the server (CORS and WebSocket), or *. Repeatable.
        allow_hosts: Name or address that the header `Host` may have. Repeatable. Default: any. Without a token
            those of loopback are allowed besides, and by default no other.
        tls_cert: Certificate chain in PEM; the server then speaks HTTPS. Default with --lan: made and kept.
        tls_key: Private key of the certificate in PEM.
        public_url: Address by which a phone reaches the server, as `https://light.example.org:8090`; `/v1/pairing`
            returns it.
        on_lan: The host is the address by which phones reach the server; listen on loopback besides.
        phones_file: File of the paired phones. Default: `phones.json` in the state directory, or with --lan beside the
            token; else they are known until the server stops.
        phone_expiry_s: Time for which the token of a paired phone is valid.
        model: Model of sessions that ask for auto.
        weights: A model folder of `roomlight export`, instead of the weights inside the package.
        parts: A folder with `clipping`, `objects` or `prior`, in place of the package's.
        provider: Where the networks run; auto: OpenVINO if it is installed and faster here, else ONNX Runtime.
        depth_model: An ONNX file that estimates the depth of frames without, instead of the network in the package.
        keyframes: Frames kept per session for probes that are requested later, 1.5 MB each.
        max_sessions: Sessions at the same time. Each holds up to 37 MB of keyframes, and a volume of 7 MB or,
            with the classical model, 30.
        max_session_bytes: Sessions whose options could exceed this are rejected.
        max_probes: Named probes per session. Each adds to the time of every frame.
        frames_in_flight: Frames per session that are being uploaded, decoded or awaited, before 429.
        idle_expiry_s: Delete a session after this many seconds without a request; with a state directory, it leaves
            memory only.
        state_dir: Folder in which sessions are saved, so that they survive a restart. Default: they are not saved.
        state_shared: Other servers use the state directory too; a session belongs to one of them at a time.
        state_interval_s: A change of a session is on disk after this many seconds at the latest.
        state_expiry_s: Erase a saved session after this many seconds without a request; only time in which a server
            runs counts, whatever its clock says.
        max_owner_state_bytes: Disk of the saved sessions of one token; beyond it no new one is opened.
        body_timeout_s: A request is refused whose body lags behind 16 KiB a second by this time.
        max_body_bytes: Largest frame in bytes.
        max_colour_pixels: Largest colour image of a frame.
        max_depth_pixels: Largest depth map of a frame.
        engine_threads: Sessions whose frames are processed at the same time. Each uses `ROOMLIGHT_THREADS` threads,
            but a part of its time only one: a second one makes 1.1 times the frames of 16 sessions on two cores.
        decode_threads: Images decoded at once. As many decoding processes are started. With several tokens, one
            thread is left for the others. Objects are decoded beside images, in as many processes more.
        encode_threads: Lights encoded at once. With several tokens, one thread is left for the others.
        log_level: Least level of the lines in the log.
        access_log: Log a line for each request.
        max_connections: Connections at once; half of the usual limit of 1,024 open files.
        max_connections_per_address: Connections at once from one address. Behind a proxy all share its address.
        max_header_bytes: Largest request line and headers. The WebSocket library limits each line to 8 KiB besides.
        header_timeout_s: Time limit for the headers of a request, and for the first request of a connection.
        send_timeout_s: A connection whose client receives nothing of its answer for this time is closed.
        max_pending_bytes: Memory of all frames being received and answers being made or sent, before 503.
        wrong_token_delay_s: Time after which a request with a wrong token is answered.
        refusal_delay_s: Time after which a request beyond a limit of its token is answered, if there are several
            tokens: a client that repeats it at once would take the event loop from the others.
        decode_timeout_s: Time limit for decoding the images of a frame; then its process is killed and the frame is
            rejected.
        max_object_file_bytes: Largest file of an uploaded object.
        max_owner_object_bytes: Memory of all objects of one token, decoded.
        max_object_bytes: Memory of all objects of all tokens, decoded.
        object_expiry_s: An object that is not used for this time is deleted.
        object_timeout_s: Time limit for decoding an object; then its process is killed and the object is rejected.
        composite_threads: Previews made at once, in different sessions; and as many other composites, in processes.
        composite_timeout_s: Time limit of a composite, its waiting included.
        max_owner_sessions: Sessions of one token. Default: all, or half of them if there are several tokens, or
            phones that pair.
        max_owner_session_bytes: Memory that the sessions of one token may reach. Default: 384 MiB for each session.
        max_owner_probes: Named probes of one token, in all sessions.
        max_owner_rows: Rows of the panoramas of these probes.
        max_owner_late_probes: Points without a named probe that are being computed or waiting for one token.
        max_owner_pending_bytes: Share of one token in `max_pending_bytes`. Default: all, or half of it if there are
            several tokens, or phones that pair.
        drain_s: Time after SIGTERM in which `/readyz` answers 503 and connections are still accepted.
        history_bytes: Memory of a session's history: pictures and light of its processed frames. 0 keeps none.
        max_recording_bytes: Largest uploaded recording.
        max_owner_recording_bytes: Uploaded recordings of one token, as announced.
        max_all_recording_bytes: Uploaded recordings of all tokens, as announced.
        recording_expiry_s: A recording that is not used for this time is deleted.
        recordings_folder: Folder in which uploads are stored until they are deleted. Default: the system's for
            temporary files.
    """

    model_config = SettingsConfigDict(frozen=True, extra="forbid", env_prefix=PREFIX)

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8090
    tokens: WordList = ()
    token_file: Path | None = None
    allow_origins: WordList = ()
    allow_hosts: WordList = ()
    tls_cert: Path | None = None
    tls_key: Path | None = None
    public_url: str | None = None
    on_lan: bool = False
    phones_file: Path | None = None
    phone_expiry_s: Annotated[float, Field(gt=0, le=1e9)] = 30 * 86_400.0
    model: ModelName = "auto"
    weights: Path | None = None
    parts: Path | None = None
    provider: Provider = "auto"
    depth_model: Path | None = None
    keyframes: Annotated[int, Field(ge=1, le=1000)] = DEFAULT_KEYFRAMES
    max_sessions: Annotated[int, Field(ge=1, le=100_000)] = 16
    max_session_bytes: Annotated[int, Field(ge=2**20)] = 640 * 2**20
    max_probes: Annotated[int, Field(ge=1, le=1024)] = 16
    frames_in_flight: Annotated[int, Field(ge=1, le=64)] = 4
    idle_expiry_s: Annotated[float, Field(gt=0, le=1e7)] = 600.0
    state_dir: Path | None = None
    state_shared: bool = False
    state_interval_s: Annotated[float, Field(ge=0.1, le=3600)] = 5.0
    state_expiry_s: Annotated[float, Field(gt=0, le=1e8)] = 86_400.0
    max_owner_state_bytes: Annotated[int, Field(ge=2**16)] = 2**33
    body_timeout_s: Annotated[float, Field(gt=0, le=3600)] = 30.0
    max_body_bytes: Annotated[int, Field(ge=2**16, le=2**30)] = FrameLimits().max_body_bytes
    max_colour_pixels: Annotated[int, Field(ge=1)] = FrameLimits().max_colour_pixels
    max_depth_pixels: Annotated[int, Field(ge=1)] = FrameLimits().max_depth_pixels
    engine_threads: Annotated[int, Field(ge=1, le=64)] = 2
    decode_threads: Annotated[int, Field(ge=1, le=64)] = 2
    encode_threads: Annotated[int, Field(ge=1, le=64)] = 2
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    access_log: bool = False
    max_connections: Annotated[int, Field(ge=1, le=100_000)] = 512
    max_connections_per_address: Annotated[int, Field(ge=1, le=100_000)] = 128
    max_header_bytes: Annotated[int, Field(ge=1024, le=2**20)] = 2**15
    header_timeout_s: Annotated[float, Field(gt=0, le=3600)] = 10.0
    send_timeout_s: Annotated[float, Field(gt=0, le=3600)] = 30.0
    max_pending_bytes: Annotated[int, Field(ge=2**27)] = 2**30
    wrong_token_delay_s: Annotated[float, Field(ge=0, le=60)] = 1.0
    refusal_delay_s: Annotated[float, Field(ge=0, le=10)] = 0.5
    decode_timeout_s: Annotated[float, Field(gt=0, le=600)] = 2.0
    max_object_file_bytes: Annotated[int, Field(ge=2**16, le=2**28)] = 32 * 2**20
    max_owner_object_bytes: Annotated[int, Field(ge=2**16)] = 256 * 2**20
    max_object_bytes: Annotated[int, Field(ge=2**16)] = 512 * 2**20
    object_expiry_s: Annotated[float, Field(gt=0, le=1e7)] = 3600.0
    object_timeout_s: Annotated[float, Field(gt=0, le=600)] = 20.0
    composite_threads: Annotated[int, Field(ge=1, le=64)] = 1
    composite_timeout_s: Annotated[float, Field(gt=0, le=3600)] = 120.0
    max_owner_sessions: Annotated[int | None, Field(ge=1)] = None
    max_owner_session_bytes: Annotated[int | None, Field(ge=2**20)] = None
    max_owner_probes: Annotated[int, Field(ge=1)] = 256
    max_owner_rows: Annotated[int, Field(ge=8)] = 2**15
    max_owner_late_probes: Annotated[int, Field(ge=1)] = 128
    max_owner_pending_bytes: Annotated[int | None, Field(ge=2**26)] = None
    drain_s: Annotated[float, Field(ge=0, le=60)] = 1.0
    history_bytes: Annotated[int, Field(ge=0, le=2**30)] = 16 * 2**20
    max_recording_bytes: Annotated[int, Field(ge=2**10)] = 2**30
    max_owner_recording_bytes: Annotated[int, Field(ge=2**10)] = 2**31
    max_all_recording_bytes: Annotated[int, Field(ge=2**10)] = 2**32
    recording_expiry_s: Annotated[float, Field(gt=0, le=1e7)] = 3600.0
    recordings_folder: Path | None = None

    @model_validator(mode="before")
    @classmethod
    def _prepare(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Strip spaces, drop blank values (they count as unset), split lists, add the tokens of the token file."""
        stripped = {name: value.strip() if isinstance(value, str) else value for name, value in values.items()}
        prepared = {name: value for name, value in stripped.items() if value != ""}
        for name in _LISTS:
            if isinstance(prepared.get(name), str):
                prepared[name] = tuple(prepared[name].replace(",", " ").split())
        if "token_file" in prepared:
            prepared["tokens"] = (*prepared.get("tokens", ()), *_read_tokens(Path(prepared["token_file"])))
        return prepared

    @field_validator("host")
    @classmethod
    def _check_host(cls, host: str) -> str:
        if "/" in host or re.fullmatch(r"[^:]*:\d*|\[.*\]:\d*", host):
            raise ValueError("give a name or an address, without scheme and path; --port has the port")
        return host.lower()

    @field_validator("tokens")
    @classmethod
    def _check_tokens(cls, tokens: tuple[str, ...]) -> tuple[str, ...]:
        for token in tokens:
            if not _is_token(token):
                raise ValueError(_TOKEN_RULE)
        return tuple(dict.fromkeys(tokens))

    @field_validator("allow_origins")
    @classmethod
    def _check_origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(map(checked_origin, origins))

    @field_validator("allow_hosts")
    @classmethod
    def _check_hosts(cls, hosts: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(map(checked_host, hosts))

    @field_validator("public_url")
    @classmethod
    def _check_public_url(cls, url: str | None) -> str | None:
        if url is None:
            return None
        if url.partition("://")[0].lower() not in ("http", "https"):
            raise ValueError("must begin with https:// or http://, as https://light.example.org")
        return checked_origin(url)

    @property
    def session_options(self) -> SessionOptions:
        """Options of the engine on which those of each session are based."""
        return SessionOptions(
            model=self.model,
            weights=self.weights,
            parts=self.parts,
            provider=self.provider,
            keyframes=self.keyframes,
        )

    @property
    def session_expiry_s(self) -> float:
        """Time without requests after which a session can no longer be used."""
        return self.idle_expiry_s if self.state_dir is None else max(self.idle_expiry_s, self.state_expiry_s)

    @property
    def frame_limits(self) -> FrameLimits:
        """Largest frame accepted."""
        return FrameLimits(self.max_body_bytes, self.max_colour_pixels, self.max_depth_pixels)

    @property
    def several_owners(self) -> bool:
        """Whether several tokens share the server: those of the settings, or of phones that pair with one."""
        return len(self.tokens) > 1 or self.on_lan or (bool(self.tokens) and self.public_url is not None)

    @property
    def owner_sessions(self) -> int:
        """Sessions of one token."""
        half = math.ceil(self.max_sessions / 2) if self.several_owners else self.max_sessions
        return self.max_owner_sessions or half

    @property
    def owner_session_bytes(self) -> int:
        """Memory that the sessions of one token may reach."""
        return self.max_owner_session_bytes or max(self.max_session_bytes, self.owner_sessions * 384 * 2**20)

    @property
    def owner_pending_bytes(self) -> int:
        """Memory of the frames and answers of one token in progress."""
        half = self.max_pending_bytes // 2 if self.several_owners else self.max_pending_bytes
        return self.max_owner_pending_bytes or half

    @property
    def owner_refusal_delay_s(self) -> float:
        """Time after which a request beyond a limit of its token is answered; 0 if there is no other token."""
        return self.refusal_delay_s if self.several_owners else 0.0

    @property
    def object_limits(self) -> ObjectLimits:
        """Largest object accepted: half the library's, because many clients share the memory."""
        return ObjectLimits(
            file_bytes=self.max_object_file_bytes,
            triangles=500_000,
            vertices=750_000,
            images=16,
            total_pixels=4096 * 4096,
        )

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the address."""
        try:
            address = ip_address(self.host.strip("[]"))
            return (getattr(address, "ipv4_mapped", None) or address).is_loopback
        except ValueError:
            return self.host == "localhost"


def load_settings(**options: Any) -> ServerSettings:
    """Load settings from options (None or empty: not given), the environment and the token file, in this order.

    Raises:
        ServerError: A value is invalid, an environment variable `ROOMLIGHT_*` is unknown, the token file cannot be
            read, the certificate cannot be used, there is no state directory to share, or the address is not loopback
            and there is no token.
    """
    given = {name: value for name, value in options.items() if value not in (None, ())}
    _check_variables(given)
    try:
        settings = ServerSettings(**given)
    except ValidationError as error:
        raise ServerError(_describe(error, given)) from None
    if not settings.tokens and not settings.is_loopback:
        raise ServerError(
            f"host {settings.host} can be reached from other machines, but there is no token: anyone could use the "
            f"server and see the room; set {PREFIX}TOKENS or --token-file, or use the host 127.0.0.1"
        )
    if settings.state_shared and settings.state_dir is None:
        raise ServerError(f"state_shared: there is no directory to share; set {PREFIX}STATE_DIR or --state-dir too")
    if settings.tls_cert is not None:
        check_certificate(settings.tls_cert, settings.tls_key)
    elif settings.tls_key is not None:
        raise ServerError(f"tls_key: {settings.tls_key} needs a certificate; set {PREFIX}TLS_CERT or --tls-cert too")
    return settings


def _check_variables(given: dict[str, Any]) -> None:
    known = {PREFIX + name.upper() for name in ServerSettings.model_fields}
    for name in sorted(os.environ):
        linked = _OF_LINKS.match(name) or (name.endswith("_PORT") and "://" in os.environ[name])
        if name.startswith(PREFIX) and name not in known | set(OTHER_VARIABLES) and not linked:
            near = difflib.get_close_matches(name, sorted(known - _OF_LAN), n=1, cutoff=0.8)
            advice = f"the nearest known one is {near[0]}" if near else "roomlight serve --help names those that exist"
            if name in _FLAGS_ALONE:
                advice = f"there is only the flag --{name.removeprefix(PREFIX).lower()}"
            raise ServerError(f"{name}: unknown environment variable; {advice}")
    if "port" not in given and os.environ.get(PREFIX + "PORT", "").startswith("tcp://"):
        raise ServerError(
            f"{PREFIX}PORT is {os.environ[PREFIX + 'PORT'][:100]}, which Kubernetes sets for a Service of the name "
            "roomlight; set enableServiceLinks: false in the pod, or name the Service otherwise"
        )
    try:
        thread_count()
    except OptionError as error:
        raise ServerError(str(error)) from error


def _describe(error: ValidationError, given: dict[str, Any]) -> str:
    """Return one line that names the option or variable, the value and the rule; values of tokens are left out."""
    first = error.errors(include_url=False, include_context=False)[0]
    name = str(first["loc"][0])
    source = f"--{name.replace('_', '-')}" if name in given else PREFIX + name.upper()
    if name == "tokens":  # secret: the value stays out of the message
        return f"{PREFIX}TOKENS or the token file: {rule_text(first['msg'])}"
    return f"{source}: {ascii(first['input'])[:100]}: {rule_text(first['msg'])}"


def _is_token(token: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9!#$%&'*+.^_`|~-]{16,512}", token) is not None


def _read_tokens(path: Path) -> list[str]:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ServerError(f"{path}: cannot read the token file ({error})") from error
    tokens = [re.sub(r"(^|\s)#.*", "", line).strip() for line in lines]
    if not any(tokens):
        raise ServerError(f"{path}: the token file contains no token; write one per line, 16 characters or more")
    for number, token in enumerate(tokens, 1):
        if token and not _is_token(token):
            raise ServerError(f"{path}, line {number}: {_TOKEN_RULE}")
    return [token for token in tokens if token]
