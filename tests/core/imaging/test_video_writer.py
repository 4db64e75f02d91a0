import resource
from pathlib import Path

import av
import numpy as np
import pytest

from roomlight.captures.video import VideoFrames
from roomlight.conventions import linear_to_srgb8
from roomlight.errors import OptionError, OutputError
from roomlight.imaging.video_writer import VideoWriter, join_videos


def picture(value: int, height: int = 48, width: int = 64) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def write_video(path: Path, *pictures: np.ndarray, ends_with: BaseException | None = None) -> None:
    with VideoWriter(path) as video:
        for image in pictures:
            video.write(image)
        if ends_with is not None:
            raise ends_with


def test_a_video_plays_back_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "out" / "replay.mp4"
    levels = [30, 90, 150, 210, 120]
    with VideoWriter(path, frames_per_second=5.0) as video:
        for level in levels:
            video.write(picture(level, 49, 65))
        assert not path.exists()
    assert [entry.name for entry in path.parent.iterdir()] == ["replay.mp4"]
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.average_rate == 5
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * len(levels)
    # grey through limited-range YUV and back at crf 18 moves by a few levels
    assert [float(frame.mean()) for frame in frames] == pytest.approx(levels, abs=4)


def test_pictures_with_a_few_rows_more_or_less_are_centred(tmp_path: Path) -> None:
    """Pictures whose lenses were removed one by one differ by some rows."""
    rows = np.repeat(np.arange(48, dtype=np.uint8)[:, None] * 5, 64, axis=1)
    image = np.repeat(rows[..., None], 3, axis=2)
    write_video(tmp_path / "a.mp4", image, image[2:46], np.pad(image, ((2, 2), (0, 0), (0, 0)), mode="edge"))
    with av.open(str(tmp_path / "a.mp4")) as container:
        shown = [frame.to_ndarray(format="rgb24")[24].mean() for frame in container.decode(video=0)]
    assert shown == pytest.approx([120] * 3, abs=4)


def test_colours_are_those_of_the_tags_also_of_a_joined_video(tmp_path: Path) -> None:
    red, part, longer = (200, 40, 40), tmp_path / "part.mp4", tmp_path / "longer.mp4"
    write_video(part, np.full((48, 64, 3), red, np.uint8))
    write_video(longer, *[np.full((48, 64, 3), red, np.uint8)] * 5)  # stored out of order
    join_videos([part, longer, part], tmp_path / "whole.mp4")
    for path in (part, tmp_path / "whole.mp4"):
        with av.open(str(path)) as container:
            frames = list(container.decode(video=0))
            assert [frame.time for frame in frames] == pytest.approx([0.1 * n for n in range(len(frames))])
            for frame in frames:
                assert (frame.colorspace, frame.color_primaries, frame.color_trc, frame.color_range) == (1, 1, 13, 1)
        with VideoFrames(path, path.name) as read:
            linear = read.frame(0).image.mean(axis=(0, 1))
            assert linear_to_srgb8(linear).tolist() == pytest.approx(red, abs=2)


def test_an_old_video_stays_until_the_new_one_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "replay.mp4"
    path.write_bytes(b"old")
    with pytest.raises(RuntimeError):
        write_video(path, picture(10), ends_with=RuntimeError())
    assert path.read_bytes() == b"old"


def test_a_full_disk_is_told_as_such(tmp_path: Path) -> None:
    """The film ends a second time because of the first error, as a replay's does."""
    video, limits = VideoWriter(tmp_path / "a.mp4"), resource.getrlimit(resource.RLIMIT_FSIZE)
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        for _ in range(3):
            video.write(noise)
        with pytest.raises(OutputError, match="File too large") as full:
            video.__exit__(None, None, None)
        video.__exit__(OutputError, full.value, None)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_what_makes_no_video_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    write_video(tmp_path / "replay.mp4")  # no pictures
    with pytest.raises(ValueError, match="the video is 64 x 48"):
        write_video(tmp_path / "b.mp4", picture(10), picture(10, 48, 32))
    for rate in (0.0, -1.0, float("nan"), 1e6):
        with pytest.raises(OptionError, match="frames_per_second"):
            VideoWriter(tmp_path / "a.mp4", frames_per_second=rate)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"replay\.mp4"):
        write_video(tmp_path / "file" / "replay.mp4", picture(10))
    for name in ("a" * 252 + ".mp4", "a" * 246 + ".mp4"):  # the temporary name is too long as well
        with pytest.raises(OutputError, match="name too long"):
            write_video(tmp_path / name, picture(10))
        with pytest.raises(OutputError, match="cannot be written"):
            join_videos([tmp_path / "none.mp4"], tmp_path / name)
