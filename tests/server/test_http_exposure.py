"""Frames of other exposure over a socket: a lamp that one frame clips and the next one shows."""

import io
import json

import numpy as np
import pytest

from http_servers import RunningServer, header_of
from roomlight.conventions import linear_to_srgb8, panorama_directions
from roomlight.wire.frame_header import FrameHeader
from roomlight.wire.frame_message import pack
from rooms import BoxRoom, camera_at

TRUE = 20.0
LAMP = ((0.3, 1.6, -2.5), 0.45)
PROBE = (0.3, 1.4, 0.2)
ROOM = BoxRoom(lamp=LAMP, lamp_radiance=TRUE)


def message(exposure, yaw):
    """An 8-bit frame at this exposure: brighter radiance is white."""
    shot = ROOM.frame(camera_at((0.3, 1.4, 0.2), yaw), width=160, height=120)
    parts = linear_to_srgb8(np.clip(shot.image * exposure, 0, 1)).tobytes(), shot.depth_m.astype("<f4").tobytes()
    return pack(FrameHeader.model_validate_json(json.dumps(header_of(shot, exposure=exposure))), *parts)


@pytest.mark.parametrize("exposures", [(1.0, 1 / 32), (1 / 32, 1.0)])
def test_a_short_exposure_shows_the_lamp(exposures):
    to_lamp = np.array(LAMP[0]) - PROBE
    lamp = panorama_directions(48) @ (to_lamp / np.linalg.norm(to_lamp)) > np.cos(np.radians(5))
    with RunningServer() as server:
        server.open("room", {"model": "classical", "height": 48, "reference_exposure": 1.0})
        assert server.call("PUT", "/v1/sessions/room/probes/table", {"position": PROBE}).status in (200, 201)
        for index, exposure in enumerate(exposures):
            assert server.push(index, message(exposure, 5.0 * index)).json["status"] == "processed"
        tracked = server.call("GET", "/v1/sessions/room/probes/table?format=npy")
        late = server.call("GET", "/v1/sessions/room/probe?x=0.3&y=1.4&z=0.2&format=npy")
    for answer in (tracked, late):
        assert answer.status == 200, answer
        # 8 bits at 0.625 of white: steps of 1 %
        np.testing.assert_allclose(np.load(io.BytesIO(answer.body))[lamp], TRUE, rtol=0.05)
