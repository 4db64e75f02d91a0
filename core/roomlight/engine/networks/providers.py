"""Where graphs run: ONNX Runtime's CPU provider, OpenVINO where it is installed and faster, or a GPU if asked for.

`auto` measures the runtimes on the CPU once and keeps the answer in a file of the cache folder: `NUMBA_CACHE_DIR`, else
`~/.cache/roomlight`. Processes that start together take the answer that was written first, so that all sessions of a
machine compute the same bits. `ROOMLIGHT_PROVIDER` decides instead. A process that was forked from one that uses
OpenVINO has ONNX Runtime alone.
"""

import hashlib
import json
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import repeat
from pathlib import Path
from typing import Any, Final, Literal, cast, get_args

from roomlight.engine.networks.graph import BoundGraph, Graph
from roomlight.engine.networks.openvino_runtime import OpenVinoGraph, computes_in_bf16, lost_by_fork, openvino_version
from roomlight.engine.networks.runtime import CUDA, OnnxRuntimeGraph, RuntimeName, ort
from roomlight.errors import ModelError
from roomlight.threads import processor_name, thread_count

Provider = Literal["auto", "cpu", "openvino", "openvino-bf16", "cuda"]
VARIABLE: Final = "ROOMLIGHT_PROVIDER"
"""Environment variable that stands for `auto`."""
FASTER: Final = 0.9
"""A runtime is chosen over the one before it in `CHOICES` if it takes at most this share of its time: OpenVINO takes
0.55 of ONNX Runtime's for the SGLV networks on an AMD EPYC with AVX-512, and bf16 0.7 of fp32's. Noise must not decide,
because results differ in their last bits."""
CHOICES: Final[tuple[RuntimeName, ...]] = ("cpu", "openvino", "openvino-bf16")
"""What `auto` chooses from."""
_RUNS: Final = 5


def available() -> tuple[RuntimeName, ...]:
    """Return those of `CHOICES` that this machine has."""
    return CHOICES[: 1 + (openvino_version() is not None) + computes_in_bf16()]


def open_graph(path: Path, runtime: RuntimeName) -> Graph:
    """Load one graph.

    Raises:
        ModelError: the runtime refuses it, or a shape in it is dynamic.
    """
    if runtime in ("openvino", "openvino-bf16"):
        return Graph(OpenVinoGraph.open(path, runtime), path.stem)
    return Graph(OnnxRuntimeGraph.open(path, runtime), path.stem)


def open_graphs(paths: Sequence[Path], digest: str, provider: Provider) -> list[Graph]:
    """Load the graphs of a model folder, all in one runtime; a measured choice is kept under their `digest`.

    Raises:
        ModelError: OpenVINO or CUDA is requested and not installed, or the runtime refuses a graph.
    """
    runtime = _requested(provider)
    if runtime is None:
        return _open_fastest(paths, digest)
    return _opened(paths, runtime)


def _opened(paths: Sequence[Path], runtime: RuntimeName) -> list[Graph]:
    """Load graphs side by side: a runtime compiles one on one core."""
    with ThreadPoolExecutor(thread_count()) as pool:
        return list(pool.map(open_graph, paths, repeat(runtime)))


def _requested(provider: Provider) -> RuntimeName | None:
    """Return the runtime that is asked for, and the only one where OpenVINO cannot be used; None: the faster one."""
    wanted = (os.environ.get(VARIABLE) or "auto") if provider == "auto" else provider  # blank is unset
    if wanted not in get_args(Provider):
        raise ModelError(f"{VARIABLE} must be one of {', '.join(get_args(Provider))}; got {wanted!r}")
    if wanted in ("openvino", "openvino-bf16") and openvino_version() is None:
        raise ModelError(f'provider="{wanted}": OpenVINO is not installed (pip install openvino); use provider="cpu"')
    if wanted in ("openvino", "openvino-bf16") and lost_by_fork():
        raise ModelError(
            f'provider="{wanted}": this process was forked from one that uses OpenVINO, which compiles nothing here; '
            'start processes by "spawn", or use provider="cpu"'
        )
    if wanted == "openvino-bf16" and not computes_in_bf16():
        raise ModelError('provider="openvino-bf16": this processor does not compute in bf16; use provider="openvino"')
    if wanted == "cuda" and CUDA not in ort.get_available_providers():
        raise ModelError(
            'provider="cuda": this ONNX Runtime has no CUDA (pip uninstall onnxruntime; pip install '
            "'onnxruntime-gpu[cuda,cudnn]'); use provider=\"cpu\""
        )
    if wanted == "auto":
        return "cpu" if openvino_version() is None or lost_by_fork() else None
    return cast("RuntimeName", wanted)


def _open_fastest(paths: Sequence[Path], digest: str) -> list[Graph]:
    file = _choice_file(digest)
    kept = _kept_choice(file)
    if kept is not None:
        return _opened(paths, kept)
    loaded: dict[RuntimeName, list[Graph]] = {runtime: _opened(paths, runtime) for runtime in available()}
    least_ms = _least_ms(loaded)
    chosen, *others = loaded
    for runtime in others:
        if least_ms[runtime] <= FASTER * least_ms[chosen]:
            chosen = runtime
    return loaded[_keep_choice(file, {"runtime": chosen, "least_ms": least_ms})]


def _least_ms(loaded: dict[RuntimeName, list[Graph]]) -> dict[RuntimeName, float]:
    """Return the least time of a run of all graphs in each runtime, interleaved."""
    runs: dict[RuntimeName, list[BoundGraph]] = {
        runtime: [graph.bind(graph.new_inputs(), graph.new_outputs()) for graph in graphs]
        for runtime, graphs in loaded.items()
    }
    least_ms = dict.fromkeys(runs, float("inf"))
    for _ in range(1 + _RUNS):  # the first plans memory
        for runtime, graphs in runs.items():
            began = time.perf_counter()
            for graph in graphs:
                graph.run()
            least_ms[runtime] = min(least_ms[runtime], (time.perf_counter() - began) * 1e3)
    return least_ms


def _home() -> Path:
    """Return the user's folder, or where nothing can be written: a container's user may have none."""
    try:
        return Path.home()
    except RuntimeError:
        return Path(os.devnull)


def _choice_file(digest: str) -> Path:
    """Return where the choice for these graphs is kept: another processor or version has another file."""
    machine = [processor_name(), str(thread_count()), ort.__version__, str(openvino_version()), *CHOICES, digest]
    name = hashlib.sha256("\n".join(machine).encode()).hexdigest()[:16]
    numba_folder = os.environ.get("NUMBA_CACHE_DIR")
    caches = os.environ.get("XDG_CACHE_HOME") or f"{_home()}/.cache"
    folder = Path(numba_folder) if numba_folder else Path(caches, "roomlight")
    return folder / f"runtime-{name}.json"


def _kept_choice(file: Path) -> RuntimeName | None:
    """Return the kept choice; None if there is none, or the file is damaged."""
    try:
        runtime = json.loads(file.read_text(encoding="utf-8"))["runtime"]
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return runtime if runtime in CHOICES else None


def _keep_choice(file: Path, choice: dict[str, Any]) -> RuntimeName:
    """Keep a choice unless another process was first; return the one that counts.

    Where the folder cannot be written, each process measures.
    """
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=file.parent, encoding="utf-8") as complete:
            json.dump(choice, complete)
            complete.flush()
            if _kept_choice(file) is None:
                file.unlink(missing_ok=True)  # damaged
            with suppress(FileExistsError):
                os.link(complete.name, file)
    return _kept_choice(file) or choice["runtime"]
