# pyright: reportMissingParameterType=false
"""The bit streams of EXT_ and KHR_meshopt_compression, as the extensions' own text defines them.

Each kernel reads the bytes `data` and returns how many it has read, or -1 where the stream ends before its values do.
"""

import numpy as np
from numba import njit

from roomlight.kernels.common import KERNEL


@njit(**KERNEL)
def _group(data, at, end, bits, out):
    """Read 16 deltas of 0, 1, 2, 4 or 8 bits into `out`; return the place after them, -1 where they do not end."""
    extra = at + 2 * bits
    if extra > end:
        return -1
    for i in range(16):
        if bits == 0:
            out[i] = 0
        elif bits == 8:
            out[i] = data[at + i]
        else:
            place = bits * i % 8
            shift = place if bits == 1 else 8 - bits - place
            out[i] = (data[at + bits * i // 8] >> shift) & ((1 << bits) - 1)
            if out[i] == (1 << bits) - 1:
                if extra >= end:
                    return -1
                out[i] = data[extra]
                extra += 1
    return extra


@njit(**KERNEL)
def _add_deltas(deltas, mode, last):
    """Change 4 bytes of the value before by 4 deltas, of 8 or 16 bits (zigzag) or of 32 bits (exclusive or)."""
    if mode & 15 == 2:
        change = np.uint32(0)
        for k in range(4):
            change |= np.uint32(deltas[k]) << np.uint32(8 * k)
        turn = np.uint32(mode >> 4)
        change = np.uint32(change >> turn) | np.uint32(change << np.uint32((32 - turn) & 31))
        for k in range(4):
            last[k] ^= np.uint8((change >> np.uint32(8 * k)) & np.uint32(255))
        return
    size = mode + 1
    for first in range(0, 4, size):
        change, value = 0, 0
        for k in range(size):
            change |= int(deltas[first + k]) << (8 * k)
            value |= int(last[first + k]) << (8 * k)
        value += -(change >> 1) - 1 if change & 1 else change >> 1
        for k in range(size):
            last[first + k] = np.uint8((value >> (8 * k)) & 255)


@njit(**KERNEL)
def attributes(data, out):
    """Decode mode 0 into `out` [count, stride] of bytes: each byte is stored as its change from the value before.

    The header 0xA0 is version 0; 0xA1 is version 1, of KHR_meshopt_compression, whose blocks have control bytes and
    whose tail has a mode for every 4 bytes.
    """
    count, stride = out.shape
    newer = data[0] == 0xA1
    tail = max(stride + stride // 4, 24) if newer else max(stride, 32)
    end = len(data) - tail
    if end < 1:
        return -1
    first = len(data) - stride - (stride // 4 if newer else 0)
    last, modes = data[first : first + stride].copy(), np.zeros(stride // 4, np.uint8)
    if newer:
        modes[:] = data[first + stride :]
        for mode in modes:
            if mode & 15 > 2 or (mode & 15 < 2 and mode > 1):
                return -1
    block = min((8192 // stride) & ~15, 256)
    deltas, read = np.zeros((stride, 256), np.uint8), np.zeros(16, np.uint8)
    at = 1
    for start in range(0, count, block):
        size = min(block, count - start)
        groups = (size + 15) // 16
        controls = at
        at += stride // 4 if newer else 0
        if at > end:
            return -1
        for k in range(stride):
            control = (data[controls + k // 4] >> (2 * (k % 4))) & 3 if newer else 4
            if control == 2:
                deltas[k] = 0
                continue
            if control == 3:
                if at + size > end:
                    return -1
                deltas[k, :size] = data[at : at + size]
                at += size
                continue
            lengths = (0, 1, 2, 4) if control == 0 else (1, 2, 4, 8) if control == 1 else (0, 2, 4, 8)
            head = at
            at += (groups + 3) // 4
            if at > end:
                return -1
            for group in range(groups):
                at = _group(data, at, end, lengths[(data[head + group // 4] >> (2 * (group % 4))) & 3], read)
                if at < 0:
                    return -1
                deltas[k, 16 * group : 16 * group + 16] = read
        for number in range(size):
            for k in range(0, stride, 4):
                _add_deltas(deltas[k : k + 4, number], modes[k // 4], last[k : k + 4])
            out[start + number] = last
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
