"""Templates of the texts and pages in kits, compiled once for all processes, as Python's own modules are."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.util import cache_from_source
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactape_fab.base.templates import templates_folder

if TYPE_CHECKING:
    from jinja2.bccache import Bucket


@cache
def template_environment(kind: str, *, autoescape: bool, finalize: Callable[[Any], Any] | None = None) -> Any:
    """Environment of the templates in a folder of the data files; names without a value are errors."""
    from jinja2 import BytecodeCache, Environment, FileSystemLoader, StrictUndefined

    class _BesideTheirSource(BytecodeCache):
        """Compiled templates in ``__pycache__``; with `PYTHONDONTWRITEBYTECODE`, or where nothing can be written, none."""

        def get_cache_key(self, name: str, filename: str | None = None) -> str:
            return cache_from_source(filename or name)

        def load_bytecode(self, bucket: Bucket) -> None:
            with suppress(Exception), Path(bucket.key).open("rb") as stream:  # without it, or damaged: it is compiled again
                bucket.load_bytecode(stream)

        def dump_bytecode(self, bucket: Bucket) -> None:
            unfinished = Path(f"{bucket.key}.{os.getpid()}")
            with suppress(OSError):
                if not sys.dont_write_bytecode:
                    unfinished.parent.mkdir(parents=True, exist_ok=True)
                    unfinished.write_bytes(bucket.bytecode_to_string())
                    unfinished.replace(bucket.key)

    return Environment(
        loader=FileSystemLoader(templates_folder() / kind),
        bytecode_cache=_BesideTheirSource(),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=autoescape,
        finalize=finalize,
    )
