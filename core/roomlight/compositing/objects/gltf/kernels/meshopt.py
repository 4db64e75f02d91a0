# pyright: reportMissingParameterType=false
"""The bit streams of EXT_meshopt_compression, as the extension's own text defines them.

Each kernel reads the bytes `data` and returns how many it has read, or -1 where the stream ends before its values do.
"""

import numpy as np
from numba import njit

from roomlight.kernels.common import KERNEL


@njit(**KERNEL)
def attributes(data, out):
    """Decode mode 0 into `out` [count, stride] of bytes: each byte is stored as its change from the value before."""
    count, stride = out.shape
    tail = max(stride, 32)
    end = len(data) - tail
    if end < 1:
        return -1
    last = data[len(data) - stride :].copy()
    block = min((8192 // stride) & ~15, 256)
    at = 1
    for start in range(0, count, block):
        size = min(block, count - start)
        groups = (size + 15) // 16
        for k in range(stride):
            head = at
            at += (groups + 3) // 4
            if at > end:
                return -1
            for group in range(groups):
                mode = (data[head + group // 4] >> (2 * (group % 4))) & 3
                bits = (0, 2, 4, 8)[mode]
                extra = at + 2 * bits
                if extra > end:
                    return -1
                for i in range(16):
                    if mode == 0:
                        value = np.uint8(0)
                    elif mode == 3:
                        value = data[at + i]
                    else:
                        of_byte = 8 // bits
                        byte = data[at + i // of_byte]
                        value = np.uint8((byte >> (8 - bits - bits * (i % of_byte))) & ((1 << bits) - 1))
                        if value == (1 << bits) - 1:
                            if extra >= end:
                                return -1
                            value = data[extra]
                            extra += 1
                    number = 16 * group + i
                    if number < size:
                        delta = (value >> 1) ^ (0 if value & 1 == 0 else 255)
                        last[k] = np.uint8((last[k] + delta) & 255)
                        out[start + number, k] = last[k]
                at = extra
    return at


@njit(**KERNEL)
def _varint(data, at, end):
    """Return a number of 7 bits a byte, low ones first, and the place after it; -1 where it does not end."""
    value = np.uint32(0)
    for shift in range(0, 35, 7):
        if at >= end:
            return value, -1
        byte = np.uint32(data[at])
        at += 1
        value |= np.uint32((byte & np.uint32(127)) << np.uint32(shift))
        if byte < 128:
            return value, at
    return value, -1


@njit(**KERNEL)
def _moved(last, value):
    """Return the index that lies the zigzag-coded value from the last."""
    delta = np.uint32(value >> np.uint32(1))
    return np.uint32(last - delta - np.uint32(1)) if value & np.uint32(1) else np.uint32(last + delta)


@njit(**KERNEL)
def indices(data, out):
    """Decode mode 2 into `out` [count]: each index is its change from one of two before."""
    last = np.zeros(2, np.uint32)
    at, end = 1, len(data) - 4
    for i in range(len(out)):
        value, at = _varint(data, at, end)
        if at < 0:
            return -1
        which = int(value & np.uint32(1))
        last[which] = _moved(last[which], value >> np.uint32(1))
        out[i] = last[which]
    return at


@njit(**KERNEL)
def triangles(data, out):
    """Decode mode 1 into `out` [3 n]: each triangle names an edge and a vertex of those before, or new ones."""
    count = len(out) // 3
    codes, at, end = 1, 1 + count, len(data) - 16
    if at > end:
        return -1
    edges, points = np.zeros((16, 2), np.uint32), np.zeros(16, np.uint32)
    edge, point = 0, 0  # places after the last of the rings
    fresh, last = np.uint32(0), np.uint32(0)
    three, kinds = np.zeros(3, np.uint32), np.zeros(3, np.int64)
    for t in range(count):
        code = int(data[codes + t])
        if code < 0xF0:
            # 1. An edge of a triangle before, and one more vertex
            side, kind = code >> 4, code & 15
            a, b = edges[(edge - 1 - side) & 15, 0], edges[(edge - 1 - side) & 15, 1]
            pushed = True
            if kind == 0:
                c = fresh
                fresh += np.uint32(1)
            elif kind < 13:
                c = points[(point - 1 - kind) & 15]
                pushed = False
            else:
                if kind == 15:
                    value, at = _varint(data, at, end)
                    if at < 0:
                        return -1
                    last = _moved(last, value)
                else:
                    last = np.uint32(last - np.uint32(1)) if kind == 13 else np.uint32(last + np.uint32(1))
                c = last
            if pushed:
                points[point & 15] = c
                point += 1
            out[3 * t], out[3 * t + 1], out[3 * t + 2] = a, b, c
            edges[edge & 15, 0], edges[edge & 15, 1] = c, b
            edges[(edge + 1) & 15, 0], edges[(edge + 1) & 15, 1] = a, c
            edge += 2
            continue
        # 2. Three vertices: new, known or stated
        if code < 0xFE:
            pair = int(data[end + (code & 15)])
            kinds[0] = 0
        else:
            if at >= end:
                return -1
            pair = int(data[at])
            at += 1
            kinds[0] = 0 if code == 0xFE else 15
            if pair == 0:
                fresh = np.uint32(0)
        kinds[1], kinds[2] = pair >> 4, pair & 15
        stated = code >= 0xFE
        for j in range(3):
            if kinds[j] == 0:
                three[j] = fresh
                fresh += np.uint32(1)
            elif not (stated and kinds[j] == 15):
                three[j] = points[(point - kinds[j]) & 15]
        for j in range(3):
            if stated and kinds[j] == 15:
                value, at = _varint(data, at, end)
                if at < 0:
                    return -1
                last = _moved(last, value)
                three[j] = last
        for j in range(3):
            if kinds[j] == 0 or (stated and kinds[j] == 15):
                points[point & 15] = three[j]
                point += 1
        for j in range(3):
            out[3 * t + j] = three[j]
            edges[(edge + j) & 15, 0], edges[(edge + j) & 15, 1] = three[(j + 1) % 3], three[j]
        edge += 3
    return at
