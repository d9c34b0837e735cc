"""Formatting of many rows of numbers in numpy; the bytes are the same as those of Python's ``%`` row by row.

Each character passes through memory five times, so callers give some 20,000 rows at a time, which stay in the processor's cache.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

Cells = npt.NDArray[np.uint8]
"""ASCII characters, one row per number, padded with NUL."""

_FIELD = re.compile(rb"%(?:%|d|\.(\d)f)")
_EXACT = 2.0**51
"""Below it, doubles represent every half, and differences from integers are exact."""
_FOUR = 10_000
# shape (10000, 4): the digits of each number, then the same with NUL for zeros before the first other digit
_WITH_ZEROS = (np.arange(_FOUR)[:, None] // (1000, 100, 10, 1) % 10 + ord("0")).astype(np.uint8)
_WITHOUT = np.where(np.logical_or.accumulate(ord("0") != _WITH_ZEROS, axis=1), _WITH_ZEROS, 0).astype(np.uint8)
# four characters as one word of 32 bits, written and read in the machine's own order: one look-up for four digits
_FOUR_DIGITS = np.concatenate([_WITHOUT, _WITH_ZEROS]).view(np.uint32).ravel()
"""Four digits of each number below 10,000, without leading zeros; then the same with leading zeros."""


def number_rows(template: str, *columns: npt.NDArray[Any]) -> bytes:
    """The text of ``template % row`` for each row, concatenated.

    template: ASCII, with ``%d`` and ``%.Nf`` for numbers, and ``%%``.
    columns: One array of length n for each number, or one of shape (n, k) for k of them.
    """
    values = [column for some in columns for column in (some.T if some.ndim > 1 else [some])]
    text, texts, left, end = template.encode("ascii"), [], iter(values), 0
    for match in _FIELD.finditer(text):
        # constant text is one row that numpy broadcasts
        texts.append(np.frombuffer(text[end : match.start()] + b"%" * (match[0] == b"%%"), dtype=np.uint8))
        if match[0] != b"%%":
            texts.append(_whole(next(left)) if match[1] is None else _fixed(next(left), int(match[1])))
        end = match.end()
    texts.append(np.frombuffer(text[end:], dtype=np.uint8))
    ends = np.cumsum([0, *(cells.shape[-1] for cells in texts)]).tolist()
    rows = np.empty((len(values[0]), ends[-1]), dtype=np.uint8)
    for cells, (begin, end) in zip(texts, pairwise(ends), strict=True):
        rows[:, begin:end] = cells
    # the NUL that pads numbers to the width of the longest is removed at the end, in one pass
    written = rows.tobytes()
    return written.translate(None, b"\0") if b"\0" in written else written


def _whole(values: npt.NDArray[Any]) -> Cells:
    """``%d`` of each integer."""
    # the negative of a narrow type's smallest number does not fit in that type
    size = np.abs(values.astype(np.int64, copy=False)) if values.dtype.kind == "i" else values
    return _signed(digits(size), values < 0)


def _fixed(values: npt.NDArray[Any], decimals: int) -> Cells:
    """``%.Nf`` of each number, N being `decimals`.

    Floating-point multiplication is monotonic and halves are exact: a product that comes out on one side of a half was on that
    side. So only numbers whose product is exactly a half are left to Python.
    """
    values = values.astype(np.float64, copy=False)  # products in single precision would be rounded differently
    # products from 2**51 on are left to Python: below, doubles are at most a quarter apart, so that every half is a double
    if not (np.abs(values) < _EXACT / 10.0**decimals).all():
        texts = np.array([b"%.*f" % (decimals, value) for value in values.tolist()])
        return texts.view(np.uint8).reshape(len(values), -1)
    scaled = values * 10.0**decimals
    nearest = np.rint(scaled)
    # A product just off a half may be rounded onto it, never across: the
    # sign of the rest is then unknown, and Python's exact decimal decides
    half = np.abs(scaled - nearest) == 0.5
    nearest[half] = [float((b"%.*f" % (decimals, value)).replace(b".", b"")) for value in values[half].tolist()]
    size = np.abs(nearest).astype(np.int64)
    above = size // 10**decimals
    point = np.full((len(values), min(decimals, 1)), ord("."), dtype=np.uint8)
    return _signed(np.hstack([digits(above), point, digits(size - above * 10**decimals, decimals)]), np.signbit(values))


def _signed(size: Cells, negative: npt.NDArray[np.bool_]) -> Cells:
    return np.column_stack([negative * np.uint8(ord("-")), size]) if negative.any() else size


def digits(values: npt.NDArray[Any], count: int | None = None) -> Cells:
    """Decimal digits of non-negative integers; with leading zeros to `count` digits if that is given."""
    most = int(values.max(initial=0))
    width = len(str(most)) if count is None else count
    # 32 bits where they suffice: their division is faster
    rest: npt.NDArray[Any] = values.astype(np.uint32 if most < 1 << 32 else np.uint64)
    fours = np.empty((len(values), -(-width // 4)), dtype=np.uint32)
    # groups of four digits, the last first
    for place in reversed(range(fours.shape[1])):
        above = rest // _FOUR
        low = rest - above * _FOUR
        # leading zeros are written if a higher group is not zero, or for a fixed number of digits
        low += _FOUR if count is not None else (above > 0) * rest.dtype.type(_FOUR)
        fours[:, place] = _FOUR_DIGITS[low]
        rest = above
    found = fours.view(np.uint8)[:, 4 * fours.shape[1] - width :]
    if count is None:
        # 0 has no digit but leading zeros, of which one is written
        found[values == 0, -1] = ord("0")
    return found
