"""Record3D archives: damaged or foreign ones are refused, and a damaged member skips its frame, by file and reason."""

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import formats
import lzfse
import pytest
from capture_checks import one_skipped

from roomlight.captures import open_capture
from roomlight.captures.formats.record3d import _declared_size
from roomlight.errors import CaptureError, UnknownFormatError

VIEWS = formats.scene()


def repacked(path: Path, change: Callable[[dict[str, bytes]], object]) -> Path:
    members = formats.record3d_members(VIEWS)
    change(members)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def test_depth_of_another_size_than_the_metadata_says(tmp_path: Path) -> None:
    short = lzfse.compress(VIEWS[1].depth_m[:12].tobytes())
    path = repacked(tmp_path / "a.r3d", lambda members: members.update({"rgbd/1.depth": short}))
    one_skipped(path, 1, "rgbd/1.depth", "1536 bytes", "3072")
    path = repacked(tmp_path / "b.r3d", lambda members: members.update({"rgbd/1.conf": b"bvx$"}))
    one_skipped(path, 1, "rgbd/1.conf", "768")


def test_a_bomb_is_refused_by_its_declared_size(tmp_path: Path) -> None:
    bomb = lzfse.compress(bytes(5_000_000))
    assert _declared_size(bomb) == 5_000_000
    path = repacked(tmp_path / "a.r3d", lambda members: members.update({"rgbd/2.depth": bomb}))
    one_skipped(path, 2, "rgbd/2.depth", "5000000")
    archive = bytearray(path.read_bytes())
    entry = archive.rindex(b"rgbd/2.jpg") - 46  # in the central directory
    archive[entry + 24 : entry + 28] = struct.pack("<I", 2**30)
    path.write_bytes(archive)
    one_skipped(path, 2, "rgbd/2.jpg", "declares 1073741824 bytes")


def test_members_with_other_names_are_ignored(tmp_path: Path) -> None:
    extra = {"../../outside.jpg": b"x", "/rgbd/9.jpg": b"x", "rgbd/../7.jpg": b"x", f"rgbd/{'9' * 50}.jpg": b"x"}
    path = repacked(tmp_path / "a.r3d", lambda members: members.update(extra))
    assert open_capture(path).frame_count == 4
    assert not (tmp_path.parent / "outside.jpg").exists()


def test_archives_without_metadata_or_pictures(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"metadata\.json: is not in the archive"):
        open_capture(repacked(tmp_path / "a.r3d", lambda members: members.pop("metadata")))
    with pytest.raises(CaptureError, match=r"no rgbd/N\.jpg"):
        open_capture(repacked(tmp_path / "b.r3d", lambda m: [m.pop(name) for name in list(m) if name.endswith("jpg")]))
    (tmp_path / "c.r3d").write_bytes(b"PK")
    with pytest.raises(CaptureError, match=r"c\.r3d: is not a readable zip"):
        open_capture(tmp_path / "c.r3d")


def test_a_zip_is_record3d_only_by_its_listing(tmp_path: Path) -> None:
    assert open_capture(repacked(tmp_path / "a.zip", lambda _: None)).format == "record3d"
    nested = tmp_path / "b.zip"
    with zipfile.ZipFile(nested, "w") as archive:
        for name in ("holiday/transforms.json", "holiday/images/1.png", "notes.txt"):
            archive.writestr(name, b"x")
    with pytest.raises(UnknownFormatError, match=r"b\.zip: .*not a Record3D.*it holds holiday/, notes\.txt\. Unp"):
        open_capture(nested)
    with zipfile.ZipFile(tmp_path / "many.epub", "w") as archive:
        for number in range(9):
            archive.writestr(f"{number}.html", b"x")
    with pytest.raises(UnknownFormatError, match=r"holds 0\.html, .*5\.html and 3 more"):
        open_capture(tmp_path / "many.epub")
    with zipfile.ZipFile(tmp_path / "empty.zip", "w"):
        pass
    with pytest.raises(UnknownFormatError, match="holds nothing"):
        open_capture(tmp_path / "empty.zip")
