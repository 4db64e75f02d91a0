"""The README and the documentation: short, true, no dead links."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import roomlight as rl
from http_servers import RunningServer

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
PAGES = [
    README,
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    ROOT / "examples" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
]
PAGES += [ROOT / "client" / "js" / "README.md"]


def python_blocks(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)


def test_readme_has_at_most_5000_characters():
    assert len(README.read_text()) <= 5000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_prose_wraps_at_100_columns(page: Path):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    long = [line for line in text.splitlines() if len(line) > 100 and not line.startswith(("|", "![", "    "))]
    assert not long


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_lead_to_files(page: Path):
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def run(code: str, folder: Path) -> str:
    """Run lines as a user does, in a process of their own, and return what they print."""
    script = folder / "readme.py"
    script.write_text(code)
    return subprocess.run([sys.executable, script], cwd=folder, capture_output=True, text=True, check=True).stdout


@pytest.mark.slow
def test_python_lines_of_the_readme_run(tmp_path: Path):
    (tmp_path / "my-capture").symlink_to(rl.sample_capture())
    assert "MainLight" in run(python_blocks(README)[0], tmp_path)
    assert (tmp_path / "light.exr").stat().st_size > 1000


@pytest.mark.slow
def test_server_lines_of_the_readme_run(tmp_path: Path):
    (tmp_path / "my-capture").symlink_to(rl.sample_capture())
    with RunningServer(model="classical") as server:
        code = python_blocks(README)[1].replace("http://127.0.0.1:8090", f"http://127.0.0.1:{server.port}")
        assert "MainLight" in run(code, tmp_path)
