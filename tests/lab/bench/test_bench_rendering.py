"""`roomlight bench rendering`: importance sampling aliases less than a grid; table, JSON and picture."""

import json

import cv2
import numpy as np
import pytest
from rich.console import Console

from present import present
from roomlight_bench.training.rendering import compare_sampling


@pytest.fixture(scope="module")
def report():
    panorama = np.full((60, 120, 3), 0.1, np.float32)
    panorama[12:14, 20:22] = 60.0  # a lamp of 6 degrees, behind the camera's left shoulder
    return compare_sampling(panorama, (0.0, 0.0, -1.0), counts=(16, 64), size=40)


def test_importance_sampling_aliases_less_at_every_count(report):
    """Noise may be as large as the grid's error, but it averages out between neighbours; aliasing does not."""
    assert [error.samples for error in report.errors] == [16, 64]
    for error in report.errors:
        assert error.importance_blurred < 0.85 * error.uniform_blurred


def test_both_samplings_agree_in_even_light():
    """Both light the same sphere: their differences in other light come from the sampling."""
    even = compare_sampling(np.full((16, 32, 3), 0.5, np.float32), (0.0, 0.0, -1.0), counts=(1024,), size=16)
    facing = even.renderer.normals[:, 2] > 0.5
    uniform, importance = even.spheres[1024, "uniform"][facing], even.spheres[1024, "importance"][facing]
    # a grid of 5.6 degrees under a lobe of 4: good to a few hundredths of the coat's share
    np.testing.assert_allclose(uniform, importance, atol=0.03)
    assert np.abs(importance - even.reference[facing]).mean() < 0.005


def test_table_json_and_picture(report, tmp_path):
    console = Console(width=100)
    with console.capture() as shown:
        console.print(report.table())
    assert f"{report.errors[0].uniform:.4f}" in shown.get()
    assert json.loads(json.dumps(report.to_json()))["errors"][1]["samples"] == 64
    report.write_picture(tmp_path / "spheres.png")
    picture = present(cv2.imread(str(tmp_path / "spheres.png")))
    assert picture.shape[0] > 2 * 40
    assert picture.shape[1] > 3 * 40
