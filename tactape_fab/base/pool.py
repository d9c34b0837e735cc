"""Executor of isolated processes: a process that dies fails only its own call, and none outlives the pool."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, TypeVar

from tactape_fab.base.launch import python_command, start

R = TypeVar("R")
_PATIENCE_S = 20.0
"""Time that a process may take to clean up when asked to stop, s."""


def core_count() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class LostProcessError(Exception):
    """A process died before it answered, with this exit status (negative: number of a signal)."""

    def __init__(self, exit_status: int) -> None:
        super().__init__(f"a process ended with status {exit_status}")
        self.exit_status = exit_status


class ProcessPool(Executor):
    """Calls functions in up to `count` fresh processes, one call at a time in each.

    Unlike those of concurrent.futures.ProcessPoolExecutor, its processes are started by `tactape_fab.base.launch`: they import
    nothing from the current folder, and never see SIGINT. A process that dies fails its own call alone, with
    `LostProcessError`. What a function in them says by `tell` is passed to `told`. They end by themselves when this process
    ends. As a context manager, the pool stops at once if the block raises.
    """

    def __init__(self, count: int, told: Callable[..., object] = lambda *_: None) -> None:
        self._told = told
        self._scratch = tempfile.TemporaryDirectory(prefix="tactape-pool-", ignore_cleanup_errors=True)
        self._threads = ThreadPoolExecutor(max(1, count))
        self._own = threading.local()
        self._lock = threading.Lock()
        self._children: list[subprocess.Popen[bytes]] = []
        self._stopped = False

    def submit(self, function: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Call a top-level function of a module in another process; arguments and result are pickled."""
        return self._threads.submit(self._ask, function, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the calls to end, then end the processes."""
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)
        if wait:
            self._end()

    def stop(self) -> None:
        """Stop busy processes by SIGTERM, which raises SystemExit in them, and wait until all have ended."""
        with self._lock:
            self._stopped = True
            for child in self._children:
                with suppress(OSError):
                    child.terminate()
        self._end()
        self._threads.shutdown(wait=True, cancel_futures=True)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> bool | None:
        if kind is not None:
            self.stop()
        return super().__exit__(kind, error, trace)

    def _ask(self, function: Callable[..., R], args: tuple[Any, ...], kwargs: dict[str, Any]) -> R:
        child = self._child()
        assert child.stdin is not None and child.stdout is not None
        try:
            _send(child.stdin, (function, args, kwargs))
            answered, answer = pickle.load(child.stdout)
            while answered is None:
                self._told(*answer)
                answered, answer = pickle.load(child.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            self._own.child = None
            raise LostProcessError(self._ended(child)) from None
        if not answered:
            raise answer
        result: R = answer
        return result

    def _child(self) -> subprocess.Popen[bytes]:
        """Process that belongs to the calling thread."""
        child: subprocess.Popen[bytes] | None = getattr(self._own, "child", None)
        if child is None:
            command = python_command(f"from {__name__} import serve; serve()")
            with self._lock:
                if self._stopped:
                    raise LostProcessError(-signal.SIGTERM)
                # its own session: the terminal's Ctrl-C reaches only the parent
                child = start(
                    command, Path(self._scratch.name), stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
                )
                self._children.append(child)
            self._own.child = child
        return child

    def _ended(self, child: subprocess.Popen[bytes]) -> int:
        with suppress(subprocess.TimeoutExpired):
            child.wait(_PATIENCE_S)
        if child.poll() is None:
            child.kill()
        status = child.wait()
        with self._lock:
            if child in self._children:
                self._children.remove(child)
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return status

    def _end(self) -> None:
        with self._lock:
            children = list(self._children)
        for child in children:
            if child.stdin is not None:
                with suppress(OSError):
                    child.stdin.close()
        end = time.monotonic() + _PATIENCE_S
        for child in children:
            with suppress(subprocess.TimeoutExpired):
                child.wait(max(0.0, end - time.monotonic()))
            self._ended(child)
        self._scratch.cleanup()


def _send(pipe: BinaryIO | Any, value: object) -> None:
    pipe.write(pickle.dumps(value))
    pipe.flush()


_answers: BinaryIO | None = None
"""Where a process of a pool answers; None in any other process."""


def tell(*message: object) -> None:
    """Say something, such as progress, to the pool that runs this process."""
    if _answers is not None:
        _send(_answers, (None, message))


def serve() -> None:
    """Main loop of a process of the pool: answers calls until its input ends.

    A stop request lets a running function clean up; otherwise the process ends at once: the collector would swallow the
    exception.
    """
    global _answers  # noqa: PLW0603 (one for each process)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked = sys.stdin.buffer
    _answers = answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a function's printed output must not mix with the results
    settled = False
    while True:
        try:
            function, args, kwargs = pickle.load(asked)
        except (EOFError, OSError):
            return
        signal.signal(signal.SIGTERM, _leave)
        try:
            answer: tuple[bool, Any] = (True, function(*args, **kwargs))
        except Exception as error:  # it is re-raised in the caller
            answer = (False, error)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        try:
            _send(answers, answer)
        except OSError:
            return
        if not settled:  # objects loaded by the first call stay alive: exclude them from later collections
            gc.collect()
            gc.freeze()
            settled = True


def _leave(*_: object) -> None:
    sys.exit(128 + signal.SIGTERM)
