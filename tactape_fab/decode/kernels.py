"""The ways in which functions of the decoder are compiled; see `tactape_fab.kernels`."""

from __future__ import annotations

from functools import partial

from tactape_fab.kernels import KEPT, inlined_kernel, inner_kernel, kernel

__all__ = ["KEPT", "inlined_kernel", "inner_kernel", "kernel", "making_kernel"]

making_kernel = partial(kernel, _nrt=True)
"""For what returns an array all the same."""
