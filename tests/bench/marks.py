"""Tables of pages stand between marks, `<!-- name -->` and `<!-- /name -->`; nobody types them.

Below a table of what was measured stands when it was, and with which sources.
"""

from __future__ import annotations

import hashlib
import shlex
import sys
from collections.abc import Iterable, Mapping
from datetime import datetime, timezone
from pathlib import Path

import tactape_fab

EVIDENCE = Path(__file__).parent / "evidence"


def replaced(text: str, mark: str, new: str) -> str:
    """The text with something else between two marks, which stand on lines of their own."""
    before, begin, rest = text.partition(f"<!-- {mark} -->\n")
    _, end, after = rest.partition(f"<!-- /{mark} -->\n")
    if not (begin and end):
        raise ValueError(f"no lines <!-- {mark} --> and <!-- /{mark} -->")
    return before + begin + new + end + after


def all_replaced(text: str, tables: Mapping[str, str]) -> str:
    """The text with every table between its marks."""
    for mark, new in tables.items():
        text = replaced(text, mark, new)
    return text


def write_between(page: Path, mark: str, text: str) -> None:
    """Replace what stands between two marks of a page by what was measured now."""
    page.write_text(replaced(page.read_text(encoding="utf-8"), mark, text + measured_line([stamp()])), encoding="utf-8")


def command(module: str) -> str:
    """What was called to make a table, for the page."""
    return f"`python -m {module} {shlex.join(sys.argv[1:])}`"


def digest() -> str:
    """Digest of the sources that figures are made with: the package, and the measures of docs/evidence.md."""
    package, found = Path(tactape_fab.__file__).parent, hashlib.sha256()
    for path in sorted([*package.rglob("*.py"), *EVIDENCE.rglob("*.py")]):
        found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()[:16]


def stamp() -> dict[str, str]:
    """When something is measured, and with which sources."""
    return {"day": datetime.now(timezone.utc).date().isoformat(), "sources": digest()}


def measured_line(stamps: Iterable[Mapping[str, str]]) -> str:
    """The line below a table: when its figures were measured, and with which sources."""
    found = sorted({(one["day"], one.get("sources", "")) for one in stamps})
    # figures from before sources were recorded have the day when their page came to say them
    said = [f"on {day} with sources `{sources}`" if sources else f"by {day} with sources not recorded" for day, sources in found]
    return f"\nMeasured {', and '.join(said)}; [evidence](evidence.md) says how to tell whether these are today's.\n"
