"""`export_checkpoint` end to end on tiny networks of both forms: what is in the folder, and that it is verified."""

import hashlib
import json

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import TensorProto, numpy_helper

from roomlight.errors import ModelError, OutputError
from roomlight_export import exporting
from roomlight_export.exporting import RECURRENT_STEPS, export_checkpoint
from roomlight_export.graphs import graphs_of
from roomlight_export.inputs import room_volume
from roomlight_model.checkpoint import load_checkpoint, save_checkpoint, save_untrained
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel

SHAPE = (17, 14, 23)  # nothing halves evenly
CONFIG = ModelConfig(
    SGConfig(volume_shape=SHAPE, channels=8, full_channels=4), BlendConfig(height=18, channels=4, full_channels=4)
)
SINGLE = {"single_sg_encoder", "single_sg_decoder", "single_blend_encoder", "single_blend_decoder"}
VIDEO = {
    "video_sg_encoder",
    "video_sg_gru",
    "video_sg_decoder",
    "video_blend_encoder",
    "video_blend_gru",
    "video_blend_decoder",
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """(checkpoint, folder, report) of each form, exported once."""
    folder = tmp_path_factory.mktemp("export")
    result = {}
    for form in ("single", "video"):
        checkpoint = folder / f"{form}.pt"
        save_untrained(checkpoint, form, CONFIG, seed=2)
        out = folder / "deep" / form
        result[form] = (checkpoint, out, export_checkpoint(checkpoint, out, ort=form == "video"))
    return result


@pytest.mark.parametrize(("form", "names"), [("single", SINGLE), ("video", SINGLE | VIDEO)])
def test_the_folder_describes_itself(exported, form, names):
    _, out, report = exported[form]
    described = json.loads((out / "model.json").read_text())
    assert described["format"] == 1
    assert described["form"] == form
    assert described["opset"] >= 20
    assert described["card"] == {"steps": 0, "seed": 2}
    assert ModelConfig.from_dict(described["config"]) == CONFIG
    assert set(described["graphs"]) == set(report.graphs) == names
    assert {path.stem for path in out.glob("*.onnx")} == names
    assert {path.stem for path in out.glob("ort/*.ort")} == (names if form == "video" else set())
    for name, graph in described["graphs"].items():
        assert graph["sha256"] == hashlib.sha256((out / f"{name}.onnx").read_bytes()).hexdigest()
        session = onnxruntime.InferenceSession(out / f"{name}.onnx", providers=["CPUExecutionProvider"])
        assert {entry.name: entry.shape for entry in session.get_inputs()} == graph["inputs"]
        assert {entry.name: entry.shape for entry in session.get_outputs()} == graph["outputs"]
    assert not list(out.parent.glob(".*"))


def test_shapes_are_what_the_renderer_wants(exported):
    graphs = json.loads((exported["video"][1] / "model.json").read_text())["graphs"]
    assert graphs["single_sg_decoder"]["outputs"] == {"alpha": list(SHAPE), "lobes": [*SHAPE, 10]}
    assert graphs["video_sg_decoder"]["inputs"]["lobes_previous"] == [*SHAPE, 10]
    assert graphs["video_blend_encoder"]["inputs"] == {"panels": [1, 13, 18, 36]}
    assert graphs["single_blend_decoder"]["outputs"] == {"weight": [1, 1, 18, 36]}
    assert graphs["video_sg_gru"]["inputs"]["h0"] == graphs["video_sg_gru"]["outputs"]["h0_next"]


@pytest.mark.parametrize("form", ["single", "video"])
def test_parity_is_far_inside_the_tolerance(exported, form):
    """Half-rounded weights on both sides: what is left is the order of summation, over 8 recurrent steps."""
    report = exported[form][2]
    assert set(report.parity) == {"sg", "blend"}
    for parity in report.parity.values():
        assert parity.steps == RECURRENT_STEPS + 1 >= 9
        assert 0 < parity.largest < 1e-4
        assert parity.largest <= max(parity.rounding.values()) < 0.05
    assert report.largest_error == max(parity.largest for parity in report.parity.values())
    described = json.loads((exported[form][1] / "model.json").read_text())
    assert described["parity"]["sg"]["error"] == report.parity["sg"].error


def test_weights_are_stored_in_half_precision(exported):
    _, out, report = exported["video"]
    held = 0
    for path in out.glob("*.onnx"):
        model = onnx.load(path)
        for tensor in model.graph.initializer:
            if numpy_helper.to_array(tensor).size > 1:
                assert tensor.data_type in (TensorProto.FLOAT16, TensorProto.INT64)
                held += numpy_helper.to_array(tensor).size * (tensor.data_type == TensorProto.FLOAT16)
    # the exporter stores equal arrays once: in untrained weights the biases of zeros
    assert 0.99 * report.parameters < held <= report.parameters
    # two bytes a weight and up to 12 kB of structure a graph
    assert 2 * held < report.onnx_bytes < 2 * report.parameters + 10 * 12_000
    assert report.ort_bytes > report.onnx_bytes


def test_files_carry_config_and_card_but_no_traces(exported):
    for path in exported["video"][1].glob("*.onnx"):
        model = onnx.load(path)
        kept = {entry.key: entry.value for entry in model.metadata_props}
        assert kept["roomlight.graph"] == path.stem
        assert kept["roomlight.form"] == "video"
        assert json.loads(kept["roomlight.config"]) == CONFIG.to_dict()
        assert json.loads(kept["roomlight.card"]) == {"steps": 0, "seed": 2}
        assert {entry.domain: entry.version for entry in model.opset_import}[""] >= 20
        assert not any(node.op_type == "ConvTranspose" for node in model.graph.node)
        assert b".py" not in path.read_bytes()


def test_the_graphs_predict_what_the_checkpoint_does(exported):
    """From the outside: float32 weights in PyTorch against the files. 1e-2 is what half precision may cost."""
    checkpoint, out, _ = exported["single"]
    model = load_checkpoint(checkpoint).model
    volume = room_volume(SHAPE, frame=3, seed=1)
    with torch.inference_mode():
        wanted = model(torch.from_numpy(volume))
    sessions = [onnxruntime.InferenceSession(out / f"single_sg_{part}.onnx") for part in ("encoder", "decoder")]
    f0, f1 = sessions[0].run(["f0", "f1"], {"volume": volume})
    alpha, lobes = sessions[1].run(["alpha", "lobes"], {"f0": f0, "f1": f1, "volume": volume})
    assert np.abs(alpha - wanted.alpha[0].numpy()).max() < 1e-2
    assert np.abs(np.log1p(lobes[..., :7]) - np.log1p(wanted.lobes[0, ..., :7].numpy())).max() < 1e-2
    empty = volume[0, 4] == -1
    assert empty.any()
    assert not alpha[empty].any()
    assert not lobes[empty].any()


def test_phone_files_run(exported):
    _, out, _ = exported["video"]
    random = np.random.default_rng(0)
    for graph in graphs_of(load_checkpoint(exported["video"][0]).model):
        session = onnxruntime.InferenceSession(out / "ort" / f"{graph.name}.ort", providers=["CPUExecutionProvider"])
        outputs = session.run(None, {name: random.random(shape, np.float32) for name, shape in graph.inputs.items()})
        assert [output.shape for output in outputs] == list(graph.outputs.values())
        assert all(np.isfinite(output).all() for output in outputs)


@pytest.fixture
def traced(exported, monkeypatch):
    """Graphs as they were exported before: tracing again would take seconds and change nothing."""
    out = exported["single"][1]
    monkeypatch.setattr(exporting, "to_onnx", lambda graph, **_: onnx.load(out / f"{graph.name}.onnx"))


@pytest.mark.usefixtures("traced")
def test_past_the_tolerance_nothing_is_written(exported, tmp_path):
    with pytest.raises(ModelError, match=r"differ from PyTorch by .* in \w+ over 9 frames"):
        export_checkpoint(exported["single"][0], tmp_path / "out", tolerance=0.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("traced")
def test_another_checkpoints_graphs_do_not_pass(tmp_path):
    """The graphs of seed 2 against the weights of seed 3: verification is what stands between them and a server."""
    save_untrained(tmp_path / "other.pt", "single", CONFIG, seed=3)
    with pytest.raises(ModelError, match="differ from PyTorch"):
        export_checkpoint(tmp_path / "other.pt", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["other.pt"]


@pytest.mark.usefixtures("traced")
def test_replaces_a_model_and_reports_progress_only_when_asked(exported, tmp_path, capfd):
    out = tmp_path / "model"
    out.mkdir()
    (out / "model.json").write_text('{"graphs": {}}')
    (out / "stale.onnx").write_text("old")
    heard = []
    export_checkpoint(exported["single"][0], out, ort=False, progress=heard.append)
    assert {path.name for path in out.iterdir()} == {f"{name}.onnx" for name in SINGLE} | {"model.json"}
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
    assert len(heard) == 5
    assert capfd.readouterr() == ("", "")


def test_refuses_places_that_are_not_for_models(exported, tmp_path):
    checkpoint = exported["single"][0]
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        export_checkpoint(checkpoint, tmp_path / "file")
    with pytest.raises(OutputError, match="cannot be written"):
        export_checkpoint(checkpoint, tmp_path / "file" / "model")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("")
    with pytest.raises(OutputError, match="something else"):
        export_checkpoint(checkpoint, tmp_path / "photos")
    (tmp_path / "photos" / "model.json").write_text("[]")
    with pytest.raises(OutputError, match="something else"):
        export_checkpoint(checkpoint, tmp_path / "photos")
    assert (tmp_path / "photos" / "cat.jpg").exists()


def test_refuses_foreign_checkpoints(tmp_path):
    (tmp_path / "other.pt").write_bytes(b"GGUF" + bytes(100))
    with pytest.raises(ModelError, match=r"other\.pt"):
        export_checkpoint(tmp_path / "other.pt", tmp_path / "out")
    with pytest.raises(ModelError, match="cannot be read"):
        export_checkpoint(tmp_path / "none.pt", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_refuses_weights_beyond_half_precision(tmp_path):
    model = SingleModel(CONFIG)
    model.sg_decoder.heads.weight.data[0] = 1e6
    save_checkpoint(tmp_path / "loud.pt", model, card={"steps": 1})
    with pytest.raises(ModelError, match=r"sg_decoder\.heads\.weight reaches 1e\+06"):
        export_checkpoint(tmp_path / "loud.pt", tmp_path / "out")
    assert not (tmp_path / "out").exists()
