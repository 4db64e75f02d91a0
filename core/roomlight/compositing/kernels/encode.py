# pyright: reportMissingParameterType=false
"""Linear radiance to 8-bit sRGB by table."""

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def encode_values(linear, table, out, start, stop):
    """Encode values start..stop; `table` holds the code of i / 65535."""
    for i in range(start, stop):
        value = linear[i]
        if value >= np.float32(1):
            out[i] = table[65535]
        elif value > np.float32(0):
            out[i] = table[int(value * np.float32(65535) + np.float32(0.5))]
        else:
            out[i] = table[0]
