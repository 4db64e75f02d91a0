"""`roomlight bench composite` on tiny frames: the report is complete and consistent. Speed is not tested."""

import json

import pytest

from roomlight_bench.compositing.composite import PARTS, CompositeSize, objects, run_composite
from roomlight_bench.compositing.report import PartTimes

SIZE = CompositeSize(width=64, height=48, depth=(32, 24), keyframes=3, panorama_height=16)


@pytest.mark.slow
def test_every_part_of_every_preset_is_reported():
    report = run_composite(frames=1, size=SIZE)
    names = [held.name for held in objects()]
    assert [(row.preset, row.object) for row in report.times] == [(p, n) for p in ("preview", "good") for n in names]
    for row in report.times:
        assert tuple(part.name for part in row.parts) == tuple(PARTS.values())
        assert row.whole.cpu_mean_ms == pytest.approx(sum(part.cpu_mean_ms for part in row.parts))
        assert row.pixels > 0
        assert row.frames == 1
    assert "Open Image Denoise is " in str(report.tables()[0].caption)
    assert len(json.loads(json.dumps(report.to_json()))["criteria"]) == 3


def test_a_part_has_median_percentile_and_mean():
    part = PartTimes.of("light", [1.0, 2.0, 9.0], [0.0, 0.0, 3.0])
    assert (part.wall_median_ms, part.cpu_median_ms, part.cpu_mean_ms) == (2.0, 0.0, 1.0)
    assert part.wall_p95_ms == pytest.approx(8.3)
