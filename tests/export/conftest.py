"""Small networks, exported once a test run."""

import pickle
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from export_models import CARD, CONFIG
from filelock import FileLock

from roomlight_export.exporting import ExportReport, export_checkpoint
from roomlight_model.checkpoint import build_network, save_checkpoint


@dataclass(frozen=True)
class Exported:
    """A checkpoint, the model folder written from it, and the export's report."""

    form: str
    checkpoint: Path
    folder: Path
    report: ExportReport


def _export(form, folder):
    """Export networks in which every weight differs from every other, as trained ones do."""
    torch.manual_seed(4)
    model = build_network(form, CONFIG)
    with torch.no_grad():
        for weight in model.parameters():
            weight += 0.1 * torch.randn_like(weight)
    checkpoint, out = folder / f"{form}.pt", folder / "deep" / form
    save_checkpoint(checkpoint, model, card=CARD)
    return Exported(form, checkpoint, out, export_checkpoint(checkpoint, out))


@pytest.fixture(scope="session")
def single(tmp_path_factory, worker_id):
    """The single-view form: four graphs, exported once for all workers."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "single-form"  # workers share the parent
    kept = folder / "exported.pickle"
    with FileLock(folder.with_suffix(".lock")):
        if not kept.exists():
            folder.mkdir()
            kept.write_bytes(pickle.dumps(_export("single", folder)))
    return pickle.loads(kept.read_bytes())


@pytest.fixture(scope="session", params=["single", pytest.param("video", marks=pytest.mark.slow)])
def exported(request, tmp_path_factory):
    """Each form; the video form has ten graphs and takes two and a half times as long."""
    if request.param == "single":
        return request.getfixturevalue("single")
    return _export(request.param, tmp_path_factory.mktemp("video"))
