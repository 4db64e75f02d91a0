"""Stored sequences decode to their recordings, and are complete or absent whatever happens to the files."""

import errno
import io
import os
import signal
import subprocess
import sys
import tarfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stub_rooms
from roomlight.captures import open_capture
from roomlight.captures.formats import native
from roomlight.dataset import sequence_files
from roomlight.dataset.archive import BLOCK, RECORD, end_of_archive, pack, unpack
from roomlight.dataset.folder import LOCK, locked
from roomlight.dataset.shards import ShardWriter, index_path, is_finished, read_index, read_packed
from roomlight.errors import DatasetError, ImageError, OutputError


def one(seed=0, **options):
    return stub_rooms.recording(np.random.default_rng(seed), **options)


def contents(seed, size):
    return np.random.default_rng(seed).bytes(size)


def filled(folder, count=3, *, finish=False):
    """Write a shard of small sequences; returns its path and the bytes of both files."""
    folder.mkdir(parents=True, exist_ok=True)
    tar = folder / "train-00000.tar"
    with ShardWriter(tar) as shard:
        for number in range(count):
            shard.append(f"train-{number:06d}", pack(f"train-{number:06d}", {"a": contents(number, 700 + number)}))
        if finish:
            shard.finish()
    return tar, tar.read_bytes(), index_path(tar).read_bytes()


# archives


def content(archive, member):
    file = archive.extractfile(member)
    assert file is not None
    return file.read()


@settings(max_examples=30, deadline=None)
@given(
    st.dictionaries(
        st.from_regex(r"[a-z]{1,8}(/[a-z0-9.]{1,8})?", fullmatch=True), st.binary(max_size=1500), max_size=5
    )
)
def test_an_archive_is_what_tar_programs_read(files):
    packed = pack("folder", files)
    assert len(packed) % BLOCK == 0
    assert {name: bytes(data) for name, data in unpack(packed, "folder").items()} == files
    whole = packed + end_of_archive(len(packed))
    assert len(whole) % RECORD == 0
    with tarfile.open(fileobj=io.BytesIO(whole)) as archive:
        assert {member.name: content(archive, member) for member in archive} == {
            f"folder/{name}": data for name, data in files.items()
        }


def test_members_of_another_folder_are_refused():
    with pytest.raises(ValueError, match="does not belong to train-000001"):
        unpack(pack("train-000000", {"a": b"x"}), "train-000001")


# a recording as files


def test_a_recording_comes_back():
    before = one(1, name="train-000003", facts={"room_type": "hall", "n": np.int64(3), "list": np.arange(3)})
    after = sequence_files.decode(sequence_files.encode(before), "here")
    for exact in ("depth_mm", "surface", "camera_to_world", "exposure", "timestamp_s", "probe_positions"):
        np.testing.assert_array_equal(getattr(after, exact), getattr(before, exact), err_msg=exact)
    assert (after.name, after.intrinsics) == (before.name, before.intrinsics)
    assert after.facts == {"room_type": "hall", "n": 3, "list": [0, 1, 2]}
    # JPEG of quality 95 on smooth colours; half floats have 11 bits
    assert np.abs(after.colour.astype(int) - before.colour).max() <= 6
    assert np.abs(after.colour.astype(int) - before.colour).mean() < 1.0
    np.testing.assert_allclose(after.probe_panoramas, before.probe_panoramas, rtol=2**-11)


def test_only_the_frames_asked_for_are_decoded():
    files = sequence_files.encode(one(3))
    some = sequence_files.decode(files, "here", frames=[2, 0])
    whole = sequence_files.decode(files, "here")
    np.testing.assert_array_equal(some.colour, whole.colour[[2, 0]])
    np.testing.assert_array_equal(some.camera_to_world, whole.camera_to_world[[2, 0]])
    for name in list(files):
        if "000001." in name or "000003." in name or name.startswith("probes"):
            files[name] = b"not an image"
    np.testing.assert_array_equal(
        sequence_files.decode(files, "here", frames=[2, 0], probes=False).depth_mm, some.depth_mm
    )
    with pytest.raises(ImageError, match="here/"):
        sequence_files.decode(files, "here", probes=False)
    with pytest.raises(IndexError, match="frames are 0 to 3"):
        sequence_files.decode(files, "here", frames=[4])
    del files["depth/000000.png"]
    with pytest.raises(ValueError, match=r"depth/000000\.png"):
        sequence_files.decode(files, "here", frames=[0], probes=False)


def test_a_sequence_is_a_capture_that_the_readers_know(tmp_path):
    before = one(4)
    packed = pack("train-000000", sequence_files.encode(before))
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for member in filter(tarfile.TarInfo.isfile, archive):  # extractall warns without a filter, which 3.11.2 lacks
            (tmp_path / member.name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / member.name).write_bytes(content(archive, member))
    capture = open_capture(tmp_path / "train-000000")
    frames = list(capture)
    assert (capture.format, len(frames), capture.skipped) == ("roomlight", 4, [])
    for k, frame in enumerate(frames):
        np.testing.assert_allclose(frame.depth_m * 1000, before.depth_mm[k], atol=1e-3)
        np.testing.assert_allclose(frame.camera_to_world, before.camera_to_world[k], atol=1e-12)
        assert frame.intrinsics == before.intrinsics
    for truth, position, panorama in zip(capture.probes, before.probe_positions, before.probe_panoramas, strict=True):
        np.testing.assert_allclose(truth.position, position, atol=1e-12)
        np.testing.assert_allclose(truth.panorama(), panorama, rtol=2**-11)
    assert (sequence_files.CAPTURE, sequence_files._FORMAT, sequence_files._VERSION) == (
        native.INDEX,
        native.FORMAT,
        native.VERSION,
    )


def test_panoramas_beyond_half_floats_are_stored_exactly():
    before = one(5)
    before.probe_panoramas[0, 3, 4] = (400_000, 300_000, 100_000)
    after = sequence_files.decode(sequence_files.encode(before), "here").probe_panoramas
    np.testing.assert_array_equal(after[0], before.probe_panoramas[0])
    np.testing.assert_array_equal(after[1], before.probe_panoramas[1].astype(np.float16))


def with_clipped(seed):
    """A recording whose frames show white in a corner, of 1 to 900 times white."""
    recording = one(seed)
    recording.colour[:, :5, :6] = 255
    clipped = np.zeros(recording.colour.shape, np.float16)
    clipped[:, :5, :6] = np.geomspace(1, 900, 4 * 5 * 6 * 3).reshape(4, 5, 6, 3)
    return replace(recording, clipped_radiance=clipped)


def test_clipped_radiance_comes_back_where_requested():
    before = with_clipped(7)
    files = sequence_files.encode(before)
    assert sequence_files.decode(files, "here").clipped_radiance is None
    after = sequence_files.decode(files, "here", frames=[2, 0], clipped=True).clipped_radiance
    assert after is not None
    assert before.clipped_radiance is not None
    assert after.dtype == np.float16
    np.testing.assert_array_equal(after, before.clipped_radiance[[2, 0]])


def test_recordings_without_clipped_radiance_have_none():
    files = sequence_files.encode(one(8))
    assert not any(name.startswith("clipped") for name in files)
    assert sequence_files.decode(files, "here", clipped=True).clipped_radiance is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"clipped_radiance": np.zeros((4, 12, 16, 3), np.float16)}, r"clipped_radiance is \(4, 12, 16, 3\), colour"),
        ({"clipped_radiance": np.full((4, 24, 32, 3), np.inf, np.float16)}, "clipped_radiance must be finite"),
        ({"clipped_radiance": np.full((4, 24, 32, 3), -1, np.float16)}, "clipped_radiance must be finite"),
        ({"exposure": np.array([1.0, 1, 1])}, "'exposure': 3"),
        ({"exposure": np.array([1.0, 1, 1, 0])}, "exposures must be positive"),
        ({"camera_to_world": np.tile(2 * np.eye(4), (4, 1, 1))}, "0 0 0 1"),
        ({"probe_panoramas": np.full((2, 16, 32, 3), np.nan, np.float32)}, "finite"),
        ({"probe_panoramas": np.zeros((2, 16, 16, 3), np.float32)}, "2 probes with panoramas"),
        ({"depth_mm": np.zeros((4, 12, 16), np.uint16)}, "colour is 32 x 24"),
        ({"facts": {"x": object()}}, "type object"),
        ({"facts": {"x": float("nan")}}, "not JSON compliant"),
    ],
)
def test_an_inconsistent_recording_is_not_stored(change, says):
    broken = one(6)
    for name, value in change.items():
        object.__setattr__(broken, name, value)
    with pytest.raises(ValueError, match=says):
        sequence_files.encode(broken)


# shards


def test_a_shard_holds_what_was_appended(tmp_path):
    tar, _, _ = filled(tmp_path, finish=True)
    entries = read_index(tar).entries
    assert [entry.name for entry in entries] == ["train-000000", "train-000001", "train-000002"]
    for number, entry in enumerate(entries):
        assert unpack(read_packed(tar, entry), entry.name)["a"] == contents(number, 700 + number)
    with tarfile.open(tar) as archive:
        assert archive.getnames() == [f"train-{number:06d}/a" for number in range(3)]
    assert subprocess.run(["tar", "tf", str(tar)], capture_output=True, check=True).stderr == b""


def test_a_finished_shard_can_be_continued(tmp_path):
    tar, _, _ = filled(tmp_path / "at-once", 5, finish=True)
    other, _, _ = filled(tmp_path / "in-two", 2, finish=True)
    assert is_finished(other, {"train-000000", "train-000001"})
    assert not is_finished(other, {"train-000000", "train-000002"})
    with ShardWriter(other) as shard:
        assert shard.names == {"train-000000", "train-000001"}
        for number in range(2, 5):
            shard.append(f"train-{number:06d}", pack(f"train-{number:06d}", {"a": contents(number, 700 + number)}))
        assert not is_finished(other, {"train-000000"})
        shard.finish()
    assert other.read_bytes() == tar.read_bytes()
    assert index_path(other).read_bytes() == index_path(tar).read_bytes()


def _cuts(length, step):
    return sorted(
        {0, 1, 2, step - 1, step, step + 1, length // 2, length - step, length - 1, length} & set(range(length + 1))
    )


def test_a_truncated_end_is_removed_and_written_again(tmp_path, monkeypatch):
    """Every place where a kill can end the last sequence's bytes and then its line, and one byte more or less."""
    monkeypatch.setattr(os, "fsync", lambda _: None)  # 40 resumptions; what is synced when has a test of its own
    tar, whole, lines = filled(tmp_path, finish=True)
    last = read_index(tar).entries[-1]
    kept_lines = lines.rindex(b"\n", 0, len(lines) - 1) + 1
    states = [(last.offset + cut, kept_lines) for cut in _cuts(last.length, BLOCK)]  # bytes before their line
    states += [(last.end, kept_lines + cut) for cut in _cuts(len(lines) - kept_lines, 2)]
    states += [(last.end + cut, len(lines)) for cut in _cuts(len(whole) - last.end, BLOCK)]
    states += [(last.end - cut, len(lines)) for cut in (1, BLOCK, last.length)]  # a disk that lost what it had synced
    for size, lines_size in states:
        tar.write_bytes(whole[:size])
        index_path(tar).write_bytes(lines[:lines_size])
        # a reader sees whole sequences only, or an error
        for entry in read_index(tar).entries[: 2 if size < last.end else 3]:
            assert unpack(read_packed(tar, entry), entry.name)
        with ShardWriter(tar) as shard:
            finished = size >= last.end and lines_size == len(lines)
            there = {"train-000000", "train-000001"} | ({last.name} if finished else set())
            assert shard.names == there, (size, lines_size)
            if last.name not in there:
                shard.append(last.name, pack(last.name, {"a": contents(2, 702)}))
            shard.finish()
        assert tar.read_bytes() == whole, (size, lines_size)
        assert index_path(tar).read_bytes() == lines, (size, lines_size)


@pytest.mark.parametrize(
    "rubbish", [b"\0" * 300, b"{}\n", b"\n\n", b'{"name": "train-000003", "offset": 0}\n', b"\xff\xfe\n{"]
)
def test_bytes_after_the_last_line_belong_to_no_sequence(rubbish, tmp_path):
    tar, whole, lines = filled(tmp_path)
    index_path(tar).write_bytes(lines + rubbish)
    tar.write_bytes(whole + contents(9, 5000))
    assert len(read_index(tar).entries) == 3
    with ShardWriter(tar):
        pass
    assert (tar.read_bytes(), index_path(tar).read_bytes()) == (whole, lines)


def test_a_line_is_written_after_its_bytes_are_synced(tmp_path, monkeypatch):
    events = []
    tar = tmp_path / "train-00000.tar"
    real_sync, real_pwrite, real_write = os.fsync, os.pwrite, os.write
    with ShardWriter(tar) as shard:
        monkeypatch.setattr(os, "fsync", lambda handle: (events.append("sync"), real_sync(handle))[1])
        monkeypatch.setattr(os, "pwrite", lambda *given: (events.append("bytes"), real_pwrite(*given))[1])
        monkeypatch.setattr(os, "write", lambda *given: (events.append("line"), real_write(*given))[1])
        shard.append("train-000000", pack("train-000000", {"a": b"x"}))
        monkeypatch.undo()
    assert events == ["bytes", "sync", "line", "sync"]


@pytest.mark.parametrize("where", [0, 1, 2])
@pytest.mark.parametrize("at", [0.0, 0.5, 1.0])
def test_a_flipped_byte_damages_one_sequence_and_names_a_remedy(where, at, tmp_path):
    tar, whole, _ = filled(tmp_path, finish=True)
    entries = read_index(tar).entries
    damaged = bytearray(whole)
    damaged[entries[where].offset + round(at * (entries[where].length - 1))] ^= 16
    tar.write_bytes(damaged)
    for number, entry in enumerate(entries):
        if number != where:
            read_packed(tar, entry)
            continue
        with pytest.raises(DatasetError) as caught:
            read_packed(tar, entry)
        assert all(word in str(caught.value) for word in (str(tar), entry.name, "verify", "--repair"))
    if where < 2:
        with pytest.raises(DatasetError, match=entries[where].name):
            ShardWriter(tar)
    else:  # at the end it counts as never finished
        with ShardWriter(tar) as shard:
            assert shard.names == {"train-000000", "train-000001"}


def test_a_flipped_byte_of_the_index_damages_one_line(tmp_path):
    tar, _, lines = filled(tmp_path)
    first = lines.index(b"\n") + 1
    second = lines.index(b"\n", first) + 1
    for at in range(first, second):
        damaged = bytearray(lines)
        damaged[at] ^= 4
        index_path(tar).write_bytes(damaged)
        index = read_index(tar)
        names = [entry.name for entry in index.entries]
        # a lost line end takes its neighbour along
        assert names in (["train-000000", "train-000002"], ["train-000000"]), at
        assert len(names) == 1 or index.damaged == (2,)
    index_path(tar).write_bytes(lines[:first] + b"x" + lines[first:])
    with pytest.raises(DatasetError, match="line 2 is damaged"):
        ShardWriter(tar)


@pytest.mark.parametrize("stage", ["bytes", "sync", "line"])
def test_a_full_disk_is_an_error_and_finished_sequences_stay(stage, tmp_path, monkeypatch):
    tar, whole, lines = filled(tmp_path)
    call = {"bytes": "pwrite", "sync": "fsync", "line": "write"}[stage]
    real = getattr(os, call)
    shard = ShardWriter(tar)

    def full(handle, data=b"", *rest):
        if data and stage != "sync":
            real(handle, bytes(data)[: len(data) // 2], *rest)  # half of it fitted
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, call, full)
    with (
        shard,
        pytest.raises(OutputError, match=r"train-00000\.(tar|jsonl): cannot be written \(No space left on device"),
    ):
        shard.append("train-000003", pack("train-000003", {"a": contents(3, 5000)}))
    monkeypatch.undo()
    with ShardWriter(tar) as again:
        assert again.names == {"train-000000", "train-000001", "train-000002"}
    assert (tar.read_bytes(), index_path(tar).read_bytes()) == (whole, lines)


# who writes

HOLDER = """
import sys
from pathlib import Path
from roomlight.dataset.folder import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_writer_gets_the_holders_name_until_it_ends(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(OutputError, match=rf"process {holder.pid} on .* is writing"), locked(tmp_path):
            pass
        holder.send_signal(signal.SIGKILL)
    assert (tmp_path / LOCK).read_text()  # what it wrote is still there, and means nothing
    with locked(tmp_path):
        assert str(os.getpid()) in (tmp_path / LOCK).read_text()
    assert (tmp_path / LOCK).read_text() == ""
