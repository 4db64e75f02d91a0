"""Small networks, exported."""

import pickle
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from export_models import CARD, distinct_network

from kept_exports import kept_export
from roomlight_export.exporting import ExportReport, export_checkpoint
from roomlight_model.checkpoint import save_checkpoint


@dataclass(frozen=True)
class Exported:
    """A checkpoint, the model folder written from it, and the export's report."""

    form: str
    checkpoint: Path
    folder: Path
    report: ExportReport


SLOW = pytest.mark.slow
LARGE = ("single", pytest.param("video", marks=SLOW))  # the video form has ten graphs and takes 2.5 times as long
SMALL = ("clipping", pytest.param("objects", marks=SLOW))


def _export(form: str, folder: Path) -> None:
    save_checkpoint(folder / "weights.pt", distinct_network(form), card=CARD)
    report = export_checkpoint(folder / "weights.pt", folder / "deep" / form, ort=form in ("single", "video"))
    (folder / "report.pickle").write_bytes(pickle.dumps(report))


def _exported(form: str) -> Exported:
    folder = kept_export(f"{form}-form", partial(_export, form))
    report = pickle.loads((folder / "report.pickle").read_bytes())
    return Exported(form, folder / "weights.pt", folder / "deep" / form, report)


@pytest.fixture(scope="session")
def single() -> Exported:
    """The single-view form: four graphs."""
    return _exported("single")


@pytest.fixture(scope="session", params=LARGE)
def exported(request: pytest.FixtureRequest) -> Exported:
    return _exported(request.param)


@pytest.fixture(scope="session", params=SMALL)
def small(request: pytest.FixtureRequest) -> Exported:
    """A network that serves every model."""
    return _exported(request.param)


@pytest.fixture(scope="session", params=[*LARGE, *SMALL])
def any_form(request: pytest.FixtureRequest) -> Exported:
    return _exported(request.param)
