"""Scores of the main light's direction on captures: errors, jumps, light from below, and the truths compared with."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from roomlight.camera import Intrinsics
from roomlight.conventions import panorama_directions
from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError
from roomlight.files import json_text
from roomlight.frame import Frame
from roomlight_cli.console import print_table
from roomlight_evaluation.captures.main_light import (
    METHODS,
    DirectionTrack,
    MainLightScores,
    evaluate_main_lights,
    main_light_table,
)
from written_captures import write_capture

UP, EAST, DOWN = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])


def unit(*vector):
    return np.array(vector, np.float64) / np.linalg.norm(vector)


def lit(height, lamps, level=0.1):
    panorama = np.full((height, 2 * height, 3), level, np.float32)
    for direction, radius_deg, radiance in lamps:
        panorama[panorama_directions(height) @ direction > np.cos(np.radians(radius_deg))] = radiance
    return panorama


def capture_of(path: Path, *, probes=(), depth_m: float = 2.0) -> Path:
    """A grey wall two metres ahead with a white patch in its upper right; truths with a lamp there."""
    image = np.full((30, 40, 3), np.float32(0.2))
    image[4:9, 26:33] = 1.0
    depth, intrinsics = np.full((30, 40), depth_m, np.float32), Intrinsics(32.0, 32.0, 20.0, 15.0, 40, 30)
    frames = [Frame(index, image, image[..., 0] >= 1, depth, intrinsics, np.eye(4)) for index in range(6)]
    lamp = lit(32, [(unit(0.3, 0.3, -1), 15, 9.0)])
    return write_capture(path, frames, probes=[(position, lamp) for position in probes])


def tracks(directions, truth=None):
    return [DirectionTrack("room", 0, method, tuple(directions), truth) for method in METHODS]


def test_jumps_count_from_the_fifth_frame_on() -> None:
    before, after = [EAST, UP, EAST, UP, EAST], [unit(1, 0.5, 0), UP]
    summary = MainLightScores(tuple(tracks([*before, *after]))).summary("tracked")
    assert (summary.jumps, summary.steps) == (2, 2)
    assert summary.largest_jump_deg == pytest.approx(np.degrees(np.arctan2(1, 0.5)))
    assert MainLightScores(tuple(tracks(before))).summary("tracked").steps == 0


def test_share_below_is_of_all_frames() -> None:
    scores = MainLightScores(tuple(tracks([UP, DOWN, unit(1, -0.01, 0), EAST])))
    assert scores.summary("tracked").below == scores.tracks[0].below == 0.5


def test_errors_are_means_over_probes_with_intervals() -> None:
    near, far = tracks([UP, UP], UP), tracks([EAST, EAST, unit(1, 1, 0)], UP)
    summary = MainLightScores((*near, *far)).summary("tracked")
    assert summary.error_deg.mean == pytest.approx((0 + (90 + 90 + 45) / 3) / 2)
    assert summary.last_error_deg.mean == pytest.approx(45 / 2)
    assert summary.error_deg.low <= summary.error_deg.mean <= summary.error_deg.high
    assert np.isnan(MainLightScores(tuple(tracks([UP]))).summary("tracked").error_deg.mean)
    captures = [
        replace(track, capture=name) for name, of in (("a", near), ("b", far)) for track in of for _ in range(9)
    ]
    rooms = [replace(track, capture=f"{track.capture}{n}", room=track.capture) for n, track in enumerate(captures)]
    for grouped in (captures, rooms):  # two captures, two rooms, not 18 probes
        alike = MainLightScores(tuple(grouped)).summary("tracked").last_error_deg
        assert (alike.low, alike.high) == pytest.approx((0, 45))


@pytest.mark.slow
def test_every_method_is_scored_at_every_probe(tmp_path) -> None:
    capture = capture_of(tmp_path / "room", probes=[(0.0, 0.0, -1.0), (0.2, 0.0, -1.0)])
    seen = []
    scores = evaluate_main_lights([capture], SessionOptions(height=32), progress=lambda *state: seen.append(state))
    assert {(track.probe, track.method) for track in scores.tracks} == {(n, m) for n in (0, 1) for m in METHODS}
    assert seen[-1] == ("room", 6, 6)
    for track in scores.tracks:
        assert len(track.directions) == 6
        assert track.truth is not None
        assert np.degrees(np.arccos(track.truth @ unit(0.3, 0.3, -1))) < 3
    assert scores.summary("tracked").largest_jump_deg < 10.001
    written = json.loads(json_text(scores.to_json()))["tracks"]
    np.testing.assert_array_equal([track["truth"] for track in written], [track.truth for track in scores.tracks])


def test_a_capture_without_truth_is_scored_for_jumps(tmp_path) -> None:
    capture = capture_of(tmp_path / "room")
    (capture / "facts.json").write_text('{"room": "hall"}')
    scores = evaluate_main_lights([capture], SessionOptions(height=32))
    assert {track.room for track in scores.tracks} == {"hall"}
    assert all(track.truth is None for track in scores.tracks)
    console = Console(width=120, record=True)
    print_table(console, main_light_table(scores))
    text = console.export_text()
    assert "Main light, probes: 1" in text
    assert "ground truth (0)" in " ".join(text.split())


def test_captures_that_cannot_be_used_are_refused(tmp_path) -> None:
    with pytest.raises(CaptureError, match="no pixel has a known depth"):
        evaluate_main_lights([capture_of(tmp_path / "room", depth_m=0.0)], SessionOptions(height=32))
    with pytest.raises(CaptureError, match="nowhere"):
        evaluate_main_lights([tmp_path / "nowhere"], SessionOptions(height=32))
