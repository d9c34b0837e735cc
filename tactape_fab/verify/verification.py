"""The report of a kit is the one of the files that stand beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from tactape_fab.base.errors import Check
from tactape_fab.verify.files import WrittenFile, named

REPORT = "report"
"""Role of the report: the one file that is made after the others are verified, so that it may be missing."""

_DATA = re.compile(rb'<script type="application/json" id="data">(.*?)</script>', re.DOTALL)


def check_report(file: WrittenFile, manifest: Mapping[str, Any], what: str = "tape") -> Check:
    """The page shows this tape, or panel, and lists every other file of the kit as the manifest does."""
    problem, count = None, 0
    try:
        (text,) = _DATA.findall(file.data)
        content = json.loads(text)
        shown = {str(row["path"]): (row["role"], row["bytes"], row["sha256"]) for row in content["files"]}
        listed = {
            str(row["path"]): (row["role"], row["bytes"], row["sha256"]) for row in manifest["files"] if row["role"] != REPORT
        }
        count = len(listed)
        differing = [path for path in sorted(shown.keys() | listed.keys()) if shown.get(path) != listed.get(path)]
        if content["name"] != manifest["name"]:
            problem = f"it is that of another {what}"
        elif differing:
            problem = f"it does not show as they are: {named(differing)}"
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        problem = f"its data cannot be read: {type(error).__name__}"
    message = f"{file.path}: {problem}" if problem else f"of this {what}, with the SHA-256 of the {count} other files"
    return Check(name=REPORT, passed=problem is None, message=message)
