"""Takes one sequence out of its shard, as a capture folder of its own; makes the sample capture that way too."""

import shutil
from collections.abc import Mapping
from pathlib import Path

from roomlight.dataset.loader import Dataset
from roomlight.errors import OutputError
from roomlight.files import write_atomic


def extract(dataset: Dataset, name: str, out: Path) -> None:
    """Write the sequence's files to `out`, whole or not at all: a capture that `roomlight replay` reads.

    DatasetError where there is no such sequence or it is damaged; OutputError where `out` holds something already or
    cannot be written.
    """
    write_capture(dataset.files(dataset.number_of(name)), out)


def write_capture(files: Mapping[str, bytes | memoryview], out: Path) -> None:
    """Write a capture's files, whole or not at all; OutputError where `out` holds something already."""
    partial = out.with_name(f".{out.name}.part")
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise OutputError(f"{out}: exists already; choose another folder or delete it")
        shutil.rmtree(partial, ignore_errors=True)
        for file, data in files.items():
            write_atomic(partial / file, bytes(data))
        partial.replace(out)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise OutputError(f"{out}: cannot be written ({error.strerror or error})") from error
    except OutputError:
        shutil.rmtree(partial, ignore_errors=True)
        raise
