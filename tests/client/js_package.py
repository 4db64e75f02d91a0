"""The TypeScript package `client/js`: how tests run its commands."""

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

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
        command, cwd=folder, input=text, env=env, capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout[-8000:]}\n{done.stderr[-4000:]}"
    return done.stdout
