"""What each assembly house wants of the pick-and-place list (CPL) and the bill of materials (BOM).

The one place that names their columns, units, words and conventions. A column is a pair: its header, and what stands in it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from tactape_fab.base.fields import Fields, shown

Style = Literal["csv", "tab", "kicad"]
Columns = tuple[tuple[str, str], ...]

PART_NUMBER_PATTERN = r"[A-Za-z0-9](?:[A-Za-z0-9 ._()/#+-]{0,78}[A-Za-z0-9.)#+-])?"
PART_NUMBER_REMEDY = "use 1 to 80 letters, digits, spaces and ._()/#+-, the first a letter or digit; it is one cell of a table"
MM_PER_MIL = 0.0254


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementTable:
    """A pick-and-place list.

    Attributes
    ----------
    columns : tuple of (str, str)
        What may stand in one: ``designator``, ``x``, ``y``, ``rotation``, ``side``, ``value``, ``footprint``,
        ``part_number``, ``length`` and ``width`` (of the unturned lands), or a key of ``fixed``.
    ending : str
        What follows the tape's name in the file's.
    style : {"csv", "tab", "kicad"}
        Commas, tabs with the header as a comment, or aligned as KiCad does it.
    unit : {"mm", "mil"}
        Of coordinates and lengths.
    side : str
        The house's word for the top side.
    clockwise : bool
        Rotations grow clockwise instead of counter-clockwise; both seen from above, 0 is the long axis along board x.
    half_turns : bool
        Rotations lie in (-180, 180] instead of [0, 360).
    fixed : tuple of (str, str)
        Cells that are the same for every part of every tape.
    """

    columns: Columns
    ending: str = "-cpl.csv"
    style: Style = "csv"
    unit: Literal["mm", "mil"] = "mm"
    side: str = "Top"
    clockwise: bool = False
    half_turns: bool = False
    fixed: Columns = ()

    @property
    def headers(self) -> tuple[str, ...]:
        return tuple(header for header, _ in self.columns)

    @property
    def unit_mm(self) -> float:
        """Millimetres in one of the list's units."""
        return MM_PER_MIL if self.unit == "mil" else 1.0

    def written_deg(self, rotation_deg: float) -> float:
        """A rotation, counter-clockwise in degrees, as this list has it."""
        turned = round((-rotation_deg if self.clockwise else rotation_deg) % 360.0, 4) % 360.0
        return turned - 360.0 if self.half_turns and turned > 180.0 else turned


@dataclass(frozen=True, slots=True, kw_only=True)
class BomTable:
    """A bill of materials: one row for a group of designators.

    In a column may stand ``item`` (the row's number), ``designator``, ``quantity``, ``value``, ``footprint``,
    ``description``, ``value_description``, ``part_number``, or a key of ``fixed``.
    """

    columns: Columns
    fixed: Columns = ()

    @property
    def headers(self) -> tuple[str, ...]:
        return tuple(header for header, _ in self.columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class AssemblyFormat:
    """Both lists of a house, and what its part numbers look like: a pattern and the words for it."""

    placements: PlacementTable
    bom: BomTable
    number_pattern: str = PART_NUMBER_PATTERN
    number_words: str = PART_NUMBER_REMEDY


_COMMON = PlacementTable(
    columns=(("Designator", "designator"), ("Mid X", "x"), ("Mid Y", "y"), ("Layer", "side"), ("Rotation", "rotation"))
)
_GENERIC_BOM = BomTable(
    columns=(
        ("Designator", "designator"),
        ("Quantity", "quantity"),
        ("Value", "value"),
        ("Footprint", "footprint"),
        ("Description", "description"),
        ("Part Number", "part_number"),
    )
)

FORMATS: Mapping[str, AssemblyFormat] = {
    "generic": AssemblyFormat(placements=_COMMON, bom=_GENERIC_BOM),
    # JLCPCB help pages 46 (CPL) and "advice for BOM and CPL files" (2026-01-19); KiKit writes the same.
    "jlcpcb": AssemblyFormat(
        placements=_COMMON,
        bom=BomTable(
            columns=(
                ("Comment", "value"),
                ("Designator", "designator"),
                ("Footprint", "footprint"),
                ("JLCPCB Part #", "part_number"),
            )
        ),
        number_pattern=r"C[0-9]{1,10}",
        number_words="JLCPCB takes its own (LCSC) numbers, a C and up to 10 digits; look the part up in its library",
    ),
    # KiKit (kikit/fab/pcbway.py); quantities are those of one board.
    "pcbway": AssemblyFormat(
        placements=_COMMON,
        bom=BomTable(
            columns=(
                ("Item #", "item"),
                ("Designator", "designator"),
                ("Qty", "quantity"),
                ("Manufacturer", "manufacturer"),
                ("Mfg Part #", "part_number"),
                ("Description / Value", "value_description"),
                ("Footprint", "footprint"),
                ("Type", "type"),
                ("Your Instructions / Notes", "notes"),
            ),
            fixed=(("manufacturer", ""), ("type", "SMD"), ("notes", "")),
        ),
    ),
    # Eurocircuits' upload pages: the first row names the columns, which are free; these are its own words for them.
    "eurocircuits": AssemblyFormat(
        placements=PlacementTable(
            columns=(
                ("Reference designator", "designator"),
                ("X (mm)", "x"),
                ("Y (mm)", "y"),
                ("Rotation", "rotation"),
                ("Side", "side"),
            )
        ),
        bom=BomTable(
            columns=(
                ("Reference designator", "designator"),
                ("Quantity", "quantity"),
                ("MPN", "part_number"),
                ("Value", "value"),
                ("Package", "footprint"),
                ("Description", "description"),
            )
        ),
    ),
    # MacroFab's help ("Managing Your PCB Bill of Materials") for columns, mils and the comment mark; its API pages ("Upload XYRS
    # File") for the origin and for clockwise rotation. The part's size is that of its lands, unturned.
    "macrofab": AssemblyFormat(
        placements=PlacementTable(
            columns=(
                ("Designator", "designator"),
                ("X-Loc", "x"),
                ("Y-Loc", "y"),
                ("Rotation", "rotation"),
                ("Side", "side"),
                ("Type", "type"),
                ("X-Size", "length"),
                ("Y-Size", "width"),
                ("Value", "value"),
                ("Footprint", "footprint"),
                ("Populate", "populate"),
                ("MPN", "part_number"),
            ),
            ending=".xyrs",
            style="tab",
            unit="mil",
            side="1",
            clockwise=True,
            fixed=(("type", "1"), ("populate", "1")),
        ),
        bom=_GENERIC_BOM,
    ),
    # Written line by line as pcbnew 6.0.11 does (PLACE_FILE_EXPORTER, text, mm, top side).
    "kicad": AssemblyFormat(
        placements=PlacementTable(
            columns=(
                ("Ref", "designator"),
                ("Val", "value"),
                ("Package", "footprint"),
                ("PosX", "x"),
                ("PosY", "y"),
                ("Rot", "rotation"),
                ("Side", "side"),
            ),
            ending="-top.pos",
            style="kicad",
            side="top",
            half_turns=True,
        ),
        bom=_GENERIC_BOM,
    ),
}

ASSEMBLY_FORMATS = tuple(FORMATS)


def part_number_problem(number: str, format_name: str) -> str | None:
    """Why a house cannot take a part number, with the remedy; None where it can."""
    house = FORMATS[format_name]
    if re.fullmatch(house.number_pattern, number):
        return None
    return f"part_number = {shown(number)} is none of assembly format '{format_name}'; {house.number_words}"


def read_part_numbers(table: Fields) -> dict[str, str]:
    """A part profile's ``[part_numbers]``: a number for each assembly format that has one; problems are collected."""
    if "part_numbers" not in table.values:
        return {}
    numbers = table.table("part_numbers", ASSEMBLY_FORMATS)
    return {
        name: numbers.text(name, pattern=FORMATS[name].number_pattern, remedy=FORMATS[name].number_words)
        for name in ASSEMBLY_FORMATS
        if name in numbers.values
    }
