"""JSON messages and light messages: strictness, ids, round trips."""

import base64
import json

import pytest
from pydantic import ValidationError

from roomlight.errors import WireError
from roomlight.wire.light_message import pack_light, parse_light, with_data
from roomlight.wire.messages import (
    EncodedLight,
    LightAnswer,
    LightForm,
    LightRequest,
    LightResponse,
    ProbeLight,
    SessionRequest,
    is_id,
)


def response(**more):
    forms = [
        EncodedLight(format="sh", media_type="application/json", values={"coefficients": [0.5] * 27}),
        EncodedLight(format="exr", media_type="image/x-exr", bytes=5),
        EncodedLight(format="cube", media_type="application/octet-stream", bytes=0),
    ]
    lights = [ProbeLight(position=[0.0, 1.0, float(n)], coverage=0.25, etag="ab", forms=forms) for n in range(2)]
    return LightResponse(frame=7, results=lights) if not more else LightAnswer(frame=7, results=lights, **more)


def test_a_light_message_round_trips():
    parts = [b"first", b"", b"other", b""]
    body = pack_light(response(), parts)
    read, data = parse_light(body, LightResponse)
    assert read == response()
    assert data == [[None, b"first", b""], [None, b"other", b""]]
    answer = pack_light(response(request="r1"), parts)
    assert parse_light(answer, LightAnswer)[0].request == "r1"


@pytest.mark.parametrize("damage", [b"", b"RLF1", b"RLL1\xff\0\0\0{}", b"RLL1\x02\0\0\0{}"])
def test_a_damaged_light_message_is_rejected(damage):
    with pytest.raises(WireError):
        parse_light(damage, LightResponse)
    whole = pack_light(response(), [b"first", b"", b"other", b""])
    for wrong in (whole[:-1], whole + b"x"):
        with pytest.raises(WireError, match="parts must end"):
            parse_light(wrong, LightResponse)


def test_json_contains_data_in_base64():
    form = with_data(response().results[0].forms[1], b"first")
    plain = json.loads(form.model_dump_json(exclude_none=True))
    assert base64.b64decode(plain["data"]) == b"first"
    assert "bytes" not in plain


def test_ids_are_1_to_64_letters_digits_and_marks():
    assert all(map(is_id, ("a", "A-Z_09", "x" * 64)))
    assert not any(map(is_id, ("", "x" * 65, "a b", "a/b", "..", "a\n", "\u00e9", "a\0")))


def test_the_size_of_a_form_depends_on_its_format():
    assert LightForm(format="cube", size=256).size == 256
    for wrong in ({"format": "cube", "size": 24}, {"format": "exr", "size": 7}, {"format": "exr", "size": 513}):
        with pytest.raises(ValidationError):
            LightForm(**wrong)


def test_requests_are_validated_strictly():
    assert SessionRequest.model_validate_json("{}").height == 120
    for text in ('{"height": "120"}', '{"height": true}', '{"heigth": 120}', '{"reference_exposure": NaN}'):
        with pytest.raises(ValidationError):
            SessionRequest.model_validate_json(text)
    many = {"probes": [{"position": [0, 0, 0]}] * 64, "forms": [{"format": "sh"}]}
    assert len(LightRequest.model_validate(many).probes) == 64
