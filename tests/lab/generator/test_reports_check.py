"""What the comparison with a path tracer prints and draws, for invented figures."""

from io import StringIO

import numpy as np
from rich.console import Console

from roomlight_generator.reports.check import compose_check, print_check
from roomlight_generator.sequences.surface_kinds import SurfaceKinds
from roomlight_generator.verification.check import CheckReport, ProbeDeviation, RoomCheck, SurfaceDeviation, View
from roomlight_generator.verification.deviation import Deviation


def view(height: int, width: int, factor: float) -> View:
    halves = np.full((2, height, width, 3), 0.5, np.float32)
    return View(halves[0] * np.float32(factor), halves, 0.2, 3.0)


def room(name: str, mean: float, probe: float, *, coated: bool = True, noise: float = 0.01) -> RoomCheck:
    surface = SurfaceDeviation(
        Deviation(100, mean, mean, 0.01, mean), Deviation(100, mean / 2, mean / 2, noise, mean / 2), -0.012
    )
    everywhere = np.ones((30, 40), bool)
    return RoomCheck(
        name=name, about="study, night: floor_lamp", solve_s=1.5, frame=view(30, 40, 1.3), panorama=view(16, 32, 0.7),
        kinds=SurfaceKinds(everywhere, ~everywhere), diffuse=surface, coated=surface if coated else None,
        probe=ProbeDeviation(probe, 0.002, 0.01, 0.003), paths=5000, points_s=10.0,
    )  # fmt: skip


def printed(report: CheckReport) -> str:
    terminal = Console(file=StringIO(), width=80)
    print_check(terminal, report)
    assert isinstance(terminal.file, StringIO)
    return terminal.file.getvalue()


def test_rooms_have_rows_and_means_meet_the_targets() -> None:
    report = CheckReport(
        (room("train-000000", 0.02, 0.01), room("train-000003", 0.06, 0.07, coated=False)), ("no place",)
    )
    text = printed(report)
    assert text.count("train-000003") == 3
    assert "left out: no place" in text
    assert "frames, diffuse surfaces: 4.0 %, 3.9 % without the reference's noise, under the target of 5.0 %" in text
    assert "probes, irradiance: 4.0 %, over the target of 3.0 %" in text
    assert max(len(line.rstrip()) for line in text.splitlines() if "target" not in line) <= 80


def test_rooms_with_a_noisy_reference_are_counted_apart() -> None:
    text = printed(CheckReport((room("train-000000", 0.02, 0.01), room("train-000003", 0.3, 0.07, noise=0.1)), ()))
    assert "in the 1 rooms where the reference knows diffuse blocks to 5.0 %: 1.0 %, 0.0 % without the noise" in text
    assert "over blocks of 4 x 4 pixels: 8.0 %" in text


def test_the_picture_is_red_where_brighter_blue_where_darker() -> None:
    image = compose_check(room("train-000000", 0.1, 0.1))
    frame, probe = image[300, 1200].astype(int), image[550, 1200].astype(int)
    assert frame[0] > 200
    assert frame[2] < 50
    assert probe[2] > 200
    assert probe[0] < 50
