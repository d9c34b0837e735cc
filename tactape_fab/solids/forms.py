"""SolidForm: options of the solid models other than the tape: base, mould, tiling, cylinder."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any, Literal

from tactape_fab.base.fields import Fields

Axis = Literal["x", "y"]
Shell = Literal["segment", "whole"]
Top = Literal["tiles", "single"]

AXES = ("x", "y")
SHELLS = ("segment", "whole")
TOPS = ("tiles", "single")
DEFAULT_BASE_MM = 0.8
"""Default base thickness of a texture: 16 layers of 0.05 mm, stiff enough for handling."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder:
    """A cylinder that the texture is wrapped around, texture outside.

    Attributes
    ----------
    radius_mm : float
        At z = 0, the top of the base.
    around : {"x", "y"}
        The board axis that becomes arc length; the cylinder's axis is parallel to the other one.
    shell : {"segment", "whole"}
        A base as long as the board, or a closed ring.
    """

    radius_mm: float
    around: Axis = "x"
    shell: Shell = "segment"

    @property
    def circumference_mm(self) -> float:
        """Arc length of a whole turn at z = 0, mm."""
        return 2 * pi * self.radius_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class SolidForm:
    """Form of a tape's solid models: base, mould or relief, flat or wrapped round a cylinder.

    Attributes
    ----------
    base_mm : float
        Thickness of the base below z = 0; for a mould, the thickness below its deepest cavity.
    negative : bool
        Whether to make the mould instead of the texture: its complement, turned 180 degrees about board y, cavities up.
    top : {"tiles", "single"}
        Whether the top face of the STEP solid is cut into coplanar tiles (opens much faster) or is one face.
    cylinder : Cylinder or None
    mark : bool
        Whether the sector's number and an arrow to board +y are engraved in the back; see `mark`.
    """

    base_mm: float = DEFAULT_BASE_MM
    negative: bool = False
    top: Top = "tiles"
    cylinder: Cylinder | None = None
    mark: bool = False

    def to_mapping(self) -> dict[str, Any]:
        """The form as the manifest records it."""
        cylinder = self.cylinder
        return {
            "base_mm": self.base_mm,
            "negative": self.negative,
            "top": self.top,
            "cylinder": None
            if cylinder is None
            else {"radius_mm": cylinder.radius_mm, "around": cylinder.around, "shell": cylinder.shell},
            **({"mark": True} if self.mark else {}),
        }


def read_form(table: Fields) -> SolidForm:
    """A form out of a manifest's ``solid`` table; problems are collected in `table`."""
    cylinder = None
    if table.values.get("cylinder") is not None:
        rows = table.table("cylinder", ("radius_mm", "around", "shell"))
        cylinder = Cylinder(
            radius_mm=rows.number("radius_mm", above=0.0, high=100_000.0, default=1.0),
            around="y" if rows.text("around", choices=AXES) == "y" else "x",
            shell="whole" if rows.text("shell", choices=SHELLS) == "whole" else "segment",
        )
    return SolidForm(
        base_mm=table.number("base_mm", above=0.0, high=1000.0, default=DEFAULT_BASE_MM),
        negative=table.flag("negative"),
        top="single" if table.text("top", choices=TOPS) == "single" else "tiles",
        cylinder=cylinder,
        mark="mark" in table.values and table.flag("mark"),
    )
