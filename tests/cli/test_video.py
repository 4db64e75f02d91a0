"""The pictures of a replay's video."""

import numpy as np
import pytest

from roomlight_cli.replays.video import MAX_PROBES, ReplayPicture

VIEW = (0.0, 0.0, -1.0)


@pytest.mark.usefixtures("small_pictures")
@pytest.mark.parametrize("probes", [0, 1, 3, MAX_PROBES + 2])
def test_pictures_show_frame_and_probes_at_one_size(probes: int) -> None:
    composer = ReplayPicture([f"probe {n}" for n in range(probes)], views=[VIEW] * probes, frame_size=(64, 48))
    panoramas = [np.full((16, 32, 3), np.float32(0.5)) for _ in range(probes)]
    frame = np.full((48, 64, 3), np.float32(1.0))
    first = composer.compose(frame, panoramas, label="frame 1")
    second = composer.compose(0 * frame, panoramas, label="frame 2")
    assert first.shape == second.shape
    assert first.shape[0] % 2 == first.shape[1] % 2 == 0
    assert int((first == 255).all(axis=-1).sum()) >= 128 * 96
    grey = 188  # 0.5 in sRGB
    assert int((first == grey).all(axis=-1).sum()) >= min(probes, MAX_PROBES) * 2 * 26 * 26


def test_each_probe_needs_a_view() -> None:
    with pytest.raises(ValueError, match="as many views"):
        ReplayPicture(["a"], views=[], frame_size=(64, 48))
