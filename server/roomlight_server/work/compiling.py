"""Kernels that are compiled in a process beside where numba's cache has none yet: of meshes, then of composites.

They take 30 s of one core, and numba compiles on one core at a time. Frames' other kernels, 7 s, compile meanwhile.
"""

import subprocess
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

from roomlight.compositing.kernels.paths import add_lit


@cache
def compile_beside(*qualities: str) -> "subprocess.Popen[bytes] | None":
    """Start to compile them, once in this process, unless composites' are cached: returns at once.

    The process goes on if the caller ends: what it compiled serves the next one. Where none can be started, composites
    compile when they are made.

    Args:
        qualities: Of the compositor, in the order in which they will be needed.
    """
    function = add_lit.py_func  # compiled after the large ones
    written_s = Path(function.__code__.co_filename).stat().st_mtime
    cached = Path(add_lit.stats.cache_path or "").glob(f"*.{function.__name__}-*.nbi")
    if any(path.stat().st_mtime > written_s for path in cached):  # others are of an earlier version
        return None
    command = [sys.executable, "-m", "roomlight_server.precompile", *qualities]
    quiet = subprocess.DEVNULL
    with suppress(OSError):
        return subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    return None
