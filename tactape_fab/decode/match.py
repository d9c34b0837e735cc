"""Soft symbols -> place: every origin and quarter turn on every registered tape, scored with all dots together.

A score is ln E with E = product of 2 q(b) over the x and y bits of the dots: evidence against any texture whose bits are
fair coins to the tape. A dot where the tape has no part counts 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

Planes = npt.NDArray[np.float32]
Floats = npt.NDArray[np.float32]

# texture direction (E, S, W, N) -> x bit, y bit, as E = (0, 1), S = (1, 1), W = (1, 0), N = (0, 0)
X_BIT = np.array([0, 1, 1, 0], dtype=np.int64)
Y_BIT = np.array([1, 1, 0, 0], dtype=np.int64)
_BIT_OF_SYMBOL = np.array([(0, 0), (1, 0), (0, 1), (1, 1)], dtype=np.float32)  # N W E S: (x, y)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TapePlanes:
    """A tape's bits, padded for contacts that hang over its edge.

    Attributes
    ----------
    planes : ndarray of float32, shape (3, rows + 2 pad, columns + 2 pad)
        1 where a part is; x bit and y bit as -1 or 1 there; 0 elsewhere.
    pad : int
    """

    planes: Planes
    pad: int


def tape_planes(tape: Tape, pad: int) -> TapePlanes:
    """Bits of a tape with `pad` empty points round them."""
    bits = 2.0 * _BIT_OF_SYMBOL[tape.symbols] - 1.0
    placed = tape.placed.astype(np.float32)
    inside = np.stack([placed, placed * bits[..., 0], placed * bits[..., 1]])
    return TapePlanes(planes=np.pad(inside, ((0, 0), (pad, pad), (pad, pad))).astype(np.float32), pad=pad)


@njit(cache=True, error_model="numpy")
def turned(nodes: IntArray, q: FloatArray, turn: int) -> tuple[IntArray, FloatArray]:
    """Columns and rows of dots, and (mean, x, y) evidence of each, for a quarter turn of the grid's axes.

    For turn t the texture's x axis is the grid's first axis turned t times by 90 degrees (from u towards v).
    """
    n = len(q)
    cells = np.empty((n, 2), dtype=np.int64)
    evidence = np.empty((n, 3))
    for i in range(n):
        k, j = nodes[i, 0], nodes[i, 1]
        if turn == 0:
            cells[i, 0], cells[i, 1] = k, j
        elif turn == 1:
            cells[i, 0], cells[i, 1] = j, -k
        elif turn == 2:
            cells[i, 0], cells[i, 1] = -k, -j
        else:
            cells[i, 0], cells[i, 1] = -j, k
        e, s, w, m = q[i, turn % 4], q[i, (turn + 1) % 4], q[i, (turn + 2) % 4], q[i, (turn + 3) % 4]
        x1, x0 = np.log(2.0 * (w + s)), np.log(2.0 * (e + m))
        y1, y0 = np.log(2.0 * (e + s)), np.log(2.0 * (m + w))
        evidence[i, 0] = 0.5 * (x0 + x1 + y0 + y1)
        evidence[i, 1] = 0.5 * (x1 - x0)
        evidence[i, 2] = 0.5 * (y1 - y0)
    return cells, evidence


@njit(cache=True, fastmath=True, error_model="numpy")
def score_places(planes: Planes, pad: int, cells: IntArray, evidence: FloatArray) -> Floats:
    """Ln E of every origin of the dots on a tape.

    Parameters
    ----------
    planes, pad
        From `tape_planes`.
    cells : ndarray of int, shape (n, 2)
        Column and row of each dot, from 0; at most `pad`.

    Returns
    -------
    ndarray of float32, shape (rows + pad, columns + pad)
        Entry (r, c): the dots' cell (0, 0) lies on grid point (column c - pad, row r - pad).
    """
    height, width = planes.shape[1] - pad, planes.shape[2] - pad
    scores = np.zeros((height, width), dtype=np.float32)
    for i in range(len(cells)):
        column, row = cells[i, 0], cells[i, 1]
        mean, x, y = np.float32(evidence[i, 0]), np.float32(evidence[i, 1]), np.float32(evidence[i, 2])
        for r in range(height):
            placed = planes[0, r + row, column : column + width]
            x_bits = planes[1, r + row, column : column + width]
            y_bits = planes[2, r + row, column : column + width]
            line = scores[r]
            for c in range(width):  # slices, so that this becomes vector instructions
                line[c] += mean * placed[c] + x * x_bits[c] + y * y_bits[c]
    return scores


@njit(cache=True, error_model="numpy")
def others(scores: Floats, best: float, skip: int) -> tuple[float, float]:
    """Sum of E / exp(best) over all places but one, and the largest ln E among them."""
    total, largest = 0.0, -np.inf
    flat = scores.ravel()
    for i in range(len(flat)):
        if i == skip:
            continue
        value = flat[i]
        largest = max(largest, value)
        if value > best - 60.0:
            total += np.exp(value - best)
    return total, largest
