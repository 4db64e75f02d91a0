"""The TypeScript package `client/js`: how tests run its commands, and its build."""

import hashlib
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from filelock import FileLock

PACKAGE = Path(__file__).parents[2] / "client/js"


def run(
    command: Sequence[str | Path],
    *,
    folder: Path = PACKAGE,
    text: str | None = None,
    env: Mapping[str, str] | None = None,
) -> str:
    """Run a command with `text` as its input and return its standard output; show all output if it fails."""
    assert (PACKAGE / "node_modules").is_dir(), "run `npm ci` in client/js first"
    done = subprocess.run(
        command, cwd=folder, input=text, env=env, capture_output=True, text=True, check=False, timeout=800
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout[-8000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def build() -> None:
    """Compile the package and its tests, unless a test of this checkout has done so and nothing has changed since."""
    (PACKAGE / "build").mkdir(exist_ok=True)
    built = PACKAGE / "build" / "digest"
    with FileLock(built.with_suffix(".lock")):
        if not built.exists() or built.read_text() != _digest():
            run(["npm", "run", "--silent", "build:tests"])
            built.write_text(_digest())


def _digest() -> str:
    """Return a digest of all that the compiler reads and writes in the package."""
    files = [path for folder in ("src", "test", "dist", "build/test") for path in (PACKAGE / folder).rglob("*.*")]
    digest = hashlib.sha256()
    for path in sorted([*files, *PACKAGE.glob("*.json")]):
        digest.update(f"{path} {hashlib.sha256(path.read_bytes()).hexdigest()}".encode())
    return digest.hexdigest()
