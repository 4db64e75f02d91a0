"""Opens Blender scenes before the first is rendered: `python -m roomlight_generator.blender.check a.blend b.blend`.

It writes a line of JSON for each to standard output: null, or why the scene is refused.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from roomlight.errors import DatasetError
from roomlight_generator.blender.floor import find_floor
from roomlight_generator.blender.scene import open_scene


def check_scenes(paths: Sequence[Path]) -> None:
    """Open all scenes and find their floors, in a process of its own: `bpy` changes the module path.

    Raises:
        DatasetError: scenes are refused; the message is a line for each.
    """
    run = subprocess.run(
        [sys.executable, "-P", "-m", __name__, *map(str, paths)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(entry or os.curdir for entry in sys.path)},
        check=False,
    )
    reasons = [json.loads(line) for line in run.stdout.splitlines()]
    if len(reasons) < len(paths):
        last = (run.stderr.strip().splitlines() or [""])[-1]
        reasons.append(f"{paths[len(reasons)]}: Blender ended with code {run.returncode} when it opened it: {last}")
    refused = [reason for reason in reasons if reason is not None]
    if refused:
        advice = f"{len(refused)} of {len(paths)} scenes are refused; mend them, or leave them out"
        raise DatasetError("\n".join([*refused, advice]))


def _refusal(path: Path) -> str | None:
    try:
        find_floor(open_scene(path))
    except DatasetError as error:
        return str(error)
    return None


def main() -> None:
    """Check the scenes given as arguments."""
    reasons = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # Blender prints to standard output too
    for path in map(Path, sys.argv[1:]):
        print(json.dumps(_refusal(path)), file=reasons, flush=True)


if __name__ == "__main__":
    main()
