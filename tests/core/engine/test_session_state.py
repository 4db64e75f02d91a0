"""A saved and loaded session goes on with the same bits; files that do not fit are refused by name."""

import copy
import dataclasses
import errno
import os
import re
import stat

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from present import present
from roomlight.engine.networks.graphs import load_graphs
from roomlight.engine.session import Session, SessionOptions
from roomlight.engine.state.encoding import records_of_snapshot, saved_session
from roomlight.engine.state.kept_frames import base_of_frame
from roomlight.engine.state.records import Record, pack_records, unpack_records
from roomlight.errors import OutputError, StateError
from rooms import BoxRoom, camera_at, saturated
from sessions import session_from, state_of

ROOM = BoxRoom(lamp=((0.3, 1.6, -2.5), 0.35), lamp_radiance=30.0)
CLASSICAL = SessionOptions(model="classical", height=24, keyframes=4)
POINT = (-0.4, 1.0, 0.6)


def _shot(index):
    """A camera that turns; every second frame has a fourth of the exposure, and shows what the others clip."""
    yaw = 20 * np.sin(index)
    frame = ROOM.frame(camera_at((0.3, 1.4, 0.2), yaw + 8 * (index % 12)), index=index, width=96, height=72)
    frame.depth_m[10:20, 30:44] = 0  # a hole that is completed
    return saturated(frame, (1.0, 4.0, 16.0)[index % 3])


MEASURED = "probe/0/panorama/measured"
FRAMES = [_shot(index) for index in range(11)]


def _options(model, tiny_video):
    if model == "classical":
        return dataclasses.replace(CLASSICAL, model=model)
    return dataclasses.replace(CLASSICAL, model=model, weights=tiny_video, provider="cpu")


def _bits(session):
    """Every number that a session answers with."""
    lights = [*session.lights(), session.light_at(POINT)]
    return [
        (light.frame, light.coverage, light.panorama.tobytes(), light.observed.tobytes(),
         [one.to_json() for one in light.lights])
        for light in lights
    ]  # fmt: skip


def _run(session, frames):
    return [(report.keyframe, report.coverage) for report in map(session.push, frames)]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A session of seven frames and a probe, and its file."""
    path = tmp_path_factory.mktemp("state") / "room.state"
    session = Session(CLASSICAL)
    session.track((0.1, 1.2, -0.5))
    _run(session, FRAMES[:7])
    session.save(path)
    return session, path


@pytest.mark.parametrize(
    ("model", "at"),  # the video networks' two buffers take turns
    [("classical", 0), ("single", 6), ("video", 6), pytest.param("video", 1, marks=pytest.mark.slow)],
)
def test_a_loaded_session_goes_on_with_the_same_bits(tiny_video, tmp_path, model, at):
    options = _options(model, tiny_video)
    whole = Session(options)
    whole.track((0.1, 1.2, -0.5))
    _run(whole, FRAMES[:at])
    if at > 2:
        whole.untrack(whole.track((0.0, 1.0, 0.0)))
        whole.track((0.4, 1.1, 0.2))
    whole.save(tmp_path / "room.state")
    loaded = Session.load(tmp_path / "room.state")
    assert loaded.frames == at
    assert loaded.handles == whole.handles
    if at:
        assert _bits(loaded) == _bits(whole)
    assert _run(loaded, FRAMES[at:]) == _run(whole, FRAMES[at:])
    assert _bits(loaded) == _bits(whole)
    assert loaded.track((0.0, 1.3, 0.0)) == whole.track((0.0, 1.3, 0.0))
    assert _bits(loaded) == _bits(whole)
    np.testing.assert_array_equal(present(loaded.sglv).lobes, present(whole.sglv).lobes)


@pytest.mark.parametrize(("unknown_depth", "at"), [("rim", 9), ("far", 3), ("drop", 3)])
def test_kept_frames_are_made_from_the_frames_as_pushed(unknown_depth, at):
    options = dataclasses.replace(CLASSICAL, unknown_depth=unknown_depth)
    whole = Session(options)
    _run(whole, FRAMES[:at])
    kept = [one.index for one in whole.snapshot().kept]
    assert any(one.texture.clipped is not None for one in whole.snapshot().kept)
    without = state_of(whole, kept)
    assert len(without) < 0.7 * len(state_of(whole))
    found = saved_session(without, "room")
    assert found.elsewhere == tuple(kept)
    loaded = session_from(without, {index: base_of_frame(FRAMES[index], options) for index in kept})
    assert _bits(loaded) == _bits(whole)
    assert _run(loaded, FRAMES[at : at + 2]) == _run(whole, FRAMES[at : at + 2])
    assert _bits(loaded) == _bits(whole)


def test_a_state_from_before_it_was_known_what_was_measured_loads(saved):
    records = [one for one in unpack_records(state_of(saved[0]), "room") if one.values.get("name") != MEASURED]
    loaded = session_from(pack_records(records))
    assert _bits(loaded) == _bits(saved[0])
    _run(loaded, FRAMES[7:])
    assert loaded.panorama_state(0).measured.max() == 1


def test_a_second_recording_that_begins_at_frame_0_keeps_the_first_ones_frames():
    whole = Session(CLASSICAL)
    second = [dataclasses.replace(FRAMES[4 + index], index=index) for index in range(3)]
    _run(whole, [*FRAMES[:3], *second])
    kept = [one.index for one in whole.snapshot().kept]
    assert len(set(kept)) == len(kept) >= 4
    loaded = session_from(state_of(whole))
    assert _bits(loaded) == _bits(whole)
    again = [dataclasses.replace(FRAMES[8], index=0), dataclasses.replace(FRAMES[10], index=1)]
    assert _run(loaded, again) == _run(whole, again)
    assert _bits(loaded) == _bits(whole)


def test_another_image_for_a_kept_frame_is_refused(saved):
    found = saved_session(state_of(saved[0], range(99)), "room.state")
    index = found.elsewhere[0]
    others = {one: base_of_frame(FRAMES[one], CLASSICAL) for one in found.elsewhere}
    with pytest.raises(StateError, match=f"room.state: frame {index}: is missing"):
        found.snapshot()
    others[index] = base_of_frame(FRAMES[index + 1], CLASSICAL)
    with pytest.raises(StateError, match=f"room.state: frame {index}: its pixels differ"):
        found.snapshot(others)


def test_a_snapshot_does_not_change_with_later_frames(saved):
    whole = Session.load(saved[1])
    snapshot = whole.snapshot()
    before = pack_records(records_of_snapshot(snapshot))
    _run(whole, FRAMES[7:])
    assert pack_records(records_of_snapshot(snapshot)) == before


def test_only_the_user_can_read_the_file(saved):
    assert stat.S_IMODE(saved[1].stat().st_mode) == 0o600
    assert [path.name for path in saved[1].parent.iterdir()] == ["room.state"]


def test_a_failed_write_leaves_the_old_file(saved, monkeypatch):
    before = saved[1].read_bytes()

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("roomlight.files.os.fsync", full)
    with pytest.raises(OutputError, match=r"room.state: cannot be written \(No space left on device\)"):
        saved[0].save(saved[1])
    assert saved[1].read_bytes() == before
    assert [path.name for path in saved[1].parent.iterdir()] == ["room.state"]


def _refused(tmp_path, file):
    (tmp_path / "bad.state").write_bytes(file)
    with pytest.raises(StateError) as refused:
        Session.load(tmp_path / "bad.state")
    assert "bad.state" in str(refused.value)
    return str(refused.value)


@settings(max_examples=100)
@given(share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_one_flipped_bit_and_a_cut_anywhere_are_refused(saved, share, bit):
    file = bytearray(saved[1].read_bytes())
    at = int(share * len(file))
    with pytest.raises(StateError, match=r"room: is (truncated|not a saved state)|of version"):
        saved_session(bytes(file[:at]), "room")
    file[at] ^= 1 << bit
    with pytest.raises(StateError, match="room: is"):
        saved_session(bytes(file), "room")


def test_files_of_other_kinds_and_versions_are_refused(saved, tmp_path):
    file = saved[1].read_bytes()
    assert "is not a saved state" in _refused(tmp_path, b"")
    assert "is not a saved state" in _refused(tmp_path, b"\x89PNG\r\n\x1a\n" + bytes(100))
    assert "version '1'; this release reads version 3" in _refused(tmp_path, file.replace(b"RLSTATE3", b"RLSTATE1", 1))
    assert "8 bytes follow the end" in _refused(tmp_path, file + bytes(8))
    assert "0 saved sessions" in _refused(tmp_path, pack_records([Record("NOTE", {"a": 1})]))
    with pytest.raises(StateError, match=r"none\.state: cannot be read \(No such file"):
        Session.load(tmp_path / "none.state")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda values: values.pop("frames"), "its values are invalid (frames: Field required)"),
        (lambda values: values.update(more=1), "(more: Extra inputs"),
        (lambda values: values["options"].update(height=8), "(options.height: Input should be greater than"),
        (lambda values: values["kept"][0].update(checksum=1), "its pixels differ"),
        (lambda values: values["probes"][0].update(handle=9), "its values do not fit"),
    ],
)
def test_values_that_do_not_fit_are_refused(saved, tmp_path, change, message):
    records = unpack_records(saved[1].read_bytes(), "room")
    values = copy.deepcopy(records[0].values)
    change(values)
    assert message in _refused(tmp_path, pack_records([Record("SESS", values), *records[1:]]))


def test_arrays_that_do_not_fit_are_refused(saved, tmp_path):
    head, *arrays = unpack_records(saved[1].read_bytes(), "room")
    first = arrays[0]
    for values, data, message in (
        (first.values | {"shape": [2, 2]}, first.data, "its shape needs 16"),
        (first.values | {"type": "object"}, first.data, "cannot be read"),
        (first.values, b"no zstd", "cannot be decompressed"),
    ):
        assert message in _refused(tmp_path, pack_records([head, Record("ARRY", values, data), *arrays[1:]]))
    assert "its values do not fit" in _refused(tmp_path, pack_records([head, *arrays[1:]]))


def test_other_options_and_weights_are_refused(saved, tiny_video, tmp_path):
    with pytest.raises(StateError, match=r"room.state: the session was saved with height=24, not 48"):
        Session.load(saved[1], dataclasses.replace(CLASSICAL, height=48))
    records = unpack_records(saved[1].read_bytes(), "room")
    records[0].values["networks"]["clipping"] = 64 * "0"
    said = _refused(tmp_path, pack_records(records))
    assert re.search(r"saved with a network for clipped pixels 0{16}, and here is [0-9a-f]{16}", said)
    with pytest.raises(StateError, match="saved with the model classical, and here is single"):
        Session.load(saved[1], dataclasses.replace(CLASSICAL, model="single"))
    graphs = load_graphs(tiny_video, provider="cpu")
    options = _options("video", tiny_video)
    Session(options, graphs=graphs).save(tmp_path / "video.state")
    other = copy.copy(graphs.graphs["video_sg_gru"])
    other.digest = "0" * 64
    graphs = dataclasses.replace(graphs, graphs=graphs.graphs | {"video_sg_gru": other})
    with pytest.raises(StateError, match=r"video.state: the session was saved with weights"):
        Session.load(tmp_path / "video.state", graphs=graphs)
