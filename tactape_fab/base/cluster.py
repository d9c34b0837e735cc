"""Executor on a Dask cluster that the user names: calls go to its scheduler, which distributes them to its workers.

Dask sends calls and results as pickles, so scheduler, workers and this process can run each other's code. This process connects
only to the scheduler that the user names, and does not listen.
"""

from __future__ import annotations

import logging
import platform
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from types import TracebackType
from typing import Any, TypeVar

from tactape_fab.base.errors import LostProcessError, TactapeError, reason_of
from tactape_fab.base.jit import COMPILED
from tactape_fab.base.libraries import library, versions_in_kits
from tactape_fab.base.version import __version__

R = TypeVar("R")
_PATIENCE_S = 10.0
"""Time for a scheduler to answer, and for its first worker to be there, s."""
_UNREAD = "deserialization of the task graph"
"""Part of Dask's error when the scheduler lacks a module that a call needs."""
_ALONE = threading.Lock()
"""Held by the call that a worker runs: functions here may change the current folder, which all threads share."""


class LostClusterError(TactapeError):
    """The scheduler of a cluster cannot be reached, has no worker, or is gone."""


class OtherWorkerError(TactapeError):
    """A worker has other versions than this process, so its results may differ, or the scheduler cannot unpickle calls."""


class ClusterPool(Executor):
    """Calls functions in the workers of a Dask scheduler; a call whose worker dies is given to another one.

    Raises MissingLibraryError without the extra ``cluster``.
    Raises LostClusterError if nothing answers at the address, or there is no worker; by a call, once the scheduler is gone.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._asked: set[Any] = set()
        distributed = library("distributed", f"--workers {address}")
        for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in ("distributed", "tornado")]:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what matters in their logs is raised as an error
        _refuse_no_certificate(distributed, address)
        try:
            self._client = distributed.Client(address, timeout=_PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            started = f"start one with: dask scheduler --port {address.rpartition(':')[2]}"
            raise LostClusterError(f"no scheduler answers at {address} within {_PATIENCE_S:g} s; {started}") from error
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE_S)
        except TimeoutError as error:
            self.stop()
            started = f"start some with: dask worker {address} --nworkers auto --nthreads 1"
            raise LostClusterError(f"the scheduler {address} has no workers; {started}") from error
        self.width: int = len(self._client.nthreads())

    def submit(self, function: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Call a function of a module that the workers have, too; arguments and result are pickled."""
        answer: Future[R] = Future()
        if self._client.status == "closed":
            answer.set_exception(self._lost())
            return answer
        # pure=False: equal calls are not one call
        asked = self._client.submit(_called, _own(), function, args, kwargs, pure=False)
        self._asked.add(asked)
        asked.add_done_callback(partial(self._answered, answer))
        return answer

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster; its workers go on for others."""
        self.stop()

    def stop(self) -> None:
        """Cancel calls that no worker has begun, and leave the cluster."""
        with suppress(Exception):
            self._client.cancel(list(self._asked), force=True)
        self._asked.clear()
        with suppress(Exception):
            self._client.close(timeout=2)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def _answered(self, answer: Future[R], asked: Any) -> None:
        """Pass the cluster's result to the caller's future; called in a thread of the client."""
        try:
            answer.set_result(asked.result(timeout=None))
        except BaseException as error:  # CancelledError is not an Exception
            answer.set_exception(self._error_of(asked, error))
        finally:
            self._asked.discard(asked)

    def _error_of(self, asked: Any, error: BaseException) -> BaseException:
        if asked.status != "error":
            return self._lost()
        # by name, as the library is optional; reported like a process that SIGKILL (9) ended
        if type(error).__name__ == "KilledWorker":
            return LostProcessError(-9)
        if isinstance(error, ModuleNotFoundError) and str(error.name).partition(".")[0] == __name__.partition(".")[0]:
            return OtherWorkerError(
                f"a worker of {self.address} has no tactape-fab; install version {__version__} there, as here"
            )
        if isinstance(error, RuntimeError) and _UNREAD in str(error):
            remedy = f"install tactape-fab {__version__} and the same libraries there, as here, and start it again"
            return OtherWorkerError(f"the scheduler {self.address} cannot read what it is given: {error.__cause__}; {remedy}")
        return error

    def _lost(self) -> LostClusterError:
        return LostClusterError(f"the scheduler {self.address} was lost; what is done stays, so start it and ask for the rest")


def _refuse_no_certificate(distributed: Any, address: str) -> None:
    """Refuse tls:// without certificates, on which Dask raises a TypeError and hangs. Raises LostClusterError."""
    if not address.startswith("tls://"):
        return
    try:
        found = distributed.Security().get_connection_args("client").get("ssl_context")
        why = "Dask's settings name no certificates" if found is None else None
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        why = f"the certificates of Dask's settings cannot be read: {reason_of(error)}"
    if why is not None:
        files = ", ".join(f"DASK_DISTRIBUTED__COMM__TLS__{name}" for name in ("CA_FILE", "CLIENT__CERT", "CLIENT__KEY"))
        raise LostClusterError(f"{address} cannot be asked: {why}; name the files in {files}")


def _own() -> dict[str, str]:
    """Versions on which bytes of a result may depend: those recorded in kits, and numba's, as kernels may round differently."""
    return {"tactape-fab": __version__, **versions_in_kits(), **({"numba": version("numba")} if COMPILED else {})}


def _called(theirs: dict[str, str], function: Callable[..., R], args: tuple[Any, ...], kwargs: dict[str, Any]) -> R:
    """Run a call in a worker; refused if the worker's versions are not the caller's."""
    own = _own()
    other = [f"{k} {own.get(k, 'none')} instead of {v}" for k, v in theirs.items() if own.get(k) != v]
    if other:
        raise OtherWorkerError(f"the worker on {platform.node()} has {', '.join(other)}; install the same versions there")
    with _ALONE:
        return function(*args, **kwargs)
