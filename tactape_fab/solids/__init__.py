"""Solid models of a tape for CAD scripts, as build123d objects.

Importing a name imports no CAD kernel; calling `texture_part` or `assembly` imports build123d, which takes a second or two.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactape_fab.base.lazy import lazy_names

if TYPE_CHECKING:
    from tactape_fab.solids.cad import assembly as assembly
    from tactape_fab.solids.cad import texture_part as texture_part
    from tactape_fab.solids.forms import Cylinder as Cylinder
    from tactape_fab.solids.forms import SolidForm as SolidForm

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "solids.cad": "assembly texture_part",
        "solids.forms": "Cylinder SolidForm",
    },
)
