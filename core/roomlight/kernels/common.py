# pyright: reportMissingParameterType=false
"""What the kernels share: scrambled low-discrepancy points, and frames about a normal. Directions are (x, y, z)."""

import math
import warnings
from typing import Any

import numpy as np
from numba import njit


def _can_be_kept() -> bool:
    """Whether numba can write compiled code beside the code, to `NUMBA_CACHE_DIR` or to the user's cache."""
    try:
        njit(cache=True)(_can_be_kept)
    except RuntimeError:
        effect = "each process compiles them, for half a minute: set NUMBA_CACHE_DIR to a folder that can be written"
        warnings.warn(f"compiled kernels cannot be kept, and {effect}", RuntimeWarning, stacklevel=2)
        return False
    return True


CACHED: dict[str, Any] = {"nogil": True, "cache": _can_be_kept(), "no_cfunc_wrapper": True}
"""Options for functions that Python calls: kept on disk once compiled, without an entry for C, which nobody uses."""
KERNEL: dict[str, Any] = CACHED | {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy"}
"""The same for fast arithmetic, of contraction and reciprocals only: infinities must stay infinities."""
JIT: dict[str, Any] = KERNEL | {"cache": False, "_nrt": False, "forceinline": True, "no_cpython_wrapper": True}
"""Options for functions that kernels alone call: they have no entry for Python either, which took a quarter of the time
of compiling, so that a call from Python ends the process.
They are cached within the kernels: code from a cache of their own cannot be inlined.
A kernel's cache does not notice that they changed: delete `__pycache__` after editing them, or old code runs.
They allocate nothing, so numba need not count references to the arrays of the tuples that they are given. The two made
three quarters of a preview's shading."""

_MASK = np.uint64(0xFFFFFFFF)


@njit(**JIT)
def mixed(value):
    """Hash to 64 bits (splitmix64)."""
    x = np.uint64(value) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(**JIT)
def _reversed(x):
    """Reverse 32 bits."""
    x = ((x >> np.uint64(16)) | (x << np.uint64(16))) & _MASK
    x = ((x & np.uint64(0x00FF00FF)) << np.uint64(8)) | ((x & np.uint64(0xFF00FF00)) >> np.uint64(8))
    x = ((x & np.uint64(0x0F0F0F0F)) << np.uint64(4)) | ((x & np.uint64(0xF0F0F0F0)) >> np.uint64(4))
    x = ((x & np.uint64(0x33333333)) << np.uint64(2)) | ((x & np.uint64(0xCCCCCCCC)) >> np.uint64(2))
    return ((x & np.uint64(0x55555555)) << np.uint64(1)) | ((x & np.uint64(0xAAAAAAAA)) >> np.uint64(1))


@njit(**JIT)
def _scrambled(x, key):
    """Owen-scramble 32 bits whose order is reversed (Laine and Karras 2011, constants of Vegdahl)."""
    x = (x + key) & _MASK
    x ^= (x * np.uint64(0x6C50B47C)) & _MASK
    x ^= (x * np.uint64(0xB82F1E52)) & _MASK
    x ^= (x * np.uint64(0xC7AFE638)) & _MASK
    x ^= (x * np.uint64(0x8D22F6E6)) & _MASK
    return x


@njit(**JIT)
def point(key, index, dimension):
    """Return point `index` in [0, 1)^2 of a shuffled, scrambled (0, 2)-sequence (Burley 2020).

    Each key and each dimension has a sequence of its own: any 2^k first points are stratified, in each dimension and
    together, and a pixel's points stay the same from frame to frame.
    """
    own = mixed(np.uint64(key) ^ (np.uint64(dimension + 1) * np.uint64(0xD1342543DE82EF95)))
    shuffled = _reversed(_scrambled(_reversed(np.uint64(index)), own & _MASK))
    # Sobol's first dimension is the index, reversed; the second is Pascal's matrix times the index (mod 2), reversed:
    # bit j is the sum of the bits i of which j is a subset. The scrambling reverses both again.
    second = shuffled
    second ^= (second >> np.uint64(16)) & np.uint64(0x0000FFFF)
    second ^= (second >> np.uint64(8)) & np.uint64(0x00FF00FF)
    second ^= (second >> np.uint64(4)) & np.uint64(0x0F0F0F0F)
    second ^= (second >> np.uint64(2)) & np.uint64(0x33333333)
    second ^= (second >> np.uint64(1)) & np.uint64(0x55555555)
    other = mixed(own)
    a = _reversed(_scrambled(shuffled, other & _MASK))
    b = _reversed(_scrambled(second, other >> np.uint64(32)))
    return np.float64(a) * (1.0 / 4294967296.0), np.float64(b) * (1.0 / 4294967296.0)


@njit(**JIT)
def tangents(x, y, z):
    """Return two unit vectors at right angles to a unit vector (Duff et al. 2017)."""
    sign = 1.0 if z >= 0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return 1 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y


@njit(**JIT)
def normalised(x, y, z):
    """Scale to unit length."""
    scale = 1 / math.sqrt(max(x * x + y * y + z * z, 1e-30))
    return x * scale, y * scale, z * scale
