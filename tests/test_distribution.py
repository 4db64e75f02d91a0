"""What is distributed: no untracked file in the sdist, and a wheel that works outside the repository."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

pytestmark = pytest.mark.docs


def build(target: str, out: Path) -> Path:
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(out)], cwd=ROOT, check=True)
    (built,) = out.iterdir()
    return built


def test_sdist_holds_tracked_files_alone(tmp_path: Path):
    with tarfile.open(build("sdist", tmp_path)) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    tracked = set(subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.split("\n"))
    assert not names - tracked - {"PKG-INFO"}
    assert {"LICENSE", "NOTICE", "README.md", "pyproject.toml", "client/js/src/index.ts"} <= names


def test_wheel_runs_outside_the_repository(tmp_path: Path):
    wheel = build("wheel", tmp_path / "dist")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        archive.extractall(tmp_path / "site")
    assert not [name for name in names if "node_modules" in name or name.endswith(".ts")]
    code = (
        "import roomlight as rl\n"
        "assert rl.__file__.startswith({site!r}), rl.__file__\n"
        "session = rl.Session()\n"
        "for number, frame in enumerate(rl.open_capture(rl.sample_capture())):\n"
        "    session.push(frame)\n"
        "    if number == 1: break\n"
        "light = session.light_at((0.0, 0.0, -0.5))\n"
        "light.save('light.exr')\n"
        "print(light.main_light, light.coverage)\n"
    ).format(site=str(tmp_path / "site"))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "light.exr").is_file()


def test_documentation_builds_without_a_warning(tmp_path: Path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "index.html").read_text()
    assert "//fonts.googleapis" not in page
    assert (tmp_path / "api" / "engine" / "index.html").is_file()
