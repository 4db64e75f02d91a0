"""Parts of the export: verification inputs, comparison, and the decoder's graph."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from roomlight.errors import ModelError, OutputError
from roomlight_export.folder import new_folder
from roomlight_export.graphs import graphs_of
from roomlight_export.inputs import probe_frames, room_volume
from roomlight_export.onnx_file import half_rounded, to_onnx
from roomlight_export.ort_file import write_ort
from roomlight_export.parity import compare_volumes, difference, torch_runner
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel, VideoModel
from tiny_networks import tiny_network

TINY = ModelConfig(
    SGConfig(volume_shape=(8, 8, 8), channels=4, full_channels=2), BlendConfig(height=8, channels=2, full_channels=2)
)


def test_the_room_exercises_every_input_channel():
    volume = room_volume((64, 60, 84), frame=0)
    assert volume.shape == (1, 5, 64, 60, 84)
    colour, alpha, empty = volume[0, :3], volume[0, 3], volume[0, 4]
    assert set(np.unique(empty)) == {-1.0, 0.0}
    assert 0.02 < (empty == -1).mean() < 0.5
    assert (alpha == 1).any()
    assert ((alpha > 0) & (alpha < 1)).any()
    assert not alpha[empty == -1].any()
    assert colour.max() > 10
    assert not np.array_equal(volume, room_volume((64, 60, 84), frame=1))


def test_probe_frames_stay_in_the_serving_ranges():
    frames = probe_frames(16, frames=4)
    for frame in frames:
        assert frame.single_panels.shape == (1, 8, 16, 32)
        assert np.array_equal(frame.video_panels[:, 3:11], frame.single_panels)
        assert set(np.unique(frame.mask)) == {0.0, 1.0}
        assert (frame.single_panels >= 0).all()
    assert (frames[0].video_panels[:, 12] == 4.0).all()  # nothing seen yet
    assert (frames[-1].video_panels[:, 12] < 4.0).any()


def test_difference_compares_light_in_the_logarithm():
    first, second = np.zeros((1, 1, 1, 10), np.float32), np.zeros((1, 1, 1, 10), np.float32)
    first[..., 0], second[..., 0] = 1000.0, 1001.0
    assert difference("lobes", first, second) == pytest.approx(0.001, rel=0.01)
    second[..., 8] = 0.5
    assert difference("lobes", first, second) == 0.5
    second[..., 8] = np.nan
    assert difference("lobes", first, second) == float("inf")
    assert difference("alpha", np.array([0.5], np.float32), np.array([0.75], np.float32)) == 0.25


def test_a_changed_weight_shows_after_the_recursion():
    """A GRU bias changed by 0.05 must show in hidden states and light."""
    torch.manual_seed(0)
    model = VideoModel(TINY)
    torch.nn.init.normal_(model.sg_decoder.heads.weight)
    good = torch_runner({graph.name: graph for graph in graphs_of(half_rounded(model, "good"))})
    tampered = half_rounded(model, "tampered")
    tampered.get_parameter("sg_gru0.candidate.bias").data += 0.05
    bad = torch_runner({graph.name: graph for graph in graphs_of(tampered)})
    volumes = [room_volume((8, 8, 8), frame=frame) for frame in range(9)]
    same = compare_volumes(good, good, volumes=volumes, recurrent=True)
    assert same.largest == 0
    off = compare_volumes(bad, good, volumes=volumes, recurrent=True)
    assert off.error["h0"] > 1e-2
    assert off.error["lobes"] > 1e-3


def test_half_rounding_leaves_the_original_alone():
    model = SingleModel(TINY)
    before = model.sg_decoder.heads.weight.clone()
    rounded = half_rounded(model, "model")
    assert torch.equal(model.sg_decoder.heads.weight, before)
    weight = rounded.sg_decoder.heads.weight
    assert torch.equal(weight, weight.half().float())
    assert not torch.equal(weight, before)


@pytest.mark.slow
def test_a_graph_exports_and_prints_nothing(tmp_path, capfd):
    torch.manual_seed(1)
    model = half_rounded(SingleModel(TINY), "model")
    graph = next(graph for graph in graphs_of(model) if graph.name == "single_sg_decoder")
    path = tmp_path / "decoder.onnx"
    path.write_bytes(to_onnx(graph, metadata={}).SerializeToString())
    write_ort(path, tmp_path / "decoder.ort", graph, tolerance=1e-5)
    assert (tmp_path / "decoder.ort").stat().st_size > 1000
    assert capfd.readouterr() == ("", "")
    with pytest.raises(ModelError, match=r"decoder\.ort: differs"):
        write_ort(path, tmp_path / "decoder.ort", graph, tolerance=-1.0)


def test_an_export_that_fails_or_whose_folder_fills_meanwhile_replaces_nothing(tmp_path):
    old, other = tmp_path / "model", tmp_path / "photos"
    old.mkdir()
    (old / "model.json").write_text('{"graphs": {}}')

    def stop_halfway():
        with new_folder(old) as folder:
            (folder / "half.onnx").write_text("")
            raise ModelError("stopped")

    def fill_meanwhile():
        with new_folder(other) as folder:
            (folder / "model.json").write_text("{}")
            other.mkdir()
            (other / "cat.jpg").write_text("")

    with pytest.raises(ModelError):
        stop_halfway()
    with pytest.raises(OutputError, match="other files"):
        fill_meanwhile()
    assert [path.name for path in old.iterdir()] == ["model.json"]
    assert [path.name for path in other.iterdir()] == ["cat.jpg"]
    assert {path.name for path in tmp_path.iterdir()} == {"model", "photos"}


def test_the_committed_graphs_of_tests_are_those_of_the_networks(tiny_video: Path):
    """Their numbers are compared in tests/core/engine/test_networks.py."""
    described = json.loads((tiny_video / "model.json").read_text())["graphs"]
    for graph in graphs_of(tiny_network()):
        committed = described.pop(graph.name)
        assert committed["inputs"] == {name: list(shape) for name, shape in graph.inputs.items()}
        assert committed["outputs"] == {name: list(shape) for name, shape in graph.outputs.items()}
    assert not described
