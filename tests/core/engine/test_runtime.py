"""ONNX Runtime is loaded without its telemetry, which writes `~/.cache/Microsoft` and looks up a host at its import."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ENGINE = "import roomlight as rl; rl.Session(rl.SessionOptions(model='classical'))"


@pytest.fixture
def home(tmp_path, monkeypatch):
    """An empty home for child processes, whose environment does not switch telemetry off."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def test_a_process_writes_no_telemetry_file(home):
    code = f"{ENGINE}; import os, sys; print('onnxruntime' in sys.modules, os.environ['ORT_DISABLE_TELEMETRY'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "1"]
    assert not [path for path in home.rglob("*") if "Microsoft" in path.parts or "onnxruntime" in path.name]


def test_only_one_module_imports_onnx_runtime():
    importing = re.compile(r"^\s*(import|from) onnxruntime\b", re.MULTILINE)
    root, folders = Path(__file__).parents[3], ("core", "model", "export", "server", "client", "lab", "cli", "examples")
    sources = [path for folder in folders for path in (root / folder).rglob("*.py") if "node_modules" not in path.parts]
    assert len(sources) > 300
    assert {path.name for path in sources if importing.search(path.read_text(encoding="utf-8"))} == {"runtime.py"}
