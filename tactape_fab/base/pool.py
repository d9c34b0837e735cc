"""Functions mapped over many items: in this process, in isolated child processes, or by the workers of a Dask cluster.

The call of a process that dies is tried once more; no process outlives the pool. Random numbers are seeded by the item, never by
the worker or the order, so that results are the same bytes for any number of workers.
"""

from __future__ import annotations

import gc
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Generic, NoReturn, TypeVar

from tactape_fab.base.dropped_signal import OF_SIGNAL, repeat_dropped_signal
from tactape_fab.base.errors import LostProcessError, Problem, TactapeError
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.launch import python_command, start

if TYPE_CHECKING:
    from tactape_fab.base.cluster import ClusterPool

R = TypeVar("R")
Item = TypeVar("Item")
Workers = int | str
"""A number of processes, or the address of a Dask scheduler."""
MOST_WORKERS = 64
TRIES = 2
"""Tries of an item whose process dies: two, as memory may have been short, or somebody may have killed the process."""
_AHEAD = 4
"""Items per worker that are submitted and whose results are not yet taken, which bounds the memory of this process."""
_CLUSTER = re.compile(r"(tcp|tls)://[^\s/]+:\d{1,5}")
_PATIENCE_S = 20.0
"""Time that a process may take to clean up when asked to stop, s."""


def core_count() -> int:
    """Number of cores that this process may use."""
    # a batch system restricts the affinity; cpu_count counts all cores of the machine
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usual_workers() -> int:
    """Default number of workers: one for each core that this process may use."""
    return min(core_count(), MOST_WORKERS)


def checked_workers(value: object, problems: list[Problem], *, usual: Workers | None = None) -> Workers:
    """The user's choice of workers, checked; if there is none, `usual`, or one for each core."""
    if value is None:
        return usual_workers() if usual is None else usual
    if isinstance(value, str) and _CLUSTER.fullmatch(value):
        return value
    remedy = f"give a number of processes, 1 to {MOST_WORKERS}, or the address of a Dask scheduler, such as tcp://localhost:8786"
    if isinstance(value, str):
        problems.append(Problem("workers", f"workers = {shown(value)} is no number of processes and no address; {remedy}"))
        return 1
    return Fields({"workers": value}, problems=problems).integer("workers", low=1, high=MOST_WORKERS, remedy=remedy)


class ProcessPool(Executor):
    """Calls functions in up to `count` fresh processes, one call at a time in each.

    Unlike those of concurrent.futures.ProcessPoolExecutor, its processes are started by `tactape_fab.base.launch`: they import
    nothing from the current folder, and ignore SIGINT and SIGHUP. A process that dies fails only its own call, with
    `LostProcessError`. Messages that a function sends by `send_message` are passed to `on_message`. The processes end when this
    process ends. As a context manager, the pool stops at once if the block raises.
    """

    def __init__(self, count: int, on_message: Callable[..., object] = lambda *_: None) -> None:
        self.width = max(1, count)
        self._on_message = on_message
        self._scratch = tempfile.TemporaryDirectory(prefix="tactape-pool-", ignore_cleanup_errors=True)
        # one thread for each process: it owns the process, writes a call and waits for the answer
        self._threads = ThreadPoolExecutor(self.width)
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
        # an answer is (True, result), (False, error), or (None, message) for a message by `send_message`
        try:
            _send(child.stdin, (function, args, kwargs))
            answered, answer = pickle.load(child.stdout)
            while answered is None:
                self._on_message(*answer)
                answered, answer = pickle.load(child.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            # the thread's next call starts a new process
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
                # under the lock: a process that is started after `stop` would outlive the pool
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
        # one deadline for all processes together
        end = time.monotonic() + _PATIENCE_S
        for child in children:
            with suppress(subprocess.TimeoutExpired):
                child.wait(max(0.0, end - time.monotonic()))
            self._ended(child)
        self._scratch.cleanup()


# Mapping


def mapped(
    function: Callable[[Item], R],
    items: Iterable[Item],
    workers: Workers,
    *,
    lost: Callable[[Item, LostProcessError], R] | None = None,
    isolated: bool = False,
) -> Generator[R]:
    """Results in the order of the items, each as soon as it and those before it are known.

    Items are taken as workers become free, and results are not kept. Close the generator to stop: running calls are ended; on a
    cluster, only calls that have not begun.

    function: A module-level function: it is pickled, as items and results are.
    workers: With one, calls run in this process, unless `isolated`.
    lost: Gives the result of an item whose process died `TRIES` times; if left out, that is an error.
    Raises TactapeError for a lost process, and for a cluster that is lost or has other versions; and whatever the function
        raises.
    """
    for _, result in _mapped(function, items, workers, lost or _refuse_lost, isolated=isolated, ordered=True):
        yield result


def mapped_as_done(function: Callable[[Item], R], items: Iterable[Item], workers: Workers) -> Generator[tuple[Item, R]]:
    """Pairs of item and result as in `mapped`, but in the order in which results become known."""
    return _mapped(function, items, workers, _refuse_lost, isolated=False, ordered=False)


@dataclass(slots=True, eq=False)
class _Turn(Generic[Item, R]):
    """A submitted item, the number of its tries, and its result once it is known."""

    item: Item
    tries: int = 1
    result: tuple[R] | None = None


def _mapped(
    function: Callable[[Item], R],
    items: Iterable[Item],
    workers: Workers,
    lost: Callable[[Item, LostProcessError], R],
    *,
    isolated: bool,
    ordered: bool,
) -> Generator[tuple[Item, R]]:
    if workers == 1 and not isolated:
        yield from ((item, function(item)) for item in items)
        return
    todo = iter(items)
    pool = _pool(workers)
    at_work: dict[Future[R], _Turn[Item, R]] = {}
    turns: deque[_Turn[Item, R]] = deque()
    try:
        while True:
            # a tuple around the item, as None may be an item
            while len(turns) < _AHEAD * pool.width and (more := next(((item,) for item in todo), None)) is not None:
                turns.append(_Turn(more[0]))
                at_work[pool.submit(function, more[0])] = turns[-1]
            if not turns:
                return
            # with `ordered` only the first turn may be yielded
            ready = turns[0] if ordered else next((turn for turn in turns if turn.result), turns[0])
            if ready.result:
                turns.remove(ready)
                yield ready.item, ready.result[0]
                continue
            for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                turn = at_work.pop(future)
                try:
                    turn.result = (future.result(),)
                except LostProcessError as error:
                    if turn.tries < TRIES:
                        turn.tries += 1
                        at_work[pool.submit(function, turn.item)] = turn
                    else:
                        turn.result = (lost(turn.item, error),)
    finally:
        pool.stop()


def _pool(workers: Workers) -> ProcessPool | ClusterPool:
    if isinstance(workers, int):
        return ProcessPool(workers)
    from tactape_fab.base.cluster import ClusterPool

    return ClusterPool(workers)


def _refuse_lost(item: object, error: LostProcessError) -> NoReturn:
    raise TactapeError(f"a process {error}, and so did another one that tried again; where memory is short, use fewer --workers")


# In a process of the pool


def _send(pipe: BinaryIO | Any, value: object) -> None:
    pipe.write(pickle.dumps(value))
    pipe.flush()


_answers: BinaryIO | None = None
"""Pipe on which a process of a pool answers; None in any other process."""


def send_message(*message: object) -> None:
    """Send a message, such as progress, to the pool that runs this process."""
    if _answers is not None:
        _send(_answers, (None, message))


def serve() -> None:
    """Main loop of a process of the pool: answers calls until its input ends.

    SIGTERM during a call raises SystemExit in the function, which can clean up; it is repeated if that is dropped. Between calls
    it ends the process at once: an exception might be raised, and lost, in the garbage collector.
    """
    global _answers  # noqa: PLW0603 (one for each process)
    for name in ("SIGINT", "SIGHUP"):  # a terminal sends them to every process; the parent stops this one by SIGTERM
        if hasattr(signal, name):  # Windows has no SIGHUP
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    sys.unraisablehook = repeat_dropped_signal
    asked = sys.stdin.buffer
    # a copy of the pipe; descriptor 1 itself then goes to stderr
    _answers = answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a function's printed output must not mix with the results
    settled = False
    while True:
        try:
            function, args, kwargs = pickle.load(asked)
        except (EOFError, OSError):
            return
        # only during a call: between calls the default handler ends the process at once
        signal.signal(signal.SIGTERM, _leave)
        try:
            answer: tuple[bool, Any] = (True, function(*args, **kwargs))
        except Exception as error:  # re-raised in the caller
            answer = (False, error)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        try:
            _send(answers, answer)
        except OSError:
            return
        if not settled:  # objects loaded by the first call stay alive: exclude them from garbage collection
            gc.collect()
            gc.freeze()
            settled = True


def _leave(*_: object) -> None:
    sys.exit(OF_SIGNAL + signal.SIGTERM)
