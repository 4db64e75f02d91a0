"""Light at points: one with an ETag, many in one call, named ones that are followed."""

from typing import Annotated, Any, Final

from fastapi import APIRouter, Body, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import ValidationError

from roomlight.wire.frame_message import explain
from roomlight.wire.light_message import MEDIA_TYPE, pack_light, with_data
from roomlight.wire.messages import (
    HarmonicsBasis,
    HarmonicsKind,
    LightForm,
    LightFormat,
    LightRequest,
    LightResponse,
    ProbeBody,
    ProbeLight,
    ProbeQuery,
)
from roomlight_server.context import In, Live, ProbeName
from roomlight_server.light_forms import MEDIA_TYPES, encode, encode_all, etag, most_bytes
from roomlight_server.live_session import LiveSession, PointLight
from roomlight_server.problems import BODY_REFUSALS, ProblemError, documented
from roomlight_server.workers import Workers

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["light"])
COVERAGE_HEADER: Final = "Roomlight-Coverage"
FRAME_HEADER: Final = "Roomlight-Frame"
MOST_BYTES: Final = 64 * 2**20
"""Of one answer: 64 probes with a cube map of 128 pixels each."""
_REFUSALS: Final = ("unauthorized", "session-not-found", "session-failed", "session-closed", "invalid")
_ONE: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "description": "The light, in its media type",
        "headers": {
            "ETag": {"description": "Changes when the light at this point does", "schema": {"type": "string"}},
            COVERAGE_HEADER: {"description": "Share of the sphere observed, 0 to 1", "schema": {"type": "number"}},
            FRAME_HEADER: {
                "description": "Index of the last processed frame; -1 before the first: the light is the prior",
                "schema": {"type": "integer"},
            },
        },
        "content": {kind: {} for kind in sorted(set(MEDIA_TYPES.values()) - {"application/json"})}
        | {
            "application/json": {
                "example": {"direction": [0.0, 1.0, 0.0], "intensity": [2.1, 2.0, 1.8], "coverage": 0.42}
            }
        },
    },
    304: {"description": "The light is what `If-None-Match` names"},
}
_BATCH: Final[dict[str, Any]] = {
    "two": {
        "summary": "A point and a followed probe, as numbers for shading and a cube map for reflections",
        "value": {
            "probes": [{"position": [0.2, -0.1, -1.5]}, {"name": "table"}],
            "forms": [{"format": "sh"}, {"format": "main_light"}, {"format": "cube", "size": 32}],
        },
    }
}
_Metres = Annotated[float, Query(ge=-1000, le=1000, allow_inf_nan=False, description="World metres.")]
_Format = Annotated[LightFormat, Query()]
_Size = Annotated[int | None, Query(ge=8, le=512, description="Panorama height, or side of a cube's face.")]
_Ev = Annotated[float, Query(ge=-16, le=16, allow_inf_nan=False, description="png: radiance 2^-ev is white.")]


@router.get(
    "/probe",
    summary="Light at a point",
    response_class=Response,
    responses=_ONE | documented(*_REFUSALS, "engine-failed"),
)
async def probe(
    live: Live,
    context: In,
    request: Request,
    x: _Metres,
    y: _Metres,
    z: _Metres,
    format: _Format = "exr",
    size: _Size = None,
    kind: HarmonicsKind = "total",
    basis: HarmonicsBasis = "arcore",
    exposure_ev: _Ev = 0.0,
) -> Response:
    """Light at any position; it is caught up from what the session remembers.

    Before the first frame it is the prior: grey, brighter from above, coverage 0, frame -1.
    """
    form = _form(format=format, size=size, kind=kind, basis=basis, exposure_ev=exposure_ev)
    return await _one(live, context.workers, request, ProbeQuery(position=[x, y, z]), form)


@router.get(
    "/probes/{name}",
    summary="Light at a named probe",
    response_class=Response,
    responses=_ONE | documented(*_REFUSALS, "probe-not-found"),
)
async def named_probe(
    live: Live,
    context: In,
    name: ProbeName,
    request: Request,
    format: _Format = "exr",
    size: _Size = None,
    kind: HarmonicsKind = "total",
    basis: HarmonicsBasis = "arcore",
    exposure_ev: _Ev = 0.0,
) -> Response:
    """Light at a point that is followed from frame to frame: the best that the session has, and at once."""
    form = _form(format=format, size=size, kind=kind, basis=basis, exposure_ev=exposure_ev)
    return await _one(live, context.workers, request, ProbeQuery(name=name), form)


@router.put(
    "/probes/{name}",
    summary="Follow a point",
    responses={201: {"model": ProbeBody, "description": "Followed from now on"}}
    | documented(
        *(*BODY_REFUSALS, "unauthorized", "session-not-found", "session-failed", "session-closed"),
        *("too-many-probes", "invalid", "engine-failed"),
    ),
)
async def put_probe(
    live: Live,
    name: ProbeName,
    body: Annotated[ProbeBody, Body(openapi_examples={"table": {"value": {"position": [0.2, -0.1, -1.5]}}})],
    response: Response,
) -> ProbeBody:
    """Follow a point under a name, before the first frame if possible; a name that is taken moves, caught up."""
    x, y, z = body.position
    response.status_code = 201 if await live.track(name, (x, y, z)) else 200
    return body


@router.delete(
    "/probes/{name}",
    summary="Follow a point no longer",
    status_code=204,
    responses=documented(
        *("unauthorized", "session-not-found", "session-failed", "session-closed", "probe-not-found", "invalid")
    ),
)
async def delete_probe(live: Live, name: ProbeName) -> None:
    """Its place is free for another."""
    await live.untrack(name)


@router.post(
    "/probes",
    summary="Light at many points",
    response_model=LightResponse,
    responses={200: {"description": "In the order of the request", "content": {MEDIA_TYPE: {}}}}
    | documented(*BODY_REFUSALS, *_REFUSALS, "probe-not-found", "engine-failed"),
)
async def probes(
    live: Live,
    context: In,
    body: Annotated[LightRequest, Body(openapi_examples=_BATCH)],
    request: Request,
) -> Response:
    """Light at many points after one and the same frame, each in every form; JSON, or binary by `Accept`."""
    check_size(body)
    with context.metrics.light_seconds.time():
        points = await live.lights(body.probes)
        results, parts = await answer(context.workers, points, body.forms)
    response = LightResponse(frame=points[0].frame, results=results)
    if MEDIA_TYPE in request.headers.get("accept", ""):
        return Response(pack_light(response, parts), media_type=MEDIA_TYPE)
    whole = await context.workers.aside(_as_json, response, parts)
    return Response(whole, media_type="application/json")


def check_size(request: LightRequest) -> None:
    """Raise ProblemError for an answer that could pass `MOST_BYTES`."""
    size = len(request.probes) * sum(most_bytes(form) for form in request.forms)
    if size > MOST_BYTES:
        rule = f"at most {MOST_BYTES} bytes in one answer: fewer probes, forms or pixels"
        detail = f"the answer could take {size} bytes; {rule}"
        raise ProblemError("invalid", detail, field="forms", value=size, rule=rule)


async def answer(
    workers: Workers, points: list[PointLight], forms: list[LightForm]
) -> tuple[list[ProbeLight], list[bytes]]:
    """Every point in every form: the entries of a response, and the binary forms' data in order."""
    results: list[ProbeLight] = []
    parts: list[bytes] = []
    for point in points:
        result, data = await workers.aside(encode_all, point, forms)
        results.append(result)
        parts += data
    return results, parts


async def _one(live: LiveSession, workers: Workers, request: Request, query: ProbeQuery, form: LightForm) -> Response:
    point = (await live.lights([query]))[0]
    tag = etag(point, form)
    headers = {
        "ETag": tag,
        "Cache-Control": "private, no-cache",
        COVERAGE_HEADER: f"{point.light.coverage:.4f}",
        FRAME_HEADER: str(point.frame),
    }
    if _matches(request.headers.get("if-none-match", ""), tag):
        return Response(status_code=304, headers=headers)
    encoded = await workers.aside(encode, point, form)
    if encoded.data is not None:
        return Response(encoded.data, media_type=MEDIA_TYPES[form.format], headers=headers)
    return JSONResponse((encoded.values or {}) | {"coverage": point.light.coverage}, headers=headers)


def _matches(if_none_match: str, tag: str) -> bool:
    offered = [one.strip().removeprefix("W/") for one in if_none_match.split(",")]
    return tag in offered or "*" in offered


def _form(**values: Any) -> LightForm:
    try:
        return LightForm(**values)
    except ValidationError as error:
        raise ProblemError.from_wire(explain(error, kind="invalid")) from error


def _as_json(response: LightResponse, parts: list[bytes]) -> str:
    data = iter(parts)
    results = [
        result.model_copy(
            update={"forms": [form if form.bytes is None else with_data(form, next(data)) for form in result.forms]}
        )
        for result in response.results
    ]
    return response.model_copy(update={"results": results}).model_dump_json(exclude_none=True)
