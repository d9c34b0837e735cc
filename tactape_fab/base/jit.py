"""Compilation of kernels by numba: cached on disk, division by zero as in numpy, the GIL released by long kernels only.

Kernels allocate no arrays, except those of `making_kernel`: the caller passes buffers, so that any number of threads may run a
kernel at the same time, and compiled code needs no reference counting. No kernel has a C entry point, which nothing uses and
which takes time to compile. The other options are the same for all: numba compiles its own functions once per set of options.

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
    """Hide relative cache folders from numba while it looks for its cache: at its import, and for each kernel.

    numba unpickles what it finds there. A relative or empty XDG_CACHE_HOME leads to the current folder, which may be a stranger's
    kit (the XDG base directory specification ignores both). The environment of the importing program is restored afterwards.
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
os.environ.setdefault(_COLOURS, "1")  # numba colours even messages of failed typing rules that nobody sees: 5 % of its time
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
    # numba reads .numba_config.yaml of the current folder: in an untrusted folder it may name a cache of compiled functions
    COMPILED = not config.DISABLE_JIT  # type: ignore[attr-defined]
    """Whether kernels are compiled at all."""
    with suppress(ImportError):
        # numba tries typing rules in the order of their imports. Loading a cached kernel imports those of arrays last: each a[i]
        # is then tried by those of strings, lists and dicts first, which takes two fifths of type inference, a tenth of all
        from numba.core.typing import arraydecl, collections  # noqa: F401
if _before is None:
    del os.environ[_COLOURS]

Function = Callable[..., Any]


class Decorator(Protocol):
    """Decorator that compiles a function as a kernel."""

    def __call__(self, **options: Any) -> Callable[[Function], Any]: ...


def _probe() -> None:
    """Function for which `_can_be_kept` asks numba for a cache folder; never called."""


def _can_be_kept() -> bool:
    """Whether numba finds a writable cache folder: NUMBA_CACHE_DIR, one beside the sources, or the user's."""
    try:
        with _absolute_folders():
            njit(cache=True)(_probe)
    except RuntimeError:
        return False
    return True


@cache
def _warn_slow() -> None:
    """Warn once per process that kernels run uncompiled."""
    logging.getLogger("tactape_fab").warning(
        "numba is not installed, or NUMBA_DISABLE_JIT is set: tactape-fab decodes in plain Python, some thousand times slower; "
        "type: pip install numba"
    )


def _plain(**_options: Any) -> Callable[[Function], Any]:
    """A kernel as a plain Python function, with division by zero as in numpy."""

    def decorate(function: Function) -> Function:
        @wraps(function)
        def called(*args: Any) -> Any:
            _warn_slow()
            with np.errstate(all="ignore"):
                return function(*args)

        return called

    return decorate


def _untouched(**_options: Any) -> Callable[[Function], Any]:
    """A function that only kernels call, unchanged; it is its own `py_func`, an attribute that compiled functions have."""

    def decorate(function: Function) -> Function:
        function.py_func = function  # type: ignore[attr-defined]
        return function

    return decorate


KEPT = COMPILED and _can_be_kept()
"""Whether compiled functions are cached on disk; if not, as in a read-only installation without a home, each process compiles."""

kernel: Decorator = _plain
"""For functions that Python calls and that take less than the interpreter's switch interval of 5 ms. They keep the GIL.

A thread that releases it beside one that is busy in Python waits a whole interval to get it back: with twenty kernels that
release it, a frame of 0.5 ms took 40 ms.
"""
long_kernel: Decorator = _plain
"""For functions that Python calls and that may take longer, such as a search over many tapes. They release the GIL."""
inner_kernel: Decorator = _untouched
"""For functions that only kernels call: without a Python entry point either."""
making_kernel: Decorator = _plain
"""As `long_kernel`, for functions that allocate and return an array."""
inlined_kernel: Decorator = _untouched
"""For functions called at one place of one kernel, without a loop that needs `fastmath`: inlined into that kernel."""
if COMPILED:
    # `fastmath` is always set: a function without it inherits that of the kernel it is compiled for first, and may then assume
    # that there is no NaN. Rewriting concerns array expressions, which no kernel has, and branches on None: the few kernels that
    # have some set `no_rewrites=False`
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
                config.CACHE_DIR = ""  # type: ignore[attr-defined]  # the program may have made numba reload its settings
            with _absolute_folders():
                compiled: Any = njit(**_options | options)(function)
            keep_whole(compiled)
            return compiled

        return decorate

    kernel = _kernel

    def _long_kernel(**options: Any) -> Callable[[Function], Any]:
        def decorate(function: Function) -> Any:
            # numba's cache goes by the function's name: one that is compiled both ways needs two names
            named = FunctionType(function.__code__, function.__globals__, function.__name__)
            named.__qualname__ = f"{function.__qualname__}_long"
            return _kernel(nogil=True, **options)(named)

        return decorate

    long_kernel = _long_kernel
    inner_kernel = partial(kernel, cache=False, no_cpython_wrapper=True)  # a cached kernel contains the functions that it calls
    making_kernel = partial(long_kernel, _nrt=True)
    inlined_kernel = partial(njit, inline="always", error_model="numpy")
