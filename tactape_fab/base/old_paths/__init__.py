"""Modules of earlier versions that scripts may still import; each name is taken from its new module, with a warning.

This folder is on the package's ``__path__``: `tactape_fab.decode` is its `decode.py`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any


def moved(module: str, name: str, homes: Mapping[str, str]) -> Any:
    """A name of an old module, taken from its new module with a warning."""
    if name not in homes:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(
        f"{module}.{name} has moved: import {name} from {homes[name]}; this path goes in the next version",
        DeprecationWarning,
        stacklevel=3,
    )
    return getattr(import_module(homes[name]), name)
