"""A session that an older version saved: it goes on with the same light, or is refused with a reason and stays."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from http_servers import RunningServer, frame

KEPT = Path(__file__).parents[1] / "data" / "state"


def files_of(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_session_of_version_0_1_0_is_used_or_kept(tmp_path):
    state = tmp_path / "state"
    shutil.copytree(KEPT / "sessions", state / "sessions")
    before = files_of(state / "sessions")
    with RunningServer(state_dir=state) as server:
        answer = server.call("GET", "/v1/sessions/room/probes/table?format=sh")
        if answer.status == 409:  # other weights, or a format that is no longer read
            assert answer.kind == "state-refused"
            assert "delete the session and open it again" in answer.json["detail"]
            assert files_of(state / "sessions") == before
            return
        expected = json.loads((KEPT / "light.json").read_text("utf-8"))
        assert answer.headers["roomlight-frame"] == "1"
        np.testing.assert_allclose(
            np.ravel(answer.json["coefficients"]), np.ravel(expected["coefficients"]), rtol=1e-3, atol=1e-4
        )  # another processor rounds in another way
        assert server.push(2, frame(24)).json["status"] == "processed"


@pytest.mark.parametrize("shared", [False, True])
def test_a_deleted_session_leaves_no_byte(tmp_path, shared):
    state = tmp_path / "state"
    with RunningServer(
        state_dir=state, state_interval_s=0.1, state_shared=shared, recordings_folder=tmp_path
    ) as server:
        server.open("a-room-that-is-deleted")
        message = frame(0)
        server.push(0, message, name="a-room-that-is-deleted")
        server.wait_until_saved(0, "a-room-that-is-deleted")
        assert any(message in data for data in files_of(state).values())
        assert server.call("DELETE", "/v1/sessions/a-room-that-is-deleted").status == 204
        left = files_of(tmp_path)
        assert list((state / "sessions").iterdir()) == []
        assert not [path for path, data in left.items() if message[:64] in data or b"a-room-that" in data]
    assert {path.name for path in files_of(tmp_path)} <= {"lock", "ages.json"} | {path.name for path in left}
