"""How kernels are compiled: kept on disk, divisions as numpy has them, and the interpreter's lock released while they run.

Kernels make no arrays but where it is said: they are given buffers by each call, so that any number of threads may run one at
the same time; and counting references is left out of what is compiled then. No kernel has an entry from C, which nobody uses:
an entry is a function more to compile. All other options are the same for all: numba compiles its own functions anew for others.

Where numba cannot be imported, or ``NUMBA_DISABLE_JIT=1`` is set, kernels are the plain Python functions: the same answers,
some thousand times slower.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from functools import cache, partial, wraps
from typing import Any, Protocol

import numpy as np

try:
    from numba import njit
    from numba.core import config
except ImportError:  # a platform without a wheel
    COMPILED = False
else:
    config._config_fname = os.devnull
    config.reload_config()  # type: ignore[no-untyped-call]
    # numba obeys a .numba_config.yaml of the current folder: a stranger's may name a folder of compiled functions
    COMPILED = not config.DISABLE_JIT  # type: ignore[attr-defined]
    """Whether kernels are compiled at all."""

Function = Callable[..., Any]


class Decorator(Protocol):
    """What makes a kernel of a function."""

    def __call__(self, **options: Any) -> Callable[[Function], Any]: ...


def _probe() -> None:
    """What numba is asked about; never called."""


def _can_be_kept() -> bool:
    """Whether a folder takes compiled functions: NUMBA_CACHE_DIR, the one beside the sources, or the user's."""
    try:
        njit(cache=True)(_probe)
    except RuntimeError:
        return False
    return True


@cache
def _say_slow() -> None:
    """Say once a process that nothing is compiled."""
    logging.getLogger("tactape_fab").warning(
        "numba is not installed, or NUMBA_DISABLE_JIT is set: tactape-fab decodes in plain Python, some thousand times slower; "
        "type: pip install numba"
    )


def _plain(**_options: Any) -> Callable[[Function], Any]:
    """A kernel as the Python function that it is, divisions by zero as numpy has them."""

    def decorate(function: Function) -> Function:
        @wraps(function)
        def called(*args: Any) -> Any:
            _say_slow()
            with np.errstate(all="ignore"):
                return function(*args)

        return called

    return decorate


def _untouched(**_options: Any) -> Callable[[Function], Any]:
    """What only kernels call, as it is; under numba's name for that as well."""

    def decorate(function: Function) -> Function:
        function.py_func = function  # type: ignore[attr-defined]
        return function

    return decorate


KEPT = COMPILED and _can_be_kept()
"""Where nothing can be kept, as for a user without a home in a read-only installation, every process compiles for itself."""

kernel: Decorator = _plain
"""For what Python calls."""
inner_kernel: Decorator = _untouched
"""For what only kernels call: it has no entry from Python either."""
making_kernel: Decorator = _plain
"""For what Python calls and what returns an array all the same."""
inlined_kernel: Decorator = _untouched
"""For what one kernel calls in one place, and no loop of which needs `fastmath`: it is compiled as a part of that kernel."""
if COMPILED:
    kernel = partial(njit, cache=KEPT, nogil=True, error_model="numpy", no_cfunc_wrapper=True, _nrt=False)
    inner_kernel = partial(kernel, cache=False, no_cpython_wrapper=True)  # a kernel on the disk holds what it calls
    making_kernel = partial(kernel, _nrt=True)
    inlined_kernel = partial(njit, inline="always", error_model="numpy")
