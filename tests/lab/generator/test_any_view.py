"""Single views from anywhere, without probes: the data of networks of depth."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_room import free_space
from panorama_files import folder_of

from fixture_rooms import plain_catalogue
from roomlight.dataset import sequence_files
from roomlight.dataset.loader import Dataset
from roomlight.errors import OptionError
from roomlight_generator.generate import GenerateOptions, generate
from roomlight_generator.room_request import RoomRequest
from roomlight_generator.sequences import any_view
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


@pytest.mark.parametrize("other", [{"scenes": (Path("room.blend"),)}, {"renderer": "own:render"}])
def test_views_of_blender_files_and_of_renderers_are_refused(other: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=f"any_view is True and {next(iter(other))} is given"):
        GenerateOptions(sequences=4, any_view=True, **other)


@pytest.mark.slow
def test_single_views_have_depth_and_no_probes_also_when_stored(coarse_room, monkeypatch: pytest.MonkeyPatch) -> None:
    options = GenerateOptions(sequences=2, sequences_per_room=2, shard_size=2, any_view=True)
    assert options.renderer_name == f"{any_view.__name__}:{any_view.render_views.__name__}"
    monkeypatch.setattr(any_view, "catalogue_for", lambda _: plain_catalogue())
    monkeypatch.setattr(any_view, "solve_lighting", lambda *_, **__: coarse_room)
    (made,) = any_view.render_views(RoomRequest(1, 21, "train", count=1, frames=3))
    recording = sequence_files.decode(sequence_files.encode(made), "here")
    assert recording.depth_mm.shape[0] == 3
    assert (recording.depth_mm > 0).mean() > 0.9
    assert len(recording.probe_positions) == 0


@pytest.mark.usefixtures("no_workers")
def test_a_dataset_of_single_views_is_made(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "panoramas", height=16)
    generate(
        tmp_path / "out",
        GenerateOptions(4, frames=1, any_view=True, panoramas=folder, furniture_share=0.0, shard_size=4),
    )
    assert [len(recording.probe_positions) for recording in Dataset(tmp_path / "out")] == [0] * 4
