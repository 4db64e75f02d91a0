"""Archives of Record3D, and zipped folders: a damaged member skips its frame, what is foreign is refused by name."""

import json
import re
import shutil
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import formats
import lzfse
import numpy as np
import pytest
from builders import BUILDERS, FORMAT_OF
from capture_checks import one_skipped, refused, same_views
from PIL import ExifTags, Image

from roomlight.captures import fields, open_capture
from roomlight.errors import CaptureError, FrameError, UnknownFormatError

VIEWS = formats.scene()


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary folders are made."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return tmp_path / "temporary"


def repacked(path: Path, change: Callable[[dict[str, bytes]], object]) -> Path:
    members = formats.record3d_members(VIEWS)
    change(members)
    return formats.zipped(path, members)


def test_depth_of_another_size_than_the_metadata_says(tmp_path: Path) -> None:
    short = lzfse.compress(VIEWS[1].depth_m[:12].tobytes())
    path = repacked(tmp_path / "a.r3d", lambda members: members.update({"rgbd/1.depth": short}))
    one_skipped(path, 1, "rgbd/1.depth", "1536 bytes", "3072")
    path = repacked(tmp_path / "b.r3d", lambda members: members.update({"rgbd/1.conf": b"bvx$"}))
    one_skipped(path, 1, "rgbd/1.conf", "768")


def test_a_bomb_is_refused_by_its_declared_size(tmp_path: Path) -> None:
    bomb = lzfse.compress(bytes(5_000_000))
    path = repacked(tmp_path / "a.r3d", lambda members: members.update({"rgbd/2.depth": bomb}))
    one_skipped(path, 2, "rgbd/2.depth", "5000000")
    archive = bytearray(path.read_bytes())
    entry = archive.rindex(b"rgbd/2.jpg") - 46  # in the central directory
    archive[entry + 24 : entry + 28] = struct.pack("<I", 2**30)
    path.write_bytes(archive)
    one_skipped(path, 2, "rgbd/2.jpg", "declares 1073741824 bytes")
    entry = archive.rindex(b"metadata") - 46
    archive[entry + 24 : entry + 28] = struct.pack("<I", 2**30)
    path.write_bytes(archive)
    refused(path, "metadata: declares 1073741824 bytes; up to 67108864 are read")


def test_no_more_timestamps_are_read_than_there_are_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lengthen(members: dict[str, bytes]) -> None:
        metadata = json.loads(members["metadata"])
        metadata["frameTimestamps"] += ["x"] * 1000
        members["metadata"] = json.dumps(metadata).encode()

    path, read, time = repacked(tmp_path / "a.r3d", lengthen), [], fields.time
    monkeypatch.setattr(fields, "time", lambda value: [read.append(value), time(value)][1])
    assert [frame.timestamp_s for frame in open_capture(path)] == [view.time_s for view in VIEWS]
    assert len(read) == len(VIEWS)


def test_members_with_other_names_are_ignored(tmp_path: Path) -> None:
    extra = {"../../outside.jpg": b"x", "/rgbd/9.jpg": b"x", "rgbd/../7.jpg": b"x", f"rgbd/{'9' * 50}.jpg": b"x"}
    path = repacked(tmp_path / "a.r3d", lambda members: members.update(extra))
    assert open_capture(path).frame_count == 4
    assert not (tmp_path.parent / "outside.jpg").exists()


def test_members_are_found_in_another_case(tmp_path: Path) -> None:
    def upper(members: dict[str, bytes]) -> None:
        for name in list(members):
            members[name.upper()] = members.pop(name)

    path = repacked(tmp_path / "a.r3d", upper)
    for frame, view in zip(open_capture(path), VIEWS, strict=True):
        np.testing.assert_array_equal(frame.depth_m == 0, view.confidence == 0)
    path = repacked(tmp_path / "b.r3d", lambda m: (upper(m), m.update({"RGBD/1.Depth": b"x"})))
    one_skipped(path, 1, "rgbd/1.depth", "only as RGBD/1.DEPTH and RGBD/1.Depth")


def test_archives_without_metadata_or_pictures(tmp_path: Path) -> None:
    refused(
        repacked(tmp_path / "a.r3d", lambda members: members.pop("metadata")), r"metadata\.json: is not in the archive"
    )
    refused(
        repacked(tmp_path / "b.r3d", lambda m: [m.pop(name) for name in list(m) if name.endswith("jpg")]),
        r"no rgbd/N\.jpg",
    )
    (tmp_path / "c.r3d").write_bytes(b"PK")
    refused(tmp_path / "c.r3d", r"c\.r3d: is not a readable zip")


@pytest.mark.parametrize(
    ("kind", "inner"),
    [
        ("polycam", ""), ("polycam", "Küche 1\\"),
        *((kind, "My scan/") for kind in BUILDERS if kind not in ("record3d", "scannet")),
    ],
)  # fmt: skip
def test_a_zipped_folder_is_read_and_leaves_nothing(
    tmp_path: Path, temporary: Path, whole: Callable[[str], Path], kind: str, inner: str
) -> None:
    folder = whole(kind)
    files = [file for file in folder.rglob("*") if file.is_file()]
    members = {f"{inner}{file.relative_to(folder)}": file.read_bytes() for file in files}
    archive = formats.zipped(tmp_path / "scan.ZIP", members | {"__MACOSX/._scan": b"x"})
    capture = open_capture(archive)
    assert (capture.format, capture.path) == (FORMAT_OF[kind], archive)
    same_views(capture, VIEWS, atol=1e-4)
    assert all(file.is_relative_to(temporary) for file in temporary.rglob("*"))
    del capture
    assert not any(temporary.iterdir())


def test_a_zip_of_something_else_is_refused_and_leaves_nothing(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert open_capture(repacked(tmp_path / "a.zip", lambda _: None)).format == "record3d"  # read in place
    refused(
        formats.zipped(tmp_path / "b.zip", {"notes.txt": b"x", "../../out.txt": b"x", "/out.txt": b"x"}),
        r"b\.zip: no capture format recognised",
        error=UnknownFormatError,
    )
    refused(
        formats.zipped(tmp_path / "many.epub", {"0.html": b"x"}),
        r"many\.epub: no capture format recognised",
        error=UnknownFormatError,
    )
    (tmp_path / "c.zip").write_bytes(formats.zipped(tmp_path / "d.zip", {"a": bytes(99)}).read_bytes()[:-9])
    refused(tmp_path / "c.zip", r"c\.zip: does not unpack .*export it again")
    free = shutil.disk_usage(tmp_path)._replace(free=98)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: free)
    refused(tmp_path / "d.zip", r"d\.zip: .*holds 99 bytes, and .* has 98 free")
    assert not any(temporary.iterdir())
    assert not (tmp_path / "out.txt").exists()


@pytest.mark.parametrize("name", ["a.zip", "a.r3d"])
def test_names_in_utf8_without_the_flag_are_read(tmp_path: Path, name: str) -> None:
    """As macOS packs; where the bytes are no UTF-8, they are those of DOS."""
    files = formats.record3d_members(VIEWS[:1])
    if name == "a.zip":
        formats.nerfstudio(folder := tmp_path / "folder", VIEWS[:1])
        renamed = (folder / "images/frame_00001.png").rename(folder / "images/Küche.png")
        index = (folder / "transforms.json").read_bytes().replace(b"frame_00001.png", "Küche.png".encode(), 1)
        (folder / "transforms.json").write_bytes(index)
        assert renamed.is_file()
        files = {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    archive = formats.zipped(tmp_path / name, {f"Küche/{member}": data for member, data in files.items()})
    data = bytearray(archive.read_bytes())
    for mark, flags in ((b"PK\x03\x04", 7), (b"PK\x01\x02", 9)):
        at = -1
        while (at := data.find(mark, at + 1)) >= 0:
            data[at + flags] &= ~8
    archive.write_bytes(data)
    (frame,) = open_capture(archive)
    assert "Küche" in frame.source


def test_what_is_said_of_a_zip_names_the_zip(tmp_path: Path) -> None:
    folder = formats.seven_scenes(tmp_path / "folder", VIEWS)
    (folder / "camera-intrinsics.txt").unlink()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 3
    Image.fromarray(VIEWS[0].srgb8).save(folder / "frame-000000.color.jpg", exif=exif)
    (folder / "frame-000008.color.jpg").write_bytes(b"x")
    archive = formats.zipped(tmp_path / "a.zip", {f"scan/{file.name}": file.read_bytes() for file in folder.iterdir()})
    frames = list(capture := open_capture(archive))
    with pytest.raises(FrameError) as refused:
        capture.frame_at(2)
    (skipped,) = capture.skipped
    said = [skipped.file, skipped.reason, str(refused.value), *(frame.source for frame in frames)]
    notes = [note.left_out for note in capture.notes]
    assert all(text.startswith(f"{archive}/scan") for text in [*said, *notes])
    assert any("525 pixels" in note.effect for note in capture.notes)
    assert any("orientation 3" in text for text in notes)


def test_what_is_said_of_a_zipped_video_names_the_zip(tmp_path: Path) -> None:
    formats.video(tmp_path / "walk.mp4", [np.zeros((24, 32, 3), np.uint8)] * 3)
    archive = formats.zipped(tmp_path / "a.zip", {"walk.mp4": (tmp_path / "walk.mp4").read_bytes()})
    capture = open_capture(archive)
    with pytest.raises(CaptureError, match=f"the first is {re.escape(str(archive))}/walk.mp4: frame 0"):
        list(capture)
    assert capture.notes
    assert all(note.left_out.startswith(f"{archive}/walk.mp4") for note in capture.notes)
