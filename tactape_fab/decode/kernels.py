"""How functions are compiled: kept on disk, divisions as numpy has them, and no entry that nobody uses.

Each entry (from Python, from C) is a function more to compile, again in every function that calls this one.
"""

from __future__ import annotations

from functools import partial

from numba import njit

kernel = partial(njit, cache=True, error_model="numpy", no_cfunc_wrapper=True)
"""Compiles a function that Python calls."""
inner = partial(kernel, no_cpython_wrapper=True)
"""Compiles a function that only compiled ones call: from Python it must not be called, there is nothing behind it."""
