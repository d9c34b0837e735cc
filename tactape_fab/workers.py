"""One function in several processes: answers as they come, a lost process costs one answer, and none outlives the call."""

from __future__ import annotations

import gc
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection, get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

A = TypeVar("A")
R = TypeVar("R")
_PATIENCE_S = 20.0
"""How long a process may take to clean up behind itself when it is asked to stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lost:
    """In the place of an answer: the process died, with this exit status (negative: of a signal)."""

    exit_status: int | None


@dataclass(slots=True)
class _Worker(Generic[A, R]):
    process: BaseProcess
    ours: Connection
    index: int | None = None


def answers(function: Callable[[A], R], arguments: Sequence[A], count: int) -> Generator[tuple[int, R | Lost]]:
    """Call a function with each argument, in `count` fresh processes.

    Each process gets one argument at a time, so memory does not grow with their number. Close the iterator to stop early
    (`contextlib.closing`): processes at work are asked to end by SIGTERM, which raises SystemExit in them. SIGINT is for this
    process alone; the others never see it. They end by themselves, too, when this process is no more.

    Parameters
    ----------
    function : callable
        Of a module's top level, since it is imported in the other processes.
    arguments : sequence
        Each is pickled.
    count : int
        Number of processes at most.

    Yields
    ------
    int
        Index of the argument.
    R or Lost
        Its answer.
    """
    waiting = iter(enumerate(arguments))
    workers: list[_Worker[A, R]] = []
    try:
        for _ in range(min(count, len(arguments))):
            _next_job(_start(function, workers), waiting)
        while busy := {worker.ours: worker for worker in workers if worker.index is not None}:
            for ready in connection.wait(list(busy)):
                worker = busy[ready]  # type: ignore[index]
                index, answer = worker.index, _received(worker)
                assert index is not None
                if not isinstance(answer, Lost):
                    _next_job(worker, waiting)
                else:
                    workers.remove(worker)
                    if (job := next(waiting, None)) is not None:
                        _give(_start(function, workers), job)
                yield index, answer
    finally:
        _stop(workers)


def _received(worker: _Worker[A, R]) -> R | Lost:
    try:
        answer: R = worker.ours.recv()
    except (EOFError, OSError):
        worker.process.join(_PATIENCE_S)
        return Lost(exit_status=worker.process.exitcode)
    return answer


def _next_job(worker: _Worker[A, R], waiting: Iterator[tuple[int, A]]) -> None:
    worker.index = None
    if (job := next(waiting, None)) is not None:
        _give(worker, job)


def _give(worker: _Worker[A, R], job: tuple[int, A]) -> None:
    worker.index, argument = job
    with suppress(OSError):  # one that is dead is found by its connection's end
        worker.ours.send(argument)


def _start(function: Callable[[A], R], workers: list[_Worker[A, R]]) -> _Worker[A, R]:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, function), daemon=True)
    worker: _Worker[A, R] = _Worker(process, ours)
    with _interrupts_held():
        workers.append(worker)
        process.start()
    theirs.close()
    return worker


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold SIGINT back for a moment; a process that is started meanwhile never gets it."""
    if sys.platform == "win32":
        yield
        return
    resource_tracker.ensure_running()  # otherwise started with the first process, and it changes the signal mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(theirs: Connection, function: Callable[[Any], Any]) -> None:
    """What a process does: answer until nobody asks.

    Asked to stop it cleans up behind a function at work, and ends at once otherwise: a collector would swallow the exception.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    settled = False
    while True:
        try:
            argument = theirs.recv()
        except (EOFError, OSError):
            return
        signal.signal(signal.SIGTERM, _leave)
        answer = function(argument)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        try:
            theirs.send(answer)
        except OSError:
            return
        if not settled:  # what the first answer has loaded stays: the collector need not look at it with each of the others
            gc.collect()
            gc.freeze()
            settled = True


def _leave(*_: object) -> None:
    sys.exit(128 + signal.SIGTERM)


def _stop(workers: Sequence[_Worker[Any, Any]]) -> None:
    started = [worker for worker in workers if worker.process.pid is not None]
    for worker in started:
        if worker.index is not None:
            worker.process.terminate()
        worker.ours.close()
    end = time.monotonic() + _PATIENCE_S
    for worker in started:
        worker.process.join(max(0.0, end - time.monotonic()))
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
