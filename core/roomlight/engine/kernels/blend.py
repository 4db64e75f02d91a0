# pyright: reportMissingParameterType=false
"""Accumulation of one probe's panorama, in place; readable reference: `roomlight.engine.blend.accumulate_reference`."""

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, fastmath=True)
def accumulate_rows(radiance, depth, seen, hdr, detail, detail_depth, weight, closer_m, start, stop):
    """Update rows start..stop of the state (radiance [h, w, 3], depth [h, w], seen [h, w])."""
    one, zero = np.float32(1), np.float32(0)
    for row in range(start, stop):
        for column in range(depth.shape[1]):
            blend = weight[row, column]
            if depth[row, column] - detail_depth[row, column] < closer_m:
                blend = max(blend - one, zero)
            before = seen[row, column]
            for c in range(3):
                held = (one - before) * hdr[row, column, c] + before * radiance[row, column, c]
                radiance[row, column, c] = blend * detail[row, column, c] + (one - blend) * held
            depth[row, column] = blend * detail_depth[row, column] + (one - blend) * depth[row, column]
            seen[row, column] = min(before + blend, one)
