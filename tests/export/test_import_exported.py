"""`load_exported`: a model folder gives back the networks that it was made from."""

import json
import shutil

import numpy as np
import pytest
import torch

from roomlight.engine.graphs import SHIPPED
from roomlight.errors import ModelError
from roomlight_export.exporting import export_checkpoint
from roomlight_export.importing import load_exported, load_weights
from roomlight_export.onnx_file import half_rounded
from roomlight_model.checkpoint import load_checkpoint, save_checkpoint, save_untrained
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import build

CONFIG = ModelConfig(
    SGConfig(volume_shape=(17, 14, 23), channels=8, full_channels=4),
    BlendConfig(height=18, channels=4, full_channels=4),
)


@pytest.fixture(scope="module", params=["single", "video"])
def pair(request, tmp_path_factory):
    """A checkpoint in which every weight is a number of its own, normalisations' included, and its folder."""
    folder = tmp_path_factory.mktemp("import")
    torch.manual_seed(4)
    model = build(request.param, CONFIG)
    with torch.no_grad():
        for weight in model.parameters():
            weight += 0.1 * torch.randn_like(weight)
    save_checkpoint(folder / "model.pt", model, card={"steps": 3, "date": "2026-01-02"})
    export_checkpoint(folder / "model.pt", folder / "out", ort=False)
    return folder / "model.pt", folder / "out"


def test_every_weight_comes_back_rounded_to_half(pair):
    checkpoint, folder = load_checkpoint(pair[0]), load_exported(pair[1])
    assert (folder.form, folder.config, folder.card) == (checkpoint.form, checkpoint.config, checkpoint.card)
    wanted = half_rounded(checkpoint.model, "model").state_dict()
    assert folder.model.state_dict().keys() == wanted.keys()
    for name, value in folder.model.state_dict().items():
        assert torch.equal(value, wanted[name]), name
    assert not folder.model.training


def test_untrained_networks_are_refused(tmp_path):
    """The exporter keeps one of several tensors that are alike, and leaves ones and zeros out."""
    save_untrained(tmp_path / "model.pt", "single", CONFIG, seed=1)
    export_checkpoint(tmp_path / "model.pt", tmp_path / "out", ort=False)
    with pytest.raises(ModelError, match="untrained"):
        load_exported(tmp_path / "out")


def test_training_may_start_from_either(pair):
    for path in pair:
        assert load_weights(path).config == CONFIG


def test_the_shipped_weights_can_be_trained_further():
    loaded = load_exported(SHIPPED / "single")
    assert loaded.card["steps"]
    weights = np.concatenate([weight.detach().numpy().ravel() for weight in loaded.model.parameters()])
    assert np.isfinite(weights).all()
    assert np.abs(weights).max() > 0.1


def _copy(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy")


def test_refuses_what_is_no_model_folder(tmp_path):
    with pytest.raises(ModelError, match=r"model\.json: cannot be read .*roomlight export"):
        load_exported(tmp_path)
    (tmp_path / "model.json").write_text("{")
    with pytest.raises(ModelError, match="not JSON"):
        load_exported(tmp_path)
    (tmp_path / "model.json").write_text('{"format": 9, "form": "single"}')
    with pytest.raises(ModelError, match="format 1"):
        load_exported(tmp_path)
    (tmp_path / "model.json").write_text('{"format": 1, "form": "single", "card": [], "graphs": {}}')
    with pytest.raises(ModelError, match="damaged"):
        load_exported(tmp_path)


def test_refuses_a_graph_that_is_not_the_one_described(pair, tmp_path):
    folder = _copy(pair[1], tmp_path)
    (folder / "single_sg_encoder.onnx").write_bytes((folder / "single_sg_decoder.onnx").read_bytes())
    with pytest.raises(ModelError, match=r"single_sg_encoder\.onnx: is not the graph"):
        load_exported(folder)
    (folder / "single_sg_encoder.onnx").unlink()
    with pytest.raises(ModelError, match=r"single_sg_encoder\.onnx: cannot be read"):
        load_exported(folder)


def test_refuses_a_configuration_that_the_weights_do_not_fit(pair, tmp_path):
    folder = _copy(pair[1], tmp_path)
    described = json.loads((folder / "model.json").read_text())
    described["config"]["sg"]["channels"] = 16
    (folder / "model.json").write_text(json.dumps(described))
    with pytest.raises(ModelError, match=r"at_half\.0\.0\.weight is \(8, .*asks for \(16, "):
        load_exported(folder)
    described["config"]["sg"]["channels"] = 3
    (folder / "model.json").write_text(json.dumps(described))
    with pytest.raises(ModelError, match=r"model\.json: channels must be"):
        load_exported(folder)
