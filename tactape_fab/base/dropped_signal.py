"""Signals whose exception Python drops, because it is raised in a callback from C or in the garbage collector."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

OF_SIGNAL = 128
INTERRUPTED = OF_SIGNAL + signal.SIGINT
"""Exit status of what Ctrl-C ends: 128 plus the number of the signal, as in shells."""
_AGAIN_S = 0.05
"""Delay after which a dropped signal is sent again, when the function that dropped it has returned."""


def repeat_dropped_signal(dropped: sys.UnraisableHookArgs) -> None:
    """Repeat Ctrl-C or SIGTERM shortly after its exception was dropped; to be `sys.unraisablehook`.

    numba's compiler has such a callback for each kernel, an import for each module: Python prints the exception's traceback and
    continues.
    """
    code = INTERRUPTED if issubclass(dropped.exc_type, KeyboardInterrupt) else getattr(dropped.exc_value, "code", None)
    if not (isinstance(code, int) and code > OF_SIGNAL):
        sys.__unraisablehook__(dropped)
        return
    later = threading.Timer(_AGAIN_S, _send, [code - OF_SIGNAL])
    later.daemon = True
    later.start()


def _send(number: int) -> None:
    """Send a signal to the main thread; by the system if it supports that, as it also interrupts blocking calls."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


@contextmanager
def signals_held() -> Iterator[None]:
    """Context manager: Ctrl-C, SIGTERM and SIGHUP that come in the block are handled at its end.

    Libraries of nanobind call Python as they are loaded, and end the process (std::terminate) at an exception in it.
    """
    came: list[int] = []
    before = {}
    if threading.current_thread() is threading.main_thread():  # handlers run in no other
        # not by a mask of signals: one that another thread takes is handled in this one all the same
        numbers = (getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP"))
        before = {n: signal.signal(n, lambda number, _: came.append(number)) for n in numbers if n}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in came:
            signal.raise_signal(number)
