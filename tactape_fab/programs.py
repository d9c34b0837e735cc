"""Outside programs that read models: what they are called, and where they are."""

from __future__ import annotations

import shutil
from collections.abc import Sequence

FREECAD = ("freecadcmd", "FreeCADCmd")
PRUSA_SLICER = ("prusa-slicer",)


def installed(names: Sequence[str]) -> str | None:
    """Path of the first of these programs that there is."""
    return next((path for path in map(shutil.which, names) if path), None)
