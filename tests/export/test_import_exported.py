"""`load_exported`: a model folder loads back into the networks that it was exported from."""

import json
import shutil

import pytest
import torch
from export_models import CONFIG

from roomlight.errors import ModelError
from roomlight_export.importing import load_exported, load_weights
from roomlight_export.onnx_file import half_rounded
from roomlight_model.checkpoint import load_checkpoint


def test_every_weight_comes_back_rounded_to_half(any_form):
    checkpoint, folder = load_checkpoint(any_form.checkpoint), load_exported(any_form.folder)
    assert (folder.form, folder.config, folder.card) == (checkpoint.form, checkpoint.config, checkpoint.card)
    wanted = half_rounded(checkpoint.model, "model").state_dict()
    assert folder.model.state_dict().keys() == wanted.keys()
    for name, value in folder.model.state_dict().items():
        assert torch.equal(value, wanted[name]), name
    assert not folder.model.training


def test_untrained_networks_are_refused(tiny_video):
    """The exporter merges equal tensors and omits ones and zeros, so that untrained weights cannot be restored."""
    with pytest.raises(ModelError, match="untrained"):
        load_exported(tiny_video)


def test_weights_load_from_checkpoint_or_folder(single):
    for path in (single.checkpoint, single.folder):
        assert load_weights(path).config == CONFIG


def test_refuses_a_folder_without_a_valid_model_json(tmp_path):
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


def test_refuses_a_graph_that_is_not_the_one_described(single, tmp_path):
    folder = shutil.copytree(single.folder, tmp_path / "copy")
    (folder / "single_sg_encoder.onnx").write_bytes((folder / "single_sg_decoder.onnx").read_bytes())
    with pytest.raises(ModelError, match=r"single_sg_encoder\.onnx: is not the graph"):
        load_exported(folder)
    (folder / "single_sg_encoder.onnx").unlink()
    with pytest.raises(ModelError, match=r"single_sg_encoder\.onnx: cannot be read"):
        load_exported(folder)


def test_refuses_a_configuration_that_the_weights_do_not_fit(single, tmp_path):
    folder = shutil.copytree(single.folder, tmp_path / "copy")
    described = json.loads((folder / "model.json").read_text())
    described["config"]["sg"]["channels"] = 16
    (folder / "model.json").write_text(json.dumps(described))
    with pytest.raises(ModelError, match=r"at_half\.0\.0\.weight is \(8, .*asks for \(16, "):
        load_exported(folder)
    described["config"]["sg"]["channels"] = 3
    (folder / "model.json").write_text(json.dumps(described))
    with pytest.raises(ModelError, match=r"model\.json: channels must be"):
        load_exported(folder)
