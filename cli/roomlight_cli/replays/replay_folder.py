"""The output folder of a replay: which replay it holds, whether that is finished, and who may write there.

`replay.json` says what the folder is for: the options and the capture. `report.json` is written last, so a folder
without it is an interrupted replay (`saved_replay`). Its `fingerprint` is of the capture's and the weights' files, and
of the outputs.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from roomlight import __version__
from roomlight.captures import open_capture
from roomlight.engine.networks.graphs import SHIPPED
from roomlight.errors import OutputError
from roomlight.files import remove_outputs, write_json
from roomlight_cli.replays.pictures import SUMMARY, VIDEO
from roomlight_cli.replays.replay_options import ReplayOptions
from roomlight_cli.replays.saved_replay import forget_replay

REPORT: Final = "report.json"
INTENT: Final = "replay.json"
_LIGHT: Final = "probe-[0-9][0-9]*/light.*"
_FOLDERS: Final = "probe-[0-9][0-9]*"


def describe_intent(path: Path, model: str, options: ReplayOptions) -> dict[str, Any]:
    """Return what `replay.json` holds: all that makes two replays the same, without the output folder."""
    settings = asdict(options)
    settings.pop("overwrite")
    described = {"roomlight": __version__, "capture": str(path.resolve()), "model": model, "options": settings}
    return json.loads(json.dumps(described, default=str))


def finished_report(path: Path, out: Path, options: ReplayOptions) -> dict[str, Any] | None:
    """Return the report of the same replay if `out` holds it finished, with inputs and outputs unchanged.

    None for anything else: another replay, an interrupted one, a file that changed since. The weights of a server are
    not looked at. No model is loaded.

    Raises:
        CaptureError: The capture cannot be opened.
    """
    intent, report = _read_json(out / INTENT), _read_json(out / REPORT)
    if not isinstance(intent, dict) or not isinstance(report, dict) or not report.get("complete"):
        return None
    if intent != describe_intent(path, str(intent.get("model")), options):
        return None
    capture = open_capture(path, options.capture)
    return report if report.get("fingerprint") == fingerprint(capture.path, out, options) else None


def fingerprint(capture: Path, out: Path, options: ReplayOptions) -> dict[str, str]:
    """Return digests of the names, sizes and modification times of a replay's input and output files."""
    own = () if options.server else {options.session.weights or SHIPPED, options.session.parts or SHIPPED}
    folders = (capture, *sorted(own))
    inputs = [file for folder in folders for file in _files(folder) if not file.resolve().is_relative_to(out.resolve())]
    outputs = [file for pattern in (_LIGHT, SUMMARY, VIDEO) for file in sorted(out.glob(pattern))]
    return {"inputs": _digest(inputs), "outputs": _digest(outputs)}


def holds_replay_of(capture: Path, out: Path) -> bool:
    """Whether `out` holds a replay of this capture, finished or not, with any options."""
    intent = _read_json(out / INTENT)
    return isinstance(intent, dict) and intent.get("capture") == str(capture.resolve())


def refuse_foreign(out: Path, capture: Path, intent: dict[str, Any], *, overwrite: bool) -> None:
    """Check that a replay may write into `out`; changes nothing.

    Raises:
        OutputError: The folder is a file, the capture itself, unreadable, or holds something else.
    """
    try:
        if out.exists() and not out.is_dir():
            raise OutputError(f"{out}: is a file; the output needs a folder")
        if out.resolve() == capture.resolve():
            raise OutputError(f"{out}: is the capture itself; choose another output folder")
        if overwrite:
            return
        if (out / INTENT).is_file():
            if differing := _differing(_read_json(out / INTENT), intent):
                raise OutputError(
                    f"{out}: holds another replay ({differing}); choose another --out, or replace it with --overwrite"
                )
        elif out.is_dir() and any(out.iterdir()):
            raise OutputError(f"{out}: holds other files; choose another --out, or write there with --overwrite")
    except OSError as error:
        raise OutputError(f"{out}: cannot be used for output ({error.strerror or error})") from error


def _differing(there: Any, here: Any, name: str = "") -> str:
    """Return which values of two replays differ; empty if none do."""
    if isinstance(there, dict) and isinstance(here, dict):
        parts = [_differing(there.get(key), here.get(key), key) for key in {**here, **there}]
        return "; ".join(part for part in parts if part)
    if there == here:
        return ""
    return f"{name}={_shown(there)} there, {_shown(here)} here" if name else f"its {INTENT} is damaged"


def _shown(value: Any, between: str = ", ") -> str:
    """Return a value as a command's options are written: `exr, hdr`, points as `0.4,1.2,-0.3`, `none`."""
    if isinstance(value, list):
        return between.join(part if isinstance(part, str) else _shown(part, ",") for part in value) or "none"
    return "none" if value is None else repr(value)


def claim(out: Path, intent: dict[str, Any]) -> None:
    """Prepare the folder for a replay and write `replay.json`.

    Outputs of an earlier replay go: its frames or weights may have changed under the same names.

    Raises:
        OutputError: A file cannot be removed or written.
    """
    remove_outputs(out, (_LIGHT, REPORT, SUMMARY, VIDEO), folders=_FOLDERS)
    forget_replay(out)
    write_json(out / INTENT, intent)


def _read_json(path: Path) -> Any:
    """Return the file's values; None if it is missing or damaged."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None


def _files(path: Path) -> Iterator[Path]:
    """Yield the files of a folder and its subfolders in a fixed order, or the file itself."""
    if path.is_dir():
        for entry in sorted(path.iterdir()):
            yield from _files(entry)
    else:
        yield path


def _digest(files: list[Path]) -> str:
    digest = sha256()
    for file in files:
        try:
            state = file.stat()
            line = f"{file.resolve()}\0{state.st_size}\0{state.st_mtime_ns}\n"
        except OSError:
            line = f"{file}\0missing\n"
        digest.update(line.encode("utf-8", "surrogateescape"))  # a name need not be UTF-8
    return digest.hexdigest()
