"""A server that is killed while a client streams loses nothing that it promised to keep."""

import pytest

from roomlight_bench.server.durability import DurabilityOptions, run_durability


@pytest.mark.slow
@pytest.mark.parametrize(("model", "kills"), [("classical", 10), ("single", 3), ("video", 3)])
def test_kills_lose_nothing_older_than_the_interval(model, kills):
    """The video model carries hidden states from frame to frame."""
    report = run_durability(DurabilityOptions(model, kills=kills, height=16, frames=8, seed=3))
    assert (report.lost_late, report.broken_promises, report.different) == (0, 0, 0)
    assert (report.model, report.kills) == (model, kills)
    assert report.compared >= 2 * kills  # two probes after each restart
    assert report.frames > kills
    assert report.disk_bytes > 10**5
    assert report.seconds > 0
    assert report.holds
