"""How functions are compiled: kept on disk, divisions as numpy has them, and no entry from C, which nobody uses.

An entry is a function more to compile. All other options are the same for all: numba compiles its own functions anew for
others. Kernels make no arrays: they are given room to work in, and counting references is left out then.
"""

from __future__ import annotations

import os
from functools import partial

from numba import njit
from numba.core import config

config._config_fname = os.devnull
config.reload_config()  # type: ignore[no-untyped-call]
# numba obeys a .numba_config.yaml of the current folder, which may be a stranger's and can name a folder of compiled functions


def _probe() -> None:
    """What numba is asked about; never called."""


def _can_be_kept() -> bool:
    """Whether a folder takes compiled functions: NUMBA_CACHE_DIR, the one beside the sources, or the user's."""
    try:
        njit(cache=True)(_probe)
    except RuntimeError:
        return False
    return True


KEPT = _can_be_kept()
"""Where nothing can be kept, as for a user without a home in a read-only installation, every process compiles for itself."""

kernel = partial(njit, cache=KEPT, error_model="numpy", no_cfunc_wrapper=True, _nrt=False)
inner_kernel = partial(kernel, no_cpython_wrapper=True)
"""For what only kernels call: it has no entry from Python either."""
making_kernel = partial(kernel, _nrt=True)
"""For what returns an array all the same."""
inlined_kernel = partial(njit, inline="always", error_model="numpy")
"""For what one kernel calls in one place, and no loop of which needs `fastmath`: it is compiled as a part of that kernel."""
