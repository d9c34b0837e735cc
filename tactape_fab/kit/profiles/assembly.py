"""Assembly houses: columns of their bills of materials (BOM), and formats of their part numbers.

Their names and pick-and-place lists are in `texture.cpl`, as the robot's half reads the lists as well.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from tactape_fab.base.fields import Fields, shown
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS, Columns, Table

PART_NUMBER_PATTERN = r"[A-Za-z0-9](?:[A-Za-z0-9 ._()/#+-]{0,78}[A-Za-z0-9.)#+-])?"
PART_NUMBER_REMEDY = "use 1 to 80 letters, digits, spaces and ._()/#+-, the first a letter or digit; it is one cell of a table"


@dataclass(frozen=True, slots=True, kw_only=True)
class BomTable(Table):
    """A bill of materials: one row for a group of designators.

    A column may hold ``item`` (the row's number), ``designator``, ``quantity``, ``value``, ``footprint``,
    ``description``, ``value_description``, ``part_number``, or a key of ``fixed``.
    """

    fixed: Columns = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class AssemblyFormat:
    """A house's bill of materials, and the pattern of its part numbers with a description."""

    bom: BomTable
    number_pattern: str = PART_NUMBER_PATTERN
    number_words: str = PART_NUMBER_REMEDY


_GENERIC = AssemblyFormat(
    bom=BomTable(
        columns=(
            ("Designator", "designator"),
            ("Quantity", "quantity"),
            ("Value", "value"),
            ("Footprint", "footprint"),
            ("Description", "description"),
            ("Part Number", "part_number"),
        )
    )
)
_OWN: Mapping[str, AssemblyFormat] = {
    # JLCPCB help page "advice for BOM and CPL files" (2026-01-19); KiKit writes the same.
    "jlcpcb": AssemblyFormat(
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
    # Eurocircuits' upload pages: the first row names the columns, in any wording; these are its own names for them.
    "eurocircuits": AssemblyFormat(
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
}
FORMATS: Mapping[str, AssemblyFormat] = {name: _OWN.get(name, _GENERIC) for name in ASSEMBLY_FORMATS}


def part_number_problem(number: str, format_name: str) -> str | None:
    """Reason why a part number is invalid at a house, with the remedy; None if it is valid."""
    house = FORMATS[format_name]
    if re.fullmatch(house.number_pattern, number):
        return None
    return f"part_number = {shown(number)} is invalid in assembly format '{format_name}'; {house.number_words}"


def read_part_numbers(table: Fields) -> dict[str, str]:
    """Read a part profile's ``[part_numbers]``: a number for each assembly format that has one; problems are collected."""
    if "part_numbers" not in table.values:
        return {}
    numbers = table.table("part_numbers", ASSEMBLY_FORMATS)
    return {
        name: numbers.text(name, pattern=FORMATS[name].number_pattern, remedy=FORMATS[name].number_words)
        for name in ASSEMBLY_FORMATS
        if name in numbers.values
    }
