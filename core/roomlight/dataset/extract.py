"""Write one sequence of a dataset as a capture folder."""

import shutil
from pathlib import Path

from roomlight.dataset.loader import Dataset
from roomlight.dataset.sequence_files import CAPTURE
from roomlight.errors import OutputError
from roomlight.files import move_folder, temporary_beside, write_atomic


def extract(dataset: Dataset, name: str, out: Path) -> None:
    """Write a sequence's files to `out`, atomically: a capture that `roomlight replay` reads.

    Raises:
        DatasetError: The dataset has no such sequence, or the sequence is damaged.
        OutputError: `out` is not empty, or cannot be written.
    """
    files = dataset.files(dataset.number_of(name))
    target = out.absolute()  # `.` has no name
    partial = temporary_beside(target)
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise OutputError(f"{out}: exists already; choose another folder or delete it")
        shutil.rmtree(partial, ignore_errors=True)
        for file, data in files.items():
            write_atomic(partial / file, bytes(data))
        move_folder(partial, target, last=CAPTURE)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise OutputError(f"{out}: cannot be written ({error.strerror or error})") from error
    except OutputError:
        shutil.rmtree(partial, ignore_errors=True)
        raise
