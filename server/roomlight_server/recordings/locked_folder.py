"""The folder of a server's uploads. Its lock ends with the process, so that another server removes what a kill left."""

import contextlib
import fcntl
import logging
import os
import shutil
import tempfile
from pathlib import Path
from typing import Final

_log = logging.getLogger("roomlight.server")
PREFIX: Final = "roomlight-recordings-"


class LockedFolder:
    """A new folder, readable by this user alone, and locked while this process lives."""

    def __init__(self, parent: Path | None) -> None:
        """Make the folder in `parent`, which is made too; by default in the system's folder for temporary files."""
        if parent is not None:
            parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{PREFIX}", dir=parent))
        self._descriptor = os.open(made, os.O_RDONLY | os.O_DIRECTORY)
        fcntl.flock(self._descriptor, fcntl.LOCK_EX)
        self.path = made.rename(made.with_name(made.name[1:]))  # under its name it is never without the lock

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._descriptor)


def remove_left_folders(parent: Path | None) -> None:
    """Remove the folders of this user in `parent` whose servers were killed."""
    folder = Path(tempfile.gettempdir()) if parent is None else parent
    with contextlib.suppress(OSError):
        for left in folder.glob(f"{PREFIX}*"):
            with contextlib.suppress(OSError):  # of another user, or removed by another server in the meantime
                _remove_if_left(left)


def _remove_if_left(folder: Path) -> None:
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)
        _log.warning("uploads of a server that was killed are removed", extra={"folder": folder.name})
    finally:
        os.close(descriptor)
