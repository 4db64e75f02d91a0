"""Later frames predicted from the frames before them: what is compared, in which directions, and with what."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from roomlight.engine.session import SessionOptions
from roomlight.errors import CaptureError, OptionError
from roomlight_cli.console import print_table
from roomlight_evaluation.captures.view_tables import view_table
from roomlight_evaluation.captures.views import HEIGHT, REGIONS, View, ViewScore, ViewScores, evaluate_views
from rooms import BoxRoom, camera_at, pan
from written_captures import write_capture

STEP_DEG, AHEAD = 12.0, 3
ROOM = BoxRoom()


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Nine frames of a camera that turns about itself by 12 degrees each; it sees 75."""
    return write_capture(tmp_path_factory.mktemp("views") / "box", pan(ROOM, 9, step_degrees=STEP_DEG))


@pytest.fixture(scope="module")
def scores(capture, tiny_video):
    model = SessionOptions(model="video", weights=tiny_video[1], height=HEIGHT)
    return evaluate_views([capture], [model], ahead=AHEAD, spacing=2)


@pytest.mark.parametrize("yaw", [0.0, 170.0])
def test_a_view_is_the_room_in_the_shown_directions(yaw):
    """Tolerance: the mean over a panorama's pixel, of a texture, against its centre."""
    position = (0.4, 1.3, -0.3)
    view = View.of(ROOM.frame(camera_at(position, yaw), width=320, height=240))
    truth, _ = ROOM.panorama(position, HEIGHT)
    assert 0.05 < view.shown.mean() < 0.25
    error = abs(view.radiance - truth)[view.shown].max(axis=-1)
    assert np.median(error) < 0.01
    assert np.mean(error < 0.05) > 0.9  # the others are at the room's edges


def test_the_truth_has_no_error_and_twice_the_light_has():
    view = View.of(ROOM.frame(camera_at((0.4, 1.3, -0.3)), width=320, height=240))
    assert view.error(view.radiance, view.shown) == 0
    wanted = np.square(np.log1p(2 * view.radiance) - np.log1p(view.radiance))[view.shown].mean()
    assert view.error(2 * view.radiance, view.shown) == pytest.approx(wanted, rel=0.02)  # weighted by solid angle


def test_a_clipped_pixel_is_a_lower_bound():
    frame = ROOM.frame(camera_at((0.4, 1.3, -0.3)), width=320, height=240)
    view = View.of(replace(frame, clipped=np.ones_like(frame.clipped)))
    assert view.error(10 * view.radiance, view.shown) == 0
    assert view.error(view.radiance / 2, view.shown) > 0


def test_directions_are_unseen_as_far_as_the_camera_turned(scores):
    """The camera turns by 36 of 75 degrees in three frames."""
    assert {score.frame for score in scores.scores} == {3, 5, 7}
    assert scores.share("unseen") == pytest.approx(AHEAD * STEP_DEG / 75, abs=0.12)
    assert scores.share("seen") + scores.share("unseen") == pytest.approx(1)


def test_seen_directions_are_known_and_unseen_are_not(scores):
    assert scores.methods == ("mean colour", "warp and fill", "video", "classical")
    assert scores.mean("classical", "seen").mean < 0.1 * scores.mean("mean colour", "seen").mean
    assert scores.mean("classical", "seen").mean < 0.1 * scores.mean("classical", "unseen").mean
    ratio = scores.ratio("classical", "unseen")
    assert ratio.low == ratio.mean == ratio.high == 1


def test_no_method_gets_the_predicted_frame_or_later_ones(scores, tmp_path):
    """Other pictures from the first predicted frame on change no estimate of it: its errors follow the new picture."""
    frames = pan(ROOM, 9, step_degrees=STEP_DEG)
    frames[AHEAD:] = [replace(frame, image=np.full_like(frame.image, 0.3)) for frame in frames[AHEAD:]]
    changed = evaluate_views([write_capture(tmp_path / "box", frames)], [], ahead=AHEAD, spacing=2)
    colour = ROOM.frame(camera_at((0.3, 1.4, 0.2))).image.mean(axis=(0, 1))
    wanted = np.square(np.log1p(colour) - np.log1p(0.3)).mean()
    found, before = (
        next(one.error for one in made.scores if one.method == "mean colour" and one.frame == AHEAD)
        for made in (changed, scores)
    )
    assert found == pytest.approx(wanted, rel=0.05)
    assert found != pytest.approx(before, rel=0.05)


def test_scores_are_a_table_and_json(scores, tmp_path):
    console = Console(width=80, record=True, color_system=None, force_terminal=False)
    print_table(console, view_table(scores))
    text = console.export_text()
    assert "unseen" in text
    assert "1.00 (1.00-1.00)" in text
    scores.write(tmp_path / "views.json")
    written = json.loads((tmp_path / "views.json").read_text())
    assert written["ahead"] == AHEAD
    assert len(written["summary"]) == len(scores.methods) * len(REGIONS)
    assert len(written["scores"]) == len(scores.scores)


def test_means_are_over_views_and_ratios_of_means():
    made = [
        ViewScore("room", frame, method, "seen", error, 1.0)
        for frame, errors in enumerate([(1.0, 3.0), (2.0, 1.0)])
        for method, error in zip(("classical", "video"), errors, strict=True)
    ]
    scores = ViewScores(5, tuple(made))
    assert scores.mean("video", "seen").mean == 2
    assert scores.ratio("video", "seen").mean == pytest.approx(4 / 3)
    assert np.isnan(scores.mean("video", "unseen").mean)


def test_wrong_options_and_short_captures_are_refused(capture):
    with pytest.raises(OptionError, match="ahead and spacing must be at least 1 frame, got 0 and 5"):
        evaluate_views([capture], [], ahead=0)
    with pytest.raises(OptionError, match="classical is always scored"):
        evaluate_views([capture], [SessionOptions(model="classical")])
    with pytest.raises(CaptureError, match="more than 9 usable frames"):
        evaluate_views([capture], [], ahead=9)
