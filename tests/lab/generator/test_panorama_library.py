"""A folder of panoramas: which files, which split, which errors."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from panorama_files import folder_of, panorama

from roomlight.errors import DatasetError
from roomlight.images import write_exr
from roomlight_generator.panoramas import library
from roomlight_generator.panoramas.library import (
    building,
    load_panorama,
    panorama_files,
    panoramas_digest,
    split_files,
    split_of,
)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("brown_photostudio_03.exr", "brown_photostudio"),
        ("brown_photostudio_03_2k.hdr", "brown_photostudio"),
        ("studio_small_09_4k.exr", "studio_small"),
        ("Lounge-2.EXR", "lounge"),
        ("ballroom.exr", "ballroom"),
        ("2024.exr", "2024"),
    ],
)
def test_a_building_is_the_name_without_its_number(name, expected):
    assert building(Path(name)) == expected


def test_a_fifth_of_many_buildings_is_in_test():
    share = np.mean([split_of(Path(f"house {k} a.hdr")) == "test" for k in range(2000)])
    assert abs(share - library.TEST_SHARE) < 0.04  # 4.5 standard deviations


def test_splits_share_no_panorama_and_miss_none(tmp_path):
    folder = folder_of(tmp_path / "in", [f"house {chr(97 + k)}" for k in range(16)], height=16)
    (folder / "index.tsv").write_text("not a panorama")
    train, test = split_files(folder, "train"), split_files(folder, "test")
    assert sorted(train + test) == panorama_files(folder)
    assert len(panorama_files(folder)) == 16


def test_a_split_without_a_panorama_is_an_error(tmp_path):
    name = next(f"house {k} a" for k in range(100) if split_of(Path(f"house {k} a.exr")) == "train")
    folder = folder_of(tmp_path / "in", [name], height=16)
    with pytest.raises(DatasetError, match="1 panoramas show 1 buildings, of which none is in the test split"):
        split_files(folder, "test")


def test_a_folder_without_panoramas_is_an_error(tmp_path):
    with pytest.raises(DatasetError, match=r"holds no panorama; put equirectangular HDR images there, .exr or .hdr"):
        panorama_files(tmp_path)
    with pytest.raises(DatasetError, match=r"cannot be read \(No such file or directory\); name a folder"):
        panorama_files(tmp_path / "missing")


def test_the_digest_is_of_names_and_content(tmp_path):
    first, second = folder_of(tmp_path / "a", ["x", "y"], height=16), folder_of(tmp_path / "b", ["x", "y"], height=16)
    assert panoramas_digest(first) == panoramas_digest(second)
    (second / "y.exr").rename(second / "z.exr")
    assert panoramas_digest(first) != panoramas_digest(second)
    write_exr(first / "x.exr", 2 * panorama(height=16))
    assert panoramas_digest(first) != panoramas_digest(folder_of(tmp_path / "c", ["x", "y"], height=16))


def test_radiance_hdr_files_are_read(tmp_path):
    image = panorama(height=32)
    cv2.imwrite(str(tmp_path / "a.hdr"), image[..., ::-1])
    np.testing.assert_allclose(load_panorama(tmp_path / "a.hdr"), image, rtol=0.02, atol=0.1)


def test_large_panoramas_are_reduced(tmp_path, monkeypatch):
    monkeypatch.setattr(library, "MAX_HEIGHT", 32)
    image = panorama(height=64)
    write_exr(tmp_path / "a.exr", image)
    loaded = load_panorama(tmp_path / "a.exr")
    assert loaded.shape == (32, 64, 3)
    assert loaded.mean() == pytest.approx(image.mean(), rel=1e-3)


@pytest.mark.parametrize(
    ("image", "says"),
    [
        (np.ones((16, 16, 3), np.float32), r"a panorama is twice as wide as high, this is 16 x 16; repair it"),
        (np.zeros((16, 32, 3), np.float32), r"a\.exr: is black; take it out of the folder"),
        (np.ones((8, 16, 3), np.float32), r"a\.exr: has 8 rows, fewer than 16"),
    ],
)
def test_an_unusable_panorama_is_an_error(image, says, tmp_path):
    write_exr(tmp_path / "a.exr", image)
    with pytest.raises(DatasetError, match=says):
        load_panorama(tmp_path / "a.exr")
