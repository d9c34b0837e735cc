"""Pick-and-place (CPL) and bill of materials (BOM) as CSV, with the columns of each assembly house."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.layout import Layout
from tactape_fab.profiles import FabProfile, PartProfile

DESIGNATORS_PER_ROW = 200
"""JLCPCB's limit for one BOM row; nobody is known to take fewer."""

CPL_COLUMNS = ("Designator", "Mid X", "Mid Y", "Layer", "Rotation")
"""The columns that every house named here takes, in JLCPCB's order."""

_BomRow = Callable[[str, int, PartProfile], Sequence[object]]

BOM_FORMATS: dict[str, tuple[tuple[str, ...], _BomRow]] = {
    "generic": (
        ("Designator", "Quantity", "Value", "Footprint", "Description"),
        lambda refs, count, part: (refs, count, part.value, part.footprint, part.description),
    ),
    "jlcpcb": (
        ("Comment", "Designator", "Footprint", "JLCPCB Part #"),
        lambda refs, count, part: (part.value, refs, part.footprint, ""),
    ),
}
"""Columns of a BOM, and the row of a group of designators."""


def _csv(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue().encode("ascii")


def render_cpl(layout: Layout, fab: FabProfile) -> tuple[Artifact]:
    """Centre, side and rotation of every part: board frame, mm with four decimals, degrees counter-clockwise."""
    rotation = f"{layout.tape.part.rotation_deg:.4f}".rstrip("0").rstrip(".")
    x, y = layout.parts_xy_mm.T.tolist()
    rows = (
        (name, f"{x_mm:.4f}", f"{y_mm:.4f}", "Top", rotation)
        for name, x_mm, y_mm in zip(layout.tape.designators(), x, y, strict=True)
    )
    return (Artifact(role="cpl", path=f"assembly/{layout.tape.name}-cpl.csv", data=_csv(CPL_COLUMNS, rows)),)


def render_bom(layout: Layout, fab: FabProfile) -> tuple[Artifact]:
    """All parts, at most 200 designators a row."""
    columns, row = BOM_FORMATS[fab.assembly]
    names = layout.tape.designators()
    groups = (names[i : i + DESIGNATORS_PER_ROW] for i in range(0, len(names), DESIGNATORS_PER_ROW))
    rows = (row(",".join(group), len(group), layout.part) for group in groups)
    return (Artifact(role="bom", path=f"assembly/{layout.tape.name}-bom.csv", data=_csv(columns, rows)),)
