"""A Dask cluster of three worker processes: the same results as here, a worker killed, the scheduler killed."""

from __future__ import annotations

import inspect
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

from tactape_fab.base import cluster
from tactape_fab.base.cluster import ClusterPool, LostClusterError, OtherWorkerError, _called
from tactape_fab.base.jit import COMPILED
from tactape_fab.base.libraries import library
from tactape_fab.base.pool import mapped
from tests.thorough import only_thorough
from tests.unit.base.test_mapped import drawn

pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed")
WORKERS = 3
ROOT = Path(__file__).parents[3]
_SERVE = f"""
import logging, os, sys, threading
sys.path.insert(0, {str(ROOT)!r})
from distributed import LocalCluster
if __name__ == "__main__":
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with LocalCluster(n_workers={WORKERS}, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        print(cluster.scheduler_address, *(w.pid for w in cluster.workers.values()), flush=True)
        sys.stdin.read()
"""


@dataclass(frozen=True, slots=True)
class Cluster:
    """Address of a scheduler, its process, and the processes of its workers."""

    address: str
    scheduler: subprocess.Popen[str]
    workers: tuple[int, ...]


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Shared by the tests of this file: a worker that is killed comes again, and the last test kills the scheduler."""
    folder = tmp_path_factory.mktemp("cluster")
    script = folder / "serve.py"
    script.write_text(_SERVE)
    settings = {"DASK_DISTRIBUTED__WORKER__DAEMON": "True", "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
    child = subprocess.Popen(
        [sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=folder,
        env=os.environ | settings,
    )
    assert child.stdout is not None
    address, *workers = child.stdout.readline().split()
    yield Cluster(address, child, tuple(map(int, workers)))
    child.kill()
    child.wait()
    for pid in workers:  # a scheduler that is killed leaves them
        with suppress(ProcessLookupError):
            os.kill(int(pid), signal.SIGKILL)
    child.stdout.close()
    if child.stdin is not None:
        child.stdin.close()


def slow(seed: int) -> bytes:
    time.sleep(0.1)
    return random.Random(seed).randbytes(64)


def pid_of(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


@only_thorough
def test_a_cluster_gives_the_bytes_of_one_process(three: Cluster) -> None:
    assert list(mapped(drawn, range(40), three.address)) == list(mapped(drawn, range(40), 1))
    assert len(set(mapped(pid_of, range(24), three.address))) == WORKERS


@only_thorough
def test_a_worker_killed_at_work_costs_a_second_try(three: Cluster) -> None:
    found = []
    with closing(mapped(slow, range(30), three.address)) as results:
        for k, result in enumerate(results):
            found.append(result)
            if k == 4:
                os.kill(int(three.workers[0]), signal.SIGKILL)
    assert found == [random.Random(i).randbytes(64) for i in range(30)]


@only_thorough
def test_a_scheduler_killed_ends_with_one_line(three: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_PATIENCE_S", 3.0)
    found = []
    with closing(mapped(slow, range(1000), three.address)) as results, pytest.raises(LostClusterError) as lost:
        for k, result in enumerate(results):
            found.append(result)
            if k == 4:
                three.scheduler.kill()
    assert len(found) >= 5
    assert found == [random.Random(i).randbytes(64) for i in range(len(found))]
    assert str(lost.value) == f"the scheduler {three.address} was lost; what is done stays, so start it and ask for the rest"


@only_thorough
def test_no_scheduler_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_PATIENCE_S", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(LostClusterError, match=rf"^no scheduler answers at {address} within 1 s; start one with: dask scheduler"):
        list(mapped(drawn, range(2), address))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, "Dask's settings name no certificates"),
        ({"ca-file": "none.pem", "client": {"cert": "none.pem", "key": None}}, "cannot be read: No such file or directory"),
    ],
)
def test_tls_without_certificates_is_refused_before_anything_is_asked(settings: dict[str, object], said: str) -> None:
    import dask

    library("distributed", "this test")  # its settings come with it
    usual = {"ca-file": None, "client": {"cert": None, "key": None}}
    with (
        dask.config.set({f"distributed.comm.tls.{key}": value for key, value in (usual | settings).items()}),
        pytest.raises(
            LostClusterError, match=rf"^tls://127\.0\.0\.1:1 cannot be asked: .*{said}; name the files in DASK_\w+__CA_FILE"
        ),
    ):
        ClusterPool("tls://127.0.0.1:1")


def test_a_worker_of_another_version_is_refused() -> None:
    with pytest.raises(OtherWorkerError, match=r"tactape-fab .* instead of 0\.0\.0; install the same versions there"):
        _called({"tactape-fab": "0.0.0"}, abs, (-1,), {})
    assert _called(cluster._own(), abs, (-1,), {}) == 1


@pytest.mark.skipif(not COMPILED, reason="numba is not installed")
def test_a_worker_that_compiles_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = cluster._own()
    monkeypatch.setattr(cluster, "COMPILED", False)
    with pytest.raises(OtherWorkerError, match=r"has numba none instead of \d[\d.]+; install the same versions there"):
        _called(asked, abs, (-1,), {})
    assert _called(cluster._own(), abs, (-1,), {}) == 1


def test_a_scheduler_without_the_package_is_said_in_one_line() -> None:
    scheduler = pytest.importorskip("distributed.scheduler")
    assert cluster._UNREAD in inspect.getsource(scheduler.Scheduler.update_graph)
    pool = object.__new__(ClusterPool)
    pool.address = "tcp://127.0.0.1:8786"
    error = RuntimeError(f"Error during {cluster._UNREAD}.\nFor more information")
    error.__cause__ = ModuleNotFoundError("No module named 'tactape_fab'")
    said = pool._error_of(SimpleNamespace(status="error"), error)
    assert isinstance(said, OtherWorkerError)
    begin = "the scheduler tcp://127.0.0.1:8786 cannot read what it is given: No module named 'tactape_fab'; install tactape-fab "
    assert str(said).startswith(begin) and "\n" not in str(said)
