"""Single views from anywhere, without probes: the data of networks of depth."""

from pathlib import Path

import numpy as np
import pytest
from analytic_room import free_space

from roomlight.dataset.loader import Dataset
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_generator.sequences.any_view import SIZE, draw_views


def test_views_look_anywhere_from_anywhere_and_are_not_blocked() -> None:
    free = free_space()
    paths = [draw_views(free, np.random.default_rng(seed), frames=12) for seed in range(12)]
    poses = np.concatenate([path.poses for path in paths])
    assert np.allclose(poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.eye(3), atol=1e-9)
    assert np.ptp(poses[:, 1, 3]) > 1.2
    headings = np.arctan2(-poses[:, 2, 2], -poses[:, 0, 2])
    assert len(np.unique(np.floor(headings / (np.pi / 4)))) == 8
    assert {(path.intrinsics.width, path.intrinsics.height) for path in paths} == {SIZE, SIZE[::-1]}
    assert all(len(path.probes) == 0 for path in paths)


def test_a_room_without_floor_has_no_views() -> None:
    free = free_space()
    blocked = type(free)(np.zeros_like(free.walkable), free.origin, free.cell_m, free.distances)
    with pytest.raises(ValueError, match="no free place for a camera"):
        draw_views(blocked, np.random.default_rng(0), frames=1)


@pytest.mark.slow
def test_a_dataset_of_single_views_has_depth_and_no_probes(tmp_path: Path) -> None:
    options = GenerateOptions(sequences=2, frames=3, sequences_per_room=2, shard_size=2, any_view=True)
    generate(tmp_path / "views", options, workers=1)
    recording = Dataset(tmp_path / "views", "train")[0]
    assert recording.depth_mm.shape[0] == 3
    assert (recording.depth_mm > 0).mean() > 0.9
    assert len(recording.probe_positions) == 0
