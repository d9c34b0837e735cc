"""Calls of io and os, replaced for a while, to fail or to be counted."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import ModuleType
from typing import Any
from unittest import mock

_KEPT = getattr(pathlib, "_normal_accessor", None)
"""Where pathlib of Python 3.10 keeps functions of io and os since its import; newer ones look them up at each call."""


@contextmanager
def replaced(replacement: Callable[..., Any], name: str, *modules: ModuleType) -> Iterator[None]:
    """Context manager: methods of paths call the replacement, too, on every Python.

    replacement : callable
        What is called in place of the function.
    name, modules : str, module
        The function's name, and modules that have it.
    """
    places: list[object] = [*modules] if _KEPT is None else [*modules, _KEPT]
    with ExitStack() as stack:
        for place in places:
            stack.enter_context(mock.patch.object(place, name, replacement))
        yield
