"""Tables of pages stand between marks, `<!-- name -->` and `<!-- /name -->`; nobody types them."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path


def replaced(text: str, mark: str, new: str) -> str:
    """The text with something else between two marks, which stand on lines of their own."""
    before, begin, rest = text.partition(f"<!-- {mark} -->\n")
    _, end, after = rest.partition(f"<!-- /{mark} -->\n")
    if not (begin and end):
        raise ValueError(f"no lines <!-- {mark} --> and <!-- /{mark} -->")
    return before + begin + new + end + after


def write_between(page: Path, mark: str, text: str) -> None:
    """Replace what stands between two marks of a page."""
    page.write_text(replaced(page.read_text(encoding="utf-8"), mark, text), encoding="utf-8")


def command(module: str) -> str:
    """What was called to make a table, for the page."""
    return f"`python -m {module} {shlex.join(sys.argv[1:])}`"
