"""A server that is killed while a client streams loses nothing that it promised to keep."""

import pytest

from roomlight_bench.durability import DurabilityOptions, run_durability


@pytest.mark.slow
def test_ten_kills_lose_nothing_older_than_the_interval():
    report = run_durability(DurabilityOptions(kills=10, height=16, frames=8, seed=3))
    assert (report.lost_late, report.broken_promises, report.different) == (0, 0, 0)
    assert report.kills == 10
    assert report.compared >= 20  # two probes after each restart
    assert report.frames > 10
    assert report.disk_bytes > 10**5
    assert report.holds
