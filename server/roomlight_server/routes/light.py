"""Routes for light: at one point with an ETag, at many points in one call, at named probes."""

from collections.abc import Sequence
from typing import Annotated, Any, Final

from fastapi import APIRouter, Body, Depends, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import ValidationError

from roomlight.light.light import Light
from roomlight.wire.frame_message import to_wire_error
from roomlight.wire.light_message import MEDIA_TYPE, light_head, with_data
from roomlight.wire.messages import (
    HarmonicsBasis,
    HarmonicsKind,
    LightForm,
    LightFormat,
    LightRequest,
    LightResponse,
    LightUse,
    ProbeBody,
    ProbeLight,
    ProbeQuery,
)
from roomlight_server.answers.light_forms import (
    MEDIA_TYPES,
    LightPayload,
    encode,
    encode_all,
    entry_of,
    grouped_forms,
    http_etag,
    max_bytes,
)
from roomlight_server.answers.parts_response import PartsResponse
from roomlight_server.base.problems import BODY_PROBLEMS, SESSION_PROBLEMS, ProblemError, documented
from roomlight_server.routes.context import ContextDep, ProbeName, ReservationDep, SessionDep
from roomlight_server.routes.etags import unchanged
from roomlight_server.sessions.live_session import LiveSession
from roomlight_server.transport.disconnects import until_gone
from roomlight_server.work.workers import Workers

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["light"])
COVERAGE_HEADER: Final = "Roomlight-Coverage"
FRAME_HEADER: Final = "Roomlight-Frame"
MAX_ANSWER_BYTES: Final = 64 * 2**20
"""Largest answer: 64 probes with a cube map of 128 pixels each."""
_NUMBER: Final = {"type": "number"}
_VECTOR: Final = {"type": "array", "items": _NUMBER, "minItems": 3, "maxItems": 3}


def _fields(description: str, **fields: Any) -> dict[str, Any]:
    return {"type": "object", "description": description, "properties": fields, "required": list(fields)}


_SOURCE: Final[dict[str, Any]] = {
    "direction": _VECTOR,
    "intensity": _VECTOR,
    "radius_deg": _NUMBER,
    "shadow_strength": _NUMBER,
    "emitted": _NUMBER,
    "number": {"type": "integer"},
}
_EXAMPLE: Final[dict[str, Any]] = {
    "direction": [0.0, 1.0, 0.0],
    "intensity": [2.1, 2.0, 1.8],
    "radius_deg": 6.0,
    "shadow_strength": 0.7,
    "emitted": 1.0,
    "number": 0,
}
_VALUES: Final[dict[str, Any]] = {
    "anyOf": [
        _fields(
            "`sh`",
            coefficients={"type": "array", "items": _NUMBER, "minItems": 27, "maxItems": 27},
            layout={"enum": ["interleaved", "planar"]},
            phase={"enum": ["condon-shortley", "positive"]},
            quantity={"enum": ["radiance", "irradiance"]},
            kind={"enum": ["total", "ambient"]},
            coverage=_NUMBER,
        ),
        _fields(
            "`main_light`",
            **_SOURCE,
            lights={"type": "array", "items": _fields("The strongest first", **_SOURCE)},
            coverage=_NUMBER,
        ),
    ]
}
_PROBE_RESPONSES: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "description": "The light in the media type of the format",
        "headers": {
            "ETag": {"description": "Changes if and only if the light changes", "schema": {"type": "string"}},
            COVERAGE_HEADER: {
                "description": "Observed fraction of the sphere, 0 to 1",
                "schema": {"type": "number"},
            },
            FRAME_HEADER: {
                "description": "Index of the last processed frame; -1 before the first: the default light",
                "schema": {"type": "integer"},
            },
        },
        "content": {kind: {} for kind in sorted(set(MEDIA_TYPES.values()) - {"application/json"})}
        | {
            "application/json": {
                "schema": _VALUES,
                "example": _EXAMPLE | {"coverage": 0.42, "lights": [_EXAMPLE]},
            }
        },
    },
    304: {"description": "The light is unchanged: `If-None-Match` names its ETag"},
}
_BATCH: Final[dict[str, Any]] = {
    "two": {
        "summary": "A point and a named probe, as numbers for shading and a cube map for reflections",
        "value": {
            "probes": [{"position": [0.2, -0.1, -1.5]}, {"name": "table"}],
            "forms": [{"format": "sh"}, {"format": "main_light"}, {"format": "cube", "size": 32}],
        },
    }
}
_Metres = Annotated[float, Query(ge=-1000, le=1000, allow_inf_nan=False, description="World coordinate in metres.")]


async def _form(
    format: Annotated[LightFormat, Query()] = "exr",
    size: Annotated[int | None, Query(ge=8, le=512, description="Panorama height, or width of a cube face.")] = None,
    kind: HarmonicsKind = "total",
    basis: HarmonicsBasis = "arcore",
    exposure_ev: Annotated[
        float, Query(ge=-16, le=16, allow_inf_nan=False, description="png: radiance 2^-ev is white.")
    ] = 0.0,
    use: Annotated[
        LightUse | None,
        Query(description="Lights a thing, or is seen in a mirror; default: reflection for png, else lighting."),
    ] = None,
) -> LightForm:
    try:
        return LightForm(format=format, size=size, kind=kind, basis=basis, exposure_ev=exposure_ev, use=use)
    except ValidationError as error:
        raise ProblemError.from_wire(to_wire_error(error, kind="invalid")) from error


_FormDep = Annotated[LightForm, Depends(_form)]


@router.get(
    "/probe",
    summary="Light at a point",
    response_class=Response,
    responses=_PROBE_RESPONSES | documented(*SESSION_PROBLEMS, "owner-busy", "engine-failed", "server-busy"),
)
async def probe(
    live: SessionDep,
    context: ContextDep,
    reservation: ReservationDep,
    request: Request,
    x: _Metres,
    y: _Metres,
    z: _Metres,
    form: _FormDep,
) -> Response:
    """Return the light at any position, computed from the keyframes of the session.

    Before the first frame this is the default light: grey, brighter from above, coverage 0, frame -1.
    """
    reservation.add(memory_of(live, 1, max_bytes(form, live.request.height)))
    answer = _answer_probe(live, context.workers, request, ProbeQuery(position=[x, y, z]), form)
    return await until_gone(request, answer)


@router.get(
    "/probes/{name}",
    summary="Light at a named probe",
    response_class=Response,
    responses=_PROBE_RESPONSES | documented(*SESSION_PROBLEMS, "probe-not-found", "owner-busy", "server-busy"),
)
async def named_probe(
    live: SessionDep,
    context: ContextDep,
    reservation: ReservationDep,
    name: ProbeName,
    request: Request,
    form: _FormDep,
) -> Response:
    """Return the light at a named probe. It is updated with every frame, so this is the best light, without delay."""
    reservation.add(memory_of(live, 1, max_bytes(form, live.request.height)))
    return await until_gone(request, _answer_probe(live, context.workers, request, ProbeQuery(name=name), form))


@router.put(
    "/probes/{name}",
    summary="Track a named probe",
    responses={201: {"model": ProbeBody, "description": "A new probe is tracked"}}
    | documented(*BODY_PROBLEMS, *SESSION_PROBLEMS, "too-many-probes", "engine-failed"),
)
async def put_probe(
    live: SessionDep,
    name: ProbeName,
    body: Annotated[ProbeBody, Body(openapi_examples={"table": {"value": {"position": [0.2, -0.1, -1.5]}}})],
    response: Response,
) -> ProbeBody:
    """Track a probe under a name, ideally before the first frame; an existing name moves to the new position."""
    response.status_code = 201 if await live.lighting.track(name, body.position) else 200
    return body


@router.delete(
    "/probes/{name}",
    summary="Stop tracking a named probe",
    status_code=204,
    responses=documented(*SESSION_PROBLEMS, "probe-not-found"),
)
async def delete_probe(live: SessionDep, name: ProbeName) -> None:
    """Stop tracking a named probe."""
    await live.lighting.untrack(name)


@router.post(
    "/probes",
    summary="Light at many points",
    response_model=LightResponse,
    responses={200: {"description": "The light in the order of the request", "content": {MEDIA_TYPE: {}}}}
    | documented(*(*BODY_PROBLEMS, *SESSION_PROBLEMS, "probe-not-found", "owner-busy", "engine-failed", "server-busy")),
)
async def probes(
    live: SessionDep,
    context: ContextDep,
    reservation: ReservationDep,
    body: Annotated[LightRequest, Body(openapi_examples=_BATCH)],
    request: Request,
) -> Response:
    """Return the light at many points after the same frame, each in every form, as JSON or (by `Accept`) binary."""
    binary = MEDIA_TYPE in request.headers.get("accept", "")
    size = answer_bytes(len(body.probes), body.forms, live.request.height, base64=not binary)
    check_size(size)
    reservation.add(memory_of(live, len(body.probes), size))
    with context.metrics.light_seconds.time():
        answer = await until_gone(request, _answer_many(live, context.workers, body, binary=binary))
    if isinstance(answer, PartsResponse):
        reservation.keep(answer.size)  # what the client has not read yet is counted besides
    return answer


async def _answer_many(live: LiveSession, workers: Workers, body: LightRequest, *, binary: bool) -> Response:
    lights = await live.lighting.at(body.probes)
    results, parts = await encode_lights(workers, lights, body.forms)
    response = LightResponse(frame=lights[0].frame, results=results)
    if binary:
        return PartsResponse([light_head(response), *parts], MEDIA_TYPE)
    text = await workers.run_in_encode_pool(_to_json, response, parts)
    return Response(text, media_type="application/json")


def answer_bytes(probes: int, forms: Sequence[LightForm], height: int, *, base64: bool = False) -> int:
    """Return an upper bound of an answer's size, for a session whose panoramas have this height in pixels."""
    size = probes * sum(max_bytes(form, height) for form in forms)
    return size * 4 // 3 if base64 else size


def check_size(size: int) -> None:
    """Check that an answer of this size in bytes may be sent.

    Raises:
        ProblemError: The size exceeds `MAX_ANSWER_BYTES` (422).
    """
    if size > MAX_ANSWER_BYTES:
        rule = f"at most {MAX_ANSWER_BYTES} bytes per answer; request fewer probes, forms or pixels"
        detail = f"the answer could have {size} bytes: {rule}"
        raise ProblemError("invalid", detail, field="forms", value=size, rule=rule)


def memory_of(live: LiveSession, probes: int, size: int) -> int:
    """Return the memory that an answer of `size` bytes takes while it is made: panoramas, parts, and joined bytes."""
    return probes * live.lighting.light_bytes + 2 * size


async def encode_lights(
    workers: Workers, lights: list[Light], forms: list[LightForm]
) -> tuple[list[ProbeLight], list[bytes]]:
    """Encode every light in every form; return the entries of a response, and the data of binary forms in order.

    Forms of large cube maps take up to a second each, so each waits for a thread of its own. All others of a light are
    encoded in one turn.
    """
    results: list[ProbeLight] = []
    parts: list[bytes] = []
    for light in lights:
        payloads: list[LightPayload] = []
        for group in grouped_forms(forms):
            payloads += await workers.run_in_encode_pool(encode_all, light, group)
        results.append(entry_of(light, payloads))
        parts += [payload.data for payload in payloads if payload.data is not None]
    return results, parts


async def _answer_probe(
    live: LiveSession, workers: Workers, request: Request, query: ProbeQuery, form: LightForm
) -> Response:
    light = (await live.lighting.at([query]))[0]
    headers = {
        "ETag": http_etag(light, form),
        COVERAGE_HEADER: f"{light.coverage:.4f}",
        FRAME_HEADER: str(light.frame),
    }
    if same := unchanged(request, headers):
        return same
    payload = await workers.run_in_encode_pool(encode, light, form)
    if payload.data is not None:
        return Response(payload.data, media_type=MEDIA_TYPES[form.format], headers=headers)
    return JSONResponse((payload.values or {}) | {"coverage": light.coverage}, headers=headers)


def _to_json(response: LightResponse, parts: list[bytes]) -> str:
    data = iter(parts)
    results = [
        result.model_copy(
            update={"forms": [form if form.bytes is None else with_data(form, next(data)) for form in result.forms]}
        )
        for result in response.results
    ]
    return response.model_copy(update={"results": results}).model_dump_json(exclude_none=True)
