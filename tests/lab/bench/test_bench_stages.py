"""`roomlight bench stages` on a tiny room: the report is complete, consistent and readable. Speed is not tested."""

from pathlib import Path

import pytest
from rich.console import Console

from roomlight.errors import ModelError, OptionError
from roomlight_bench.stages import plain_torch, sessions, stages
from roomlight_bench.stages.report import StageRow, StagesReport, judge
from roomlight_bench.stages.room import RoomSize
from roomlight_bench.timing import Implementation, Timing, time_interleaved

SIZE = RoomSize(width=40, height=30, volume_shape=(16, 20, 24), panorama_height=32, samples=100, keyframes=3)
NETWORK_STAGES = ("SGLV network", "3D GRU", "blending network", "2D GRU")
OWN_STAGES = (
    "volume initialisation",
    "ray tracing, network-like volume",
    "ray tracing, classical volume",
    "mesh building",
    "partial-mesh panorama",
    "fill beyond the mesh",
    "accumulation",
    "frame, classical",
    "frame with 4 further probes, classical",
    "late point, classical",
    "16 late points, classical",
)
FRAME_STAGES = ("prepare", "volume", "sglv", "mesh", "keyframes", "render", "partial", "blend", "lights")


@pytest.fixture(scope="module")
def report(tiny_video: Path) -> StagesReport:
    return stages.run_stages(repeats=2, size=SIZE, model=tiny_video)


def row(name: str, *, ours: float, reference: float | None = None, torch: float | None = None) -> StageRow:
    def timing(ms: float | None) -> Timing | None:
        return None if ms is None else Timing(ms, 2 * ms, 3)

    return StageRow(name, Timing(ours, 2 * ours, 3), timing(reference), timing(torch), None, None, "", {})


@pytest.mark.slow
def test_every_stage_has_its_times_and_work(report: StagesReport):
    names = [row.name for row in report.rows]
    assert set(OWN_STAGES) <= set(names)
    for network in NETWORK_STAGES:
        assert any(name.startswith(network) for name in names)
    assert {"frame, video", "late point, video", "16 late points, video"} <= set(names)
    assert {f"{stage}, {model}" for stage in FRAME_STAGES for model in ("classical", "video")} <= set(names)
    for stage in report.rows:
        assert 0 < stage.ours.least_ms <= stage.ours.median_ms
        assert stage.ours.runs == 2
        assert (stage.flops is not None) == stage.name.startswith(NETWORK_STAGES)
    assert sum(stage.paper_ms or 0 for stage in report.rows) == pytest.approx(77.4)  # the paper rounds to 77


@pytest.mark.slow
def test_ours_the_reference_and_pytorch_agree(report: StagesReport):
    by_name = {stage.name: stage for stage in report.rows}
    for name in ("volume initialisation", "ray tracing, network-like volume", "ray tracing, classical volume"):
        # 1e-4 of a ray is dropped, radiance is up to 2; depth and colour are float32
        assert set(by_name[name].differences) == {"reference", "torch"}
        assert max(by_name[name].differences.values()) < 1e-3
    assert max(by_name["accumulation"].differences.values()) < 1e-5
    assert by_name["partial-mesh panorama"].differences["reference"] < 1e-4


@pytest.mark.slow
def test_without_pytorch_all_stages_are_measured(monkeypatch: pytest.MonkeyPatch, tiny_video: Path):
    monkeypatch.setattr(plain_torch, "torch_installed", lambda: False)
    report = stages.run_stages(repeats=1, size=SIZE, model=tiny_video)
    assert set(OWN_STAGES) <= {stage.name for stage in report.rows}
    assert all(stage.torch is None for stage in report.rows)
    console = Console(width=300)
    with console.capture() as capture:
        console.print(*report.tables())
    assert "no comparison with PyTorch" in " ".join(capture.get().split())


def test_another_checkout_is_measured_in_turns(monkeypatch: pytest.MonkeyPatch):
    """Against itself, by a program that answers at once."""
    program = """
import json, sys
for number, _ in enumerate(sys.stdin):
    print(json.dumps({f"frame, {model}": 10.0 - number for model in sys.argv[1:]}), flush=True)
"""
    root = Path(stages.__file__).parents[3]
    monkeypatch.setattr(sessions, "PROGRAM", ("-c", program))
    report = stages.run_against(root, rounds=2)
    assert [(row.name, row.here_ms, row.there_ms) for row in report.rows] == [
        ("frame, classical", 8.0, 8.0), ("frame, single", 8.0, 8.0),
    ]  # fmt: skip
    console = Console(width=100)
    with console.capture() as capture:
        console.print(*report.tables())
    assert "1.00" in capture.get()
    monkeypatch.setattr(sessions, "PROGRAM", ("-c", "raise SystemExit(1)"))
    with pytest.raises(OptionError, match="cannot be measured"):
        stages.run_against(root, rounds=1)


@pytest.mark.slow
def test_frames_of_this_checkout_are_measured_by_the_program():
    with sessions._Measuring(Path(stages.__file__).parents[3], ("classical",)) as process:
        measured = process.round()
    assert set(measured) == {name for name in OWN_STAGES if "classical" in name and "volume" not in name}


def test_other_folders_are_refused(tmp_path):
    with pytest.raises(ModelError, match=r"model\.json"):
        stages.run_stages(repeats=1, model=tmp_path, size=SIZE)
    with pytest.raises(OptionError, match="no checkout of RoomLight"):
        stages.run_against(tmp_path, rounds=1)


def test_criteria_hold_and_fail_at_their_limits():
    rows = [
        row("volume initialisation", ours=1.0, reference=5.0),
        row("ray tracing, network-like volume", ours=1.0, torch=29.9),
        row("SGLV network, ONNX Runtime fp32", ours=100.0),
        row("SGLV network, OpenVINO fp32", ours=30.0),
        row("mesh building", ours=5.0),
        row("partial-mesh panorama", ours=6.0),
        row("frame, single", ours=50.0),
        row("frame with 4 further probes, single", ours=81.0),
        row("late point, single", ours=10.0),
        row("16 late points, single", ours=41.0),
    ]
    initialisation, march, further, late, panorama, both = judge(rows)
    assert further.holds
    assert further.measured == pytest.approx(31 / 4)
    assert not late.holds
    assert initialisation.holds
    assert not march.holds
    assert panorama.holds
    assert both.measured == pytest.approx(11 / 30)  # of the faster runtime
    assert not both.holds


def test_implementations_are_timed_interleaved():
    order: list[str] = []
    implementations = [
        Implementation(lambda: order.append("a")),
        Implementation(lambda: order.append("b"), max_runs=2, scale=1000.0),
    ]
    progress: list[str] = []
    first, second = time_interleaved(implementations, 3, progress=progress.append)
    assert order == ["a", "b", "a", "b", "a"]
    assert (first.runs, second.runs) == (3, 2)
    assert progress[-1] == "timing, round 3 of 3"


@pytest.mark.slow
def test_operations_of_networks_are_counted_by_layer(report: StagesReport):
    """The 2D GRU's convolutions: 3 x 3, gates 2C to 2C and candidate 2C to C, at a half and an eighth of the size."""
    row = next(row for row in report.rows if row.name.startswith("2D GRU"))
    half, eighth = 16 * 32, 4 * 8
    outputs_times_inputs = half * (8 * 8 + 8 * 4) + eighth * (32 * 32 + 32 * 16)
    assert row.flops == 2 * 9 * outputs_times_inputs
