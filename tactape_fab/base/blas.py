"""OpenBLAS on one thread: more threads do not speed up small systems, and on a busy machine they wait for each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from ctypes import CDLL
from pathlib import Path
from typing import Any


@contextmanager
def one_thread() -> Iterator[None]:
    """Context manager: every OpenBLAS in this process uses one thread (numpy and scipy each bundle one); Linux only.

    OPENBLAS_NUM_THREADS, which commands set, is read when numpy is imported.
    """
    before = [(put, get()) for get, put in thread_counts()]
    try:
        for put, _ in before:
            put(1)
        yield
    finally:
        for put, count in before:
            put(count)


def thread_counts() -> list[tuple[Callable[[], int], Callable[[int], Any]]]:
    """Getter and setter of the number of threads, for each OpenBLAS loaded in this process."""
    found = []
    with suppress(OSError):  # no Linux, or a library that was replaced since
        mapped = Path("/proc/self/maps").read_text(encoding="utf-8", errors="surrogateescape")
        # address, permissions, offset, device, inode, path (proc_pid_maps(5))
        for path in sorted({line.split(maxsplit=5)[-1] for line in mapped.splitlines() if "openblas" in line.rpartition("/")[2]}):
            loaded = CDLL(path)
            for name in ("openblas_{}", "scipy_openblas_{}"):
                for form in (f"{name}_num_threads", f"{name}_num_threads64_"):
                    if hasattr(loaded, form.format("set")):
                        found.append((getattr(loaded, form.format("get")), getattr(loaded, form.format("set"))))
    return found
