"""Growing arrays and open-addressed tables for the kernels."""

import numpy as np

from roomlight_generator.transport.kernels.common import rehash
from roomlight_generator.transport.kernels.structs import HashTable


class Table:
    """A map from 64-bit keys (not -1 or -2) to 32-bit values, at most half full."""

    def __init__(self, entries: int = 1 << 15) -> None:
        """Start empty, with space for `entries` entries."""
        self.keys = np.full(1 << 4, -1, np.int64)
        self.values = np.zeros(1 << 4, np.int32)
        self.reserve(entries)

    def reserve(self, entries: int) -> None:
        """Make space for `entries` entries in all; `arrays` are replaced when it grows."""
        places = len(self.keys)
        if 2 * entries <= places:
            return
        while places < 2 * entries:
            places *= 2
        keys, values = np.full(places, -1, np.int64), np.zeros(places, np.int32)
        rehash(self.keys, self.values, keys, values)
        self.keys, self.values = keys, values

    @property
    def arrays(self) -> HashTable:
        """The table as the kernels take it."""
        return HashTable(self.keys, self.values)


def grown(array: np.ndarray, used: int, needed: int) -> np.ndarray:
    """Return the array if it is as long as needed, else one at least twice as long with the used rows copied."""
    if needed <= len(array):
        return array
    new = np.zeros((max(needed, 2 * len(array)), *array.shape[1:]), array.dtype)
    new[:used] = array[:used]
    return new
