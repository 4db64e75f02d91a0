"""What serving imports: no PyTorch, nothing of the training extra; and what the project adds to the world's names."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
SOURCES = {
    "core": "roomlight",
    "model": "roomlight_model",
    "export": "roomlight_export",
    "server": "roomlight_server",
    "client": "roomlight_client",
}


def _modules(*folders):
    names = []
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            names.append(".".join(part for part in parts if part != "__init__"))
    return names


def _loaded_after(imports):
    """Top-level modules of a fresh interpreter after these imports."""
    code = f"import sys, {', '.join(imports)}; print(*sorted({{n.partition('.')[0] for n in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return set(done.stdout.split())


def test_the_server_package_leaves_torch_out():
    assert "torch" not in _loaded_after(["roomlight_server"])


@pytest.mark.parametrize("folders", [("core", "server"), ("client",)])
def test_no_module_of_core_server_or_client_needs_the_training_extra(folders):
    loaded = _loaded_after(_modules(*folders))
    assert {"roomlight", "numpy"} <= loaded
    assert not loaded & {"torch", "onnx", "onnxscript", "tensorboard", "jax"}


def test_the_core_does_not_know_who_uses_it():
    assert not _loaded_after(_modules("core")) & (set(SOURCES.values()) - {"roomlight"})


def test_each_source_folder_adds_one_name_of_ours():
    for folder, package in SOURCES.items():
        importable = {
            path.stem
            for path in (ROOT / folder).iterdir()
            if path.suffix == ".py" or (path.is_dir() and any(path.rglob("*.py")))
        }
        assert importable == {package}
