"""Checkpoint files: an exact round trip, and a clear refusal of all other files."""

import collections

import pytest
import torch

from roomlight.errors import ModelError, OutputError
from roomlight_model.checkpoint import FORMS, build_network, load_checkpoint, save_checkpoint
from roomlight_model.config import BlendConfig, ModelConfig, SGConfig
from roomlight_model.networks import SingleModel
from untrained import save_untrained

CONFIG = ModelConfig(SGConfig(channels=4, full_channels=4), BlendConfig(height=16, channels=4, full_channels=4))


@pytest.fixture
def contents(tmp_path):
    """What a good checkpoint holds."""
    save_untrained(tmp_path / "good.pt", "single", CONFIG, seed=1)
    return torch.load(tmp_path / "good.pt", weights_only=True)


@pytest.mark.parametrize("form", FORMS)
def test_round_trip(tmp_path, form):
    torch.manual_seed(7)
    model = build_network(form, CONFIG)
    card = {"steps": 12, "data": ["a room"], "score": 0.25}
    save_checkpoint(tmp_path / "a" / "model.pt", model, card=card)
    loaded = load_checkpoint(tmp_path / "a" / "model.pt")
    assert (loaded.form, loaded.card) == (form, card)
    assert loaded.config == (CONFIG if form in ("single", "video") else ModelConfig())
    assert not loaded.model.training
    for name, value in model.state_dict().items():
        assert torch.equal(loaded.model.state_dict()[name], value)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda c: c.pop("format"), "not a RoomLight checkpoint"),
        (lambda c: c.update(format=9), "format 9"),
        (lambda c: c.update(format=1), "format 1; this version reads format 2. Train again"),
        (lambda c: c.pop("card"), "lacks card"),
        (lambda c: c.update(form="triple"), "triple"),
        (lambda c: c.update(card=3), "card and state"),
        (lambda c: c["config"]["sg"].update(colour=1), "colour"),
        (lambda c: c["config"]["sg"].update(channels=8), "the configuration asks for"),
        (lambda c: c["state"].popitem(), "1 missing"),
        (lambda c: c["state"].update(extra=torch.zeros(1)), "1 unknown"),
        (lambda c: c["state"].update({"sg_decoder.heads.bias": "text"}), "is str"),
        (lambda c: c["state"]["sg_decoder.heads.bias"].fill_(float("nan")), "diverged"),
    ],
)
def test_refuses_tampered(tmp_path, contents, change, named):
    change(contents)
    path = tmp_path / "bad.pt"
    torch.save(contents, path)
    with pytest.raises(ModelError, match=named) as error:
        load_checkpoint(path)
    assert str(path) in str(error.value)


@pytest.mark.usefixtures("contents")
def test_refuses_files_that_are_not_checkpoints(tmp_path):
    with pytest.raises(ModelError, match="cannot be read"):
        load_checkpoint(tmp_path / "none.pt")
    with pytest.raises(ModelError, match="cannot be read"):
        load_checkpoint(tmp_path)
    (tmp_path / "text.pt").write_text("weights")
    with pytest.raises(ModelError, match="not a PyTorch checkpoint"):
        load_checkpoint(tmp_path / "text.pt")
    torch.save([1, 2], tmp_path / "list.pt")
    with pytest.raises(ModelError, match="not a RoomLight checkpoint"):
        load_checkpoint(tmp_path / "list.pt")
    torch.save({"step": 1, "network": {}, "optimizer": {}}, tmp_path / "last.pt")
    with pytest.raises(ModelError, match=r"last\.pt: .* resumes from; its weights are model\.pt and best\.pt"):
        load_checkpoint(tmp_path / "last.pt")
    whole = (tmp_path / "good.pt").read_bytes()
    for keep in (10, len(whole) // 2, len(whole) - 100):
        (tmp_path / "cut.pt").write_bytes(whole[:keep])
        with pytest.raises(ModelError, match=r"cut\.pt"):
            load_checkpoint(tmp_path / "cut.pt")


def test_runs_no_code_from_the_file(tmp_path, contents):
    contents["card"] = {"when": collections.Counter()}
    contents["state"]["hook"] = pytest.fail  # a function, by name
    torch.save(contents, tmp_path / "code.pt")
    with pytest.raises(ModelError, match="plain tensors"):
        load_checkpoint(tmp_path / "code.pt")


def test_refuses_to_save_invalid_cards_and_paths(tmp_path):
    model = SingleModel(CONFIG)
    with pytest.raises(ModelError, match="JSON"):
        save_checkpoint(tmp_path / "a.pt", model, card={"data": object()})
    with pytest.raises(OutputError, match="folder"):
        save_checkpoint(tmp_path, model, card={})
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        save_checkpoint(tmp_path / "file" / "a.pt", model, card={})
