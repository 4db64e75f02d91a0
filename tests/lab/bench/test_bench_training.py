"""`roomlight bench train`: the report is complete and consistent. Speed is not tested."""

import json
from dataclasses import replace

import pytest
from rich.console import Console

from recordings import BoxRecordings
from roomlight.errors import ModelError
from roomlight_bench.training.training import TrainCosts, measure_training
from roomlight_cli.console import print_table
from tiny_stages import VIEWS, WALKS

OPTIONS = replace(VIEWS, steps=1000, batch=2, rays=32, sphere_pixels=2)
VIEW_PARTS = ("data", "forward", "render", "backward", "optimiser")
VIDEO_PARTS = ("data", "mesh", "forward", "march", "blend", "backward", "optimiser")


@pytest.fixture(scope="module")
def costs() -> TrainCosts:
    return measure_training(OPTIONS, BoxRecordings(2), steps=2, device="cpu", progress=lambda _: None)


def assert_consistent(costs: TrainCosts) -> None:
    assert tuple(part.name for part in costs.parts) == VIEW_PARTS
    assert all(0 < part.least_ms <= part.median_ms for part in costs.parts)
    assert [part.name for part in costs.parts if part.beside] == ["data"]
    inside = sum(part.least_ms for part in costs.parts if not part.beside)
    assert inside < costs.step_ms
    assert costs.cpu_ms > 0


def test_every_part_of_a_step_is_reported(costs):
    assert_consistent(costs)


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["video-sglv", "video-joint"])
def test_the_parts_of_a_video_step_are_reported(stage):
    options = replace(WALKS, stage=stage, steps=1000, frames=3, window=2)
    costs = measure_training(options, BoxRecordings(3), steps=2, device="cpu", progress=lambda _: None)
    wanted = [name for name in VIDEO_PARTS if stage == "video-joint" or name not in ("mesh", "blend")]
    assert [part.name for part in costs.parts] == wanted
    assert all(0 < part.least_ms <= part.median_ms for part in costs.parts)
    assert [part.name for part in costs.parts if part.beside] == wanted[: wanted.index("forward")]
    assert costs.peak_mb > 10
    assert costs.table().title == (f"A step of {stage}, batch 2 of 3 frames, window 2, volume 16 x 15 x 21, fp32")


def test_the_report_is_readable_and_plain_json(costs):
    console = Console(width=80, record=True, quiet=False, file=None)
    with console.capture() as shown:
        print_table(console, costs.table())
    for part in VIEW_PARTS:
        assert part in shown.get()
    assert "in background" in shown.get()
    assert json.loads(json.dumps(costs.to_json()))["stage"] == "single-sglv"


def test_too_little_data_is_refused_by_the_trainer():
    with pytest.raises(ModelError, match="fewer than a batch"):
        measure_training(OPTIONS, BoxRecordings(1), steps=2, device="cpu", progress=lambda _: None)
