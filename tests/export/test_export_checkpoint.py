"""`export_checkpoint` end to end on small networks: the folder's contents and the verification against PyTorch."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from export_models import CARD, CONFIG, SHAPE
from onnx import TensorProto, numpy_helper

from roomlight.errors import ModelError, OutputError
from roomlight_cli.commands.export import warn_of_untrained
from roomlight_export import exporting
from roomlight_export.exporting import RECURRENT_STEPS, export_checkpoint
from roomlight_export.graphs import graphs_of
from roomlight_export.inputs import room_volume
from roomlight_model.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from roomlight_model.config import ModelConfig
from roomlight_model.networks import SingleModel, VideoModel
from untrained import save_untrained

SINGLE = {f"single_{kind}_{part}" for kind in ("sg", "blend") for part in ("encoder", "decoder")}
VIDEO = {f"video_{kind}_{part}" for kind in ("sg", "blend") for part in ("encoder", "gru", "decoder")}


def test_model_json_describes_the_folder(exported):
    names = SINGLE if exported.form == "single" else SINGLE | VIDEO
    described = json.loads((exported.folder / "model.json").read_text())
    assert described["format"] == 1
    assert described["form"] == exported.form
    assert described["opset"] >= 20
    assert described["card"] == CARD
    assert ModelConfig.from_dict(described["config"]) == CONFIG
    assert set(described["graphs"]) == set(exported.report.graphs) == names
    assert {path.stem for path in exported.folder.glob("*.onnx")} == names
    assert {path.stem for path in exported.folder.glob("ort/*.ort")} == names
    for name, graph in described["graphs"].items():
        onnx_file = exported.folder / f"{name}.onnx"
        assert graph["sha256"] == hashlib.sha256(onnx_file.read_bytes()).hexdigest()
        session = onnxruntime.InferenceSession(onnx_file, providers=["CPUExecutionProvider"])
        assert {entry.name: entry.shape for entry in session.get_inputs()} == graph["inputs"]
        assert {entry.name: entry.shape for entry in session.get_outputs()} == graph["outputs"]
    assert not list(exported.folder.parent.glob(".*"))


def test_video_graphs_take_the_previous_state():
    graphs = {graph.name: graph for graph in graphs_of(VideoModel(CONFIG))}
    assert set(graphs) == SINGLE | VIDEO
    assert graphs["video_sg_decoder"].inputs["lobes_previous"] == (*SHAPE, 10)
    assert {name for name in graphs if "unit" in graphs[name].inputs} == {"video_sg_encoder", "video_sg_decoder"}
    assert graphs["video_blend_encoder"].inputs == {"panels": (1, 13, 18, 36)}
    assert graphs["video_sg_gru"].inputs["h0"] == graphs["video_sg_gru"].outputs["h0_next"]


def test_parity_is_far_inside_the_tolerance(exported):
    """Both sides have half-rounded weights: what remains is the order of summation, over 8 recurrent steps."""
    assert set(exported.report.parity) == {"sg", "blend"}
    for parity in exported.report.parity.values():
        assert parity.steps == RECURRENT_STEPS + 1 >= 9
        assert 0 < parity.largest < 1e-4
    described = json.loads((exported.folder / "model.json").read_text())
    assert described["parity"]["sg"]["error"] == exported.report.parity["sg"].error


def test_weights_are_stored_in_half_precision(exported):
    held, report = 0, exported.report
    for path in exported.folder.glob("*.onnx"):
        model = onnx.load(path)
        for tensor in model.graph.initializer:
            if numpy_helper.to_array(tensor).size > 1:
                assert tensor.data_type in (TensorProto.FLOAT16, TensorProto.INT64)
                held += numpy_helper.to_array(tensor).size * (tensor.data_type == TensorProto.FLOAT16)
    # single numbers stay float32, and graphs have some constants besides their weights
    assert 0.99 * report.parameters < held < 1.01 * report.parameters
    # two bytes for a weight and 12 kB of structure for a graph
    assert 2 * held < report.onnx_bytes < 2 * held + len(report.graphs) * 13_000
    assert report.ort_bytes > report.onnx_bytes


def test_graphs_carry_config_and_card_but_no_local_paths(exported):
    for path in exported.folder.glob("*.onnx"):
        model = onnx.load(path)
        kept = {entry.key: entry.value for entry in model.metadata_props}
        assert kept["roomlight.graph"] == path.stem
        assert kept["roomlight.form"] == exported.form
        assert json.loads(kept["roomlight.config"]) == CONFIG.to_dict()
        assert json.loads(kept["roomlight.card"]) == CARD
        assert {entry.domain: entry.version for entry in model.opset_import}[""] >= 20
        assert not any(node.op_type == "ConvTranspose" for node in model.graph.node)
        assert b".py" not in path.read_bytes()


def test_the_graphs_predict_what_the_checkpoint_does(single):
    """Float32 weights in PyTorch against the files. Half precision may cost 1e-2."""
    model = load_checkpoint(single.checkpoint).model
    volume = room_volume(SHAPE, frame=3, seed=1)
    with torch.inference_mode():
        wanted = model(torch.from_numpy(volume))
    encoder, decoder = (
        onnxruntime.InferenceSession(single.folder / f"single_sg_{part}.onnx") for part in ("encoder", "decoder")
    )
    f0, f1 = encoder.run(["f0", "f1"], {"volume": volume})
    alpha, lobes = (
        np.asarray(value) for value in decoder.run(["alpha", "lobes"], {"f0": f0, "f1": f1, "volume": volume})
    )
    assert np.abs(alpha - wanted.alpha[0].numpy()).max() < 1e-2
    assert np.abs(np.log1p(lobes[..., :7]) - np.log1p(wanted.lobes[0, ..., :7].numpy())).max() < 1e-2
    empty = volume[0, 4] == -1
    assert empty.any()
    assert not alpha[empty].any()
    assert not lobes[empty].any()


def test_phone_files_run(exported):
    random = np.random.default_rng(0)
    for graph in graphs_of(load_checkpoint(exported.checkpoint).model):
        path = exported.folder / "ort" / f"{graph.name}.ort"
        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        inputs = {name: random.random(shape, np.float32) for name, shape in graph.inputs.items()}
        outputs = [np.asarray(output) for output in session.run(None, inputs)]
        assert [np.shape(output) for output in outputs] == list(graph.outputs.values())
        assert all(np.isfinite(output).all() for output in outputs)


@pytest.fixture
def traced(single, monkeypatch):
    """Skip tracing and use the graphs that were exported before: tracing again takes seconds and changes nothing."""
    monkeypatch.setattr(exporting, "to_onnx", lambda graph, **_: onnx.load(single.folder / f"{graph.name}.onnx"))


@pytest.mark.usefixtures("traced")
def test_past_the_tolerance_nothing_is_written(single, tmp_path):
    with pytest.raises(ModelError, match=r"differ from PyTorch by .* in \w+ over 9 frames"):
        export_checkpoint(single.checkpoint, tmp_path / "out", tolerance=0.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("traced")
def test_graphs_of_another_checkpoint_are_refused(tmp_path):
    """Only the comparison with PyTorch keeps graphs of other weights from a server."""
    save_untrained(tmp_path / "other.pt", "single", CONFIG, seed=3)
    with pytest.raises(ModelError, match="differ from PyTorch"):
        export_checkpoint(tmp_path / "other.pt", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["other.pt"]


@pytest.mark.usefixtures("traced")
def test_networks_that_no_stage_trained_are_reported(single, tmp_path, capsys):
    network = load_checkpoint(single.checkpoint).model
    sglv, joint = ({"steps": 2, "stage": f"single-{end}"} for end in ("sglv", "joint"))
    for card, untrained in (
        ({**sglv, "before": sglv}, ("blending",)),
        ({**joint, "before": sglv}, ()),
        ({**sglv, "before": {"steps": 1}}, ()),
        ({}, ()),
    ):
        save_checkpoint(tmp_path / "weights.pt", network, card=card)
        report = export_checkpoint(tmp_path / "weights.pt", tmp_path / "out", ort=False)
        assert report.untrained == untrained
    video = {"steps": 2, "stage": "video-sglv", "before": joint}  # single-view stages train no recurrent network
    left = exporting._untrained(Checkpoint("video", CONFIG, VideoModel(CONFIG), video))
    warn_of_untrained(replace(report, form="video", untrained=left))
    assert "its blending network had no stage of its own, so its light may be wrong" in capsys.readouterr().err


@pytest.mark.usefixtures("traced")
def test_an_old_model_is_replaced_and_nothing_printed(single, tmp_path, capfd):
    out = tmp_path / "model"
    out.mkdir()
    (out / "model.json").write_text('{"graphs": {}}')
    (out / "stale.onnx").write_text("old")
    messages: list[str] = []
    report = export_checkpoint(single.checkpoint, out, ort=False, progress=messages.append)
    assert report.untrained == ()
    assert {path.name for path in out.iterdir()} == {f"{name}.onnx" for name in SINGLE} | {"model.json"}
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
    assert len(messages) == 5
    assert capfd.readouterr() == ("", "")


def test_refuses_places_that_are_not_for_models(single, tmp_path):
    checkpoint = single.checkpoint
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        export_checkpoint(checkpoint, tmp_path / "file")
    with pytest.raises(OutputError, match="cannot be written"):
        export_checkpoint(checkpoint, tmp_path / "file" / "model")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("")
    with pytest.raises(OutputError, match="other files"):
        export_checkpoint(checkpoint, tmp_path / "photos")
    (tmp_path / "photos" / "model.json").write_text("[]")
    with pytest.raises(OutputError, match="other files"):
        export_checkpoint(checkpoint, tmp_path / "photos")
    assert (tmp_path / "photos" / "cat.jpg").exists()


def test_refuses_weights_beyond_half_precision(tmp_path):
    model = SingleModel(CONFIG)
    model.sg_decoder.heads.weight.data[0] = 1e6
    save_checkpoint(tmp_path / "loud.pt", model, card={"steps": 1})
    with pytest.raises(ModelError, match=r"sg_decoder\.heads\.weight reaches 1e\+06"):
        export_checkpoint(tmp_path / "loud.pt", tmp_path / "out")
    assert not (tmp_path / "out").exists()
