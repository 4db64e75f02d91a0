"""Memory that the server shares with one of its processes: a decoded frame takes 9 ms through a pipe on busy cores.

The file behind it has no name and no fixed place on disk, and cannot be resized: a process that has been taken over
cannot cut it while the server reads. The server copies what it reads before it looks at it.
"""

import errno
import fcntl
import mmap
import os
import tempfile
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
        if descriptor is None:
            try:
                descriptor = _new_file()
            except OSError as error:
                advice = "raise the limit of the size of files (ulimit -f, LimitFSIZE)"
                problem = f"shared memory of {BLOCK_BYTES} bytes cannot be made ({error.strerror})"
                raise ServerError(f"{problem}; {advice}" if error.errno == errno.EFBIG else problem) from error
        self.descriptor = descriptor
        self._map = mmap.mmap(descriptor, BLOCK_BYTES)

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
        descriptor = os.memfd_create("roomlight", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(descriptor, BLOCK_BYTES)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        return descriptor
    with tempfile.TemporaryFile() as file:  # systems without memory files
        file.truncate(BLOCK_BYTES)
        return os.dup(file.fileno())
