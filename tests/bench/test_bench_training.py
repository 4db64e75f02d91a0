"""`roomlight bench train`: the report is complete and true to itself, never how fast."""

import json
from dataclasses import replace

import pytest
from rich.console import Console

from recordings import BoxRecordings
from roomlight.errors import ModelError
from roomlight_bench.training import measure
from roomlight_cli.console import print_table
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.training.clock import PARTS, StepClock
from roomlight_model.training.options import TrainOptions

OPTIONS = TrainOptions(
    steps=1000, batch=2, rays=32, sphere_pixels=2, sphere_samples=4, volume_shape=(16, 15, 21), panorama_height=16,
    bf16=False, model=ModelConfig(sg=SGConfig(channels=4, full_channels=4), blend=BlendConfig(channels=4)),
)  # fmt: skip


@pytest.mark.parametrize("stage", ["single-sglv", "single-blend"])
def test_every_part_of_a_step_is_there(stage):
    told: list[str] = []
    costs = measure(replace(OPTIONS, stage=stage), BoxRecordings(3), steps=3, device="cpu", progress=told.append)
    assert tuple(part.name for part in costs.parts) == PARTS
    assert all(0 < part.least_ms <= part.median_ms for part in costs.parts)
    assert [part.name for part in costs.parts if part.beside] == ["data"]
    inside = sum(part.least_ms for part in costs.parts if not part.beside)
    assert inside < costs.step_ms
    assert costs.cpu_ms > 0
    assert told[-1] == "step 6 of 6"


def test_the_report_is_readable_and_plain_json():
    costs = measure(OPTIONS, BoxRecordings(3), steps=2, device="cpu", progress=lambda _: None)
    console = Console(width=80, record=True, quiet=False, file=None)
    with console.capture() as shown:
        print_table(console, costs.table())
    for part in PARTS:
        assert part in shown.get()
    assert "beside it" in shown.get()
    assert json.loads(json.dumps(costs.to_json()))["stage"] == "single-sglv"


def test_too_little_data_is_the_trainers_own_error():
    with pytest.raises(ModelError, match="fewer than a batch"):
        measure(OPTIONS, BoxRecordings(1), steps=2, device="cpu", progress=lambda _: None)


def test_a_clock_adds_up_what_several_steps_took():
    clock = StepClock()
    for _ in range(3):
        with clock.part("forward"):
            pass
    assert len(clock.wall_ms["forward"]) == len(clock.thread_ms["forward"]) == 3
    assert min(clock.wall_ms["forward"]) >= 0
