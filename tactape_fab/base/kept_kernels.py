"""Compiled kernels on disk: each is stored with a digest of everything it was compiled from, and reused only if that is equal.

numba itself compares the date and size of one source file, and the function's own bytecode. A constant, or a kernel of another
file that is compiled into this one, may have changed since, for instance when a checkout is updated. And numba writes the index
before the code: a process that is killed in between, or finds the disk full, leaves old code under the new index.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from types import ModuleType
from typing import Any

import numpy as np

from tactape_fab.base.errors import reason_of

Key = tuple[Any, ...]


def keep_whole(kernel: Any) -> None:
    """Make numba's disk cache of a kernel use the digest; does nothing for a kernel that is not cached.

    The kernel is recompiled if the stored code cannot be read or has another digest, and still usable if it cannot be stored.
    """
    kept, file = kernel._cache, getattr(kernel._cache, "_cache_file", None)
    if file is not None:
        file.load, file.save = partial(_load, kernel, file, file.load), partial(_save, kernel, file.save)
        kept.save_overload = partial(_save_if_there_is_room, kept.save_overload, str(kept.cache_path))


def _load(kernel: Any, file: Any, load: Callable[[Key], Any], key: Key) -> Any:
    """`IndexDataCacheFile.load` of numba, but a pickle that is cut off, or names a class of another version of this package,
    empties the kernel's cache instead of raising.
    """
    try:
        found = load(key)
        if found is None:
            return None
        digest, data = found
    except Exception:  # pickle raises nearly anything: AttributeError, EOFError, ImportError, UnpicklingError, ValueError
        with suppress(OSError):
            file.flush()
        return None
    return data if digest == _digest(kernel, key) else None


def _save(kernel: Any, save: Callable[[Key, Any], None], key: Key, data: Any) -> None:
    save(key, (_digest(kernel, key), data))


def _save_if_there_is_room(save: Callable[[Any, Any], None], folder: str, signature: Any, data: Any) -> None:
    """`Cache.save_overload` of numba, but a full disk is a warning: the compiled kernel can be used all the same."""
    try:
        save(signature, data)
    except OSError as error:
        _warn_lost(folder, reason_of(error))


@cache
def _warn_lost(folder: str, reason: str) -> None:
    """Warn once per process that compiled kernels are not stored."""
    logging.getLogger("tactape_fab").warning(
        f"what is compiled cannot be kept in {folder}: {reason}; every start compiles it until there is room, or NUMBA_CACHE_DIR "
        "is set to another folder"
    )


def _digest(kernel: Any, key: Key) -> str:
    """SHA-256 of a kernel and its argument types; `key` is numba's, whose first item holds these types."""
    return sha256(repr((_made_of(kernel), _fields(key[0]))).encode()).hexdigest()


def _fields(types: Iterable[Any]) -> list[Any]:
    """Field names of the named tuples among numba types, whose repr gives the name of the class only."""
    return [(getattr(getattr(t, "instance_class", None), "_fields", ()), _fields(getattr(t, "types", ()))) for t in types]


@cache
def _made_of(kernel: Any) -> str:
    """SHA-256 of bytecode, options and constants of a kernel and of all kernels that it calls, directly or not."""
    digest, seen, todo = sha256(), {kernel}, [kernel]
    while todo:
        function, options = (of := todo.pop()).py_func, of.targetoptions
        code = function.__code__
        chosen = sorted((name, _constant(value)) for name, value in options.items())
        constants = [_constant(c) for c in code.co_consts if c is not function.__doc__]
        # numba compiles globals as constants
        known = {name: function.__globals__[name] for name in code.co_names if name in function.__globals__}
        named = [(name, _constant(value)) for name, value in known.items() if not hasattr(value, "py_func")]
        digest.update(repr((function.__qualname__, chosen, code.co_code, code.co_names, constants, named)).encode())
        for called in known.values():
            if hasattr(called, "py_func") and called not in seen:
                seen.add(called)
                todo.append(called)
    return digest.hexdigest()


def _constant(value: Any) -> Any:
    """A constant in a form whose repr is the same in every process: arrays as bytes, named tuple classes as their fields."""
    if isinstance(value, set | frozenset):  # iterated in another order in each process
        return sorted(value, key=repr)
    if isinstance(value, np.ndarray | np.generic):
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, type):
        return getattr(value, "_fields", ())
    return value if not callable(value) and not isinstance(value, ModuleType) else ""
