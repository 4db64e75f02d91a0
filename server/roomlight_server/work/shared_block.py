"""Memory that the server shares with one of its processes: a decoded frame takes 9 ms through a pipe on busy cores.

The file behind it has no name and no fixed place on disk, and cannot be resized: a process that has been taken over
cannot cut it while the server reads. The server copies what it reads before it looks at it.
"""

import errno
import fcntl
import mmap
import os
import tempfile
from contextlib import ExitStack
from typing import Final

from roomlight.errors import ServerError

BLOCK_BYTES: Final = 2**28
"""Largest request or result of a process; only pages that were written take memory."""
_KEPT_BYTES: Final = 2**22
"""A block that was used beyond this gives its pages back."""


class SharedBlock:
    """The memory; each side maps it, and one side uses it at a time."""

    def __init__(self, descriptor: int | None = None) -> None:
        """Map the block of a file descriptor, or make one (None).

        Raises:
            ServerError: The system refuses memory of this size.
        """
        try:
            self.descriptor = _new_file() if descriptor is None else descriptor
            with ExitStack() as at_failure:
                at_failure.callback(os.close, self.descriptor)
                if descriptor is None:
                    _set_size(self.descriptor)
                self._map = mmap.mmap(self.descriptor, BLOCK_BYTES)
                at_failure.pop_all()
        except OSError as error:
            advice = "raise the limit of the size of files (ulimit -f, LimitFSIZE)"
            problem = f"shared memory of {BLOCK_BYTES} bytes cannot be made ({error.strerror})"
            raise ServerError(f"{problem}; {advice}" if error.errno == errno.EFBIG else problem) from error

    def write(self, *parts: bytes | bytearray | memoryview) -> None:
        """Write parts one after the other, from the start; together at most `BLOCK_BYTES`."""
        start = 0
        for part in parts:
            self._map[start : start + len(part)] = part
            start += len(part)

    def read(self, size: int) -> bytes:
        """Return a copy of the first bytes."""
        return self._map[:size]

    def view(self, size: int) -> memoryview:
        """Return the first bytes themselves, to be released before the block is closed."""
        return memoryview(self._map)[:size].toreadonly()

    def release(self, used: int) -> None:
        """Return the pages of a large request or result to the system."""
        if used > _KEPT_BYTES and hasattr(mmap, "MADV_REMOVE"):
            self._map.madvise(mmap.MADV_REMOVE)

    def close(self) -> None:
        """Unmap the block and close its file."""
        self._map.close()
        os.close(self.descriptor)


def _new_file() -> int:
    if hasattr(os, "memfd_create"):
        return os.memfd_create("roomlight", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    with tempfile.TemporaryFile() as file:  # systems without memory files
        return os.dup(file.fileno())


def _set_size(descriptor: int) -> None:
    os.ftruncate(descriptor, BLOCK_BYTES)
    if hasattr(os, "memfd_create"):
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
