"""How functions are compiled: kept on disk, divisions as numpy has them, and no entry from C, which nobody uses.

An entry is a function more to compile. All other options are the same for all: numba compiles its own functions anew for
others.
"""

from __future__ import annotations

from functools import partial

from numba import njit

kernel = partial(njit, cache=True, error_model="numpy", no_cfunc_wrapper=True)
inner_kernel = partial(kernel, no_cpython_wrapper=True)
"""For what only kernels call: it has no entry from Python either."""
