"""Compilation of kernels: cached on disk, divisions as in numpy, and the interpreter's lock released by those that run for long.

Kernels allocate no arrays, except those of `making_kernel`: each call hands over its buffers, so that any number of threads may
run one at the same time, and reference counting is left out of the compiled code. No kernel has an entry from C: nothing uses
it, and it would have to be compiled. All other options are the same for all, as numba compiles its own functions anew for others.

Where numba cannot be imported, or ``NUMBA_DISABLE_JIT=1`` is set, kernels are the plain Python functions: the same answers,
some thousand times slower.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial, wraps
from pathlib import Path
from types import FunctionType
from typing import Any, Protocol

import numpy as np

from tactape_fab.base.kept_kernels import keep_whole


@contextmanager
def _absolute_folders() -> Iterator[None]:
    """Hide folders that are named relatively while numba looks where functions are kept: at its import, and for each kernel.

    It unpickles what is kept, and they would lie in the current folder, which may be a stranger's kit, as would that of an empty
    XDG_CACHE_HOME (the XDG base directory specification has both ignored). The program that imports this package keeps its own.
    """
    given = {name: os.environ.get(name) for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    hidden = {name: folder for name, folder in given.items() if folder is not None and not Path(folder).is_absolute()}
    for name in hidden:
        del os.environ[name]
    try:
        yield
    finally:
        os.environ.update(hidden)


_COLOURS = "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING"
_before = os.environ.get(_COLOURS)
os.environ.setdefault(_COLOURS, "1")  # numba colours all messages, those of rules that it tries in vain as well: 5 % of its time
try:
    with _absolute_folders():
        from numba import njit
        from numba.core import config
except ImportError:  # a platform without a wheel
    COMPILED = False
else:
    config._config_fname = os.devnull
    with _absolute_folders():
        config.reload_config()  # type: ignore[no-untyped-call]
    # numba obeys a .numba_config.yaml of the current folder: one of an untrusted folder may name compiled functions
    COMPILED = not config.DISABLE_JIT  # type: ignore[attr-defined]
    """Whether kernels are compiled at all."""
    with suppress(ImportError):
        # numba tries rules in the order of their imports. A kernel that is kept imports those of arrays last: for each a[i] those
        # of strings, lists and dicts are tried before, which takes two fifths of the time for types, a tenth of all
        from numba.core.typing import arraydecl, collections  # noqa: F401
if _before is None:
    del os.environ[_COLOURS]

Function = Callable[..., Any]


class Decorator(Protocol):
    """Decorator that makes a kernel of a function."""

    def __call__(self, **options: Any) -> Callable[[Function], Any]: ...


def _probe() -> None:
    """Function for which numba is asked for a cache folder; never called."""


def _can_be_kept() -> bool:
    """Whether a folder takes compiled functions: NUMBA_CACHE_DIR, the one beside the sources, or the user's."""
    try:
        with _absolute_folders():
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
    """A function that only kernels call, unchanged; also as its own `py_func`, as on a compiled one."""

    def decorate(function: Function) -> Function:
        function.py_func = function  # type: ignore[attr-defined]
        return function

    return decorate


KEPT = COMPILED and _can_be_kept()
"""Whether compiled functions are cached on disk; else, as in a read-only installation without a home, each process compiles."""

kernel: Decorator = _plain
"""For functions that Python calls, and that take less than the interpreter's switch interval of 5 ms.

They keep its lock. A thread that releases it waits, beside one that is busy in Python, a whole interval to have it again: twenty
kernels that release it made of a frame of 0.5 ms one of 40.
"""
long_kernel: Decorator = _plain
"""For functions that Python calls and that may take longer: over all places of many tapes, say. Other threads run meanwhile."""
inner_kernel: Decorator = _untouched
"""For functions that only kernels call: no entry from Python either."""
making_kernel: Decorator = _plain
"""For functions that Python calls and that allocate and return an array; as `long_kernel`."""
inlined_kernel: Decorator = _untouched
"""For functions called in one place of one kernel, without a loop that needs `fastmath`: compiled as a part of that kernel."""
if COMPILED:
    # `fastmath` is said either way: a function without it inherits that of the kernel it is compiled for first, and may then
    # assume that there is no NaN. Rewriting is of expressions of arrays, which no kernel has; and of branches on None, for which
    # the few that have some say `no_rewrites=False`
    _options: dict[str, Any] = {
        "cache": KEPT,
        "nogil": False,
        "error_model": "numpy",
        "no_cfunc_wrapper": True,
        "no_rewrites": True,
        "fastmath": False,
        "_nrt": False,
    }

    def _kernel(**options: Any) -> Callable[[Function], Any]:
        def decorate(function: Function) -> Any:
            if not Path(config.CACHE_DIR).is_absolute():  # type: ignore[attr-defined]
                config.CACHE_DIR = ""  # type: ignore[attr-defined]  # the program may have had numba read its settings again
            with _absolute_folders():
                compiled: Any = njit(**_options | options)(function)
            keep_whole(compiled)
            return compiled

        return decorate

    kernel = _kernel

    def _long_kernel(**options: Any) -> Callable[[Function], Any]:
        def decorate(function: Function) -> Any:
            # compiled functions are kept by their name: one that is compiled both ways has two
            named = FunctionType(function.__code__, function.__globals__, function.__name__)
            named.__qualname__ = f"{function.__qualname__}_long"
            return _kernel(nogil=True, **options)(named)

        return decorate

    long_kernel = _long_kernel
    inner_kernel = partial(kernel, cache=False, no_cpython_wrapper=True)  # a kernel on the disk holds what it calls
    making_kernel = partial(long_kernel, _nrt=True)
    inlined_kernel = partial(njit, inline="always", error_model="numpy")
