"""Checks of the types and shapes of arguments of public functions."""

from __future__ import annotations

import sys
from numbers import Integral, Real
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown

NO_ARRAY = (TypeError, ValueError, OverflowError, RuntimeError)
"""What `np.asarray` raises of what is no array of numbers; RuntimeError is that of PyTorch for a tensor that requires grad."""


def refuse_other(value: object, kind: type | tuple[type, ...], key: str, what: str, remedy: str) -> None:
    """Refuse a value of another type.

    key: Name of the argument.
    what: The expected thing; the message has it after "is no".
    remedy: What to give; the message has it after "give".
    Raises SpecError if it is of none of the types.
    """
    if not isinstance(value, kind):
        raise SpecError(Problem(key, f"{key} = {shown(value)} is no {what}; give {remedy}"))


def as_real(value: object, key: str, what: str, remedy: str) -> int | float:
    """A real number of any type as Python's own; a whole one with every digit.

    key, what, remedy: As for `refuse_other`.
    Raises SpecError if it is no real number, or beyond what a float holds.
    """
    # bool is a subclass of int: True would be 1
    if isinstance(value, bool) or not isinstance(value, Real):
        raise SpecError(Problem(key, f"{key} = {shown(value)} is no {what}; give {remedy}"))
    try:
        return int(value) if isinstance(value, Integral) else float(value)
    except OverflowError:  # a fraction beyond 1.8e308
        raise SpecError(Problem(key, f"{key} = {shown(value)} is beyond any float; give {remedy}")) from None


def unmasked(value: Any) -> Any:
    """A masked array of numbers with NaN for its masked values; anything else unchanged."""
    # numpy 2 loads `ma` where it is first named, in 12 ms: before that there is no masked array
    if "numpy.ma" not in sys.modules or not isinstance(value, np.ma.MaskedArray) or value.dtype.kind not in "fiub":
        return value
    return np.where(np.ma.getmaskarray(value), np.nan, value.data)


def as_numbers(
    value: object, shape: tuple[int | None, ...], key: str, remedy: str, *, finite: bool = True, flat: bool = False
) -> npt.NDArray[np.float64]:
    """A float64 array of the given shape; masked values become NaN.

    shape: Length along each axis; None for any.
    flat: Whether an array of several axes is flattened to one.
    Raises SpecError if it is not such an array, or not finite where `finite` asks for that.
    """
    try:
        array = np.asarray(unmasked(value))
        if array.size and array.dtype.kind not in "fiu":
            raise TypeError
        array = array.astype(np.float64).ravel() if flat else array.astype(np.float64)
    except NO_ARRAY:
        raise SpecError(Problem(key, f"{key} = {shown(value)} is no array of numbers; give {remedy}")) from None
    if len(array.shape) != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        raise SpecError(Problem(key, f"{key} has the shape {array.shape}; give {remedy}"))
    if finite and not np.isfinite(array).all():
        raise SpecError(Problem(key, f"{key} has a value that is not finite; give {remedy}"))
    return array
