"""Public names of a package, imported on first use, so that a script loads only what it uses (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package.

    package: Its ``__name__``.
    homes: Maps each module, relative to `tactape_fab`, to the public names that it defines, separated by blanks.
    """
    module_of = {name: f"tactape_fab.{module}" for module, names in homes.items() for name in names.split()}

    def attribute(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(module_of[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def shown() -> list[str]:
        return sorted({name for name in vars(sys.modules[package]) if name.startswith("__")} | module_of.keys())

    return attribute, shown, sorted(module_of)
