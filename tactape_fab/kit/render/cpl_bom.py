"""Pick-and-place (CPL) and bill of materials (BOM), with the columns and conventions of each assembly house."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat

from tactape_fab.base.build_date import build_date
from tactape_fab.base.number_rows import number_rows
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.profiles import FabProfile, PartProfile
from tactape_fab.kit.profiles.assembly import FORMATS
from tactape_fab.texture.cpl import PLACEMENTS, PlacementTable

DESIGNATORS_PER_ROW = 200
"""JLCPCB's limit for one BOM row; no known house has a lower one."""

# of the columns Ref, Val and Package
_KICAD_LEAST_WIDTHS = (8, 8, 16)


def _table(headers: Sequence[str], rows: Iterable[Sequence[object]], separator: str = ",", mark: str = "") -> bytes:
    text = io.StringIO(newline="")
    text.write(mark)
    writer = csv.writer(text, delimiter=separator, lineterminator="\r\n")
    writer.writerow(headers)
    writer.writerows(rows)
    return text.getvalue().encode("ascii")


def render_cpl(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Centre, side and rotation of every part, in the board frame.

    Four decimals of the house's unit: 0.1 um in mm, 2.5 nm in mil.
    """
    house = PLACEMENTS[fab.assembly]
    cells = _placement_cells(drawing, fab, house)
    # not strict, as columns that are equal for every part are endless iterators
    rows = zip(*(cells[content] for _, content in house.columns), strict=False)
    if house.style == "kicad":
        data = _kicad_text(house, rows)
    elif house.style == "tab":
        data = _table(house.headers, rows, "\t", "#")
    else:
        data = _table(house.headers, rows)
    return (Artifact(role="cpl", path=f"assembly/{drawing.name}{house.ending}", data=data),)


def _placement_cells(drawing: Drawing, fab: FabProfile, house: PlacementTable) -> Mapping[str, Iterable[str]]:
    """The cells of each column by its content; endless iterators if they are equal for every part."""
    part = drawing.part
    # formatted in numpy, then split at blanks: the list of 200,000 parts takes 0.18 s instead of 0.25
    x, y = (number_rows("%.4f ", column).decode("ascii").split() for column in (drawing.parts_xy_mm / house.unit_mm).T)
    length, width = (f"{value / house.unit_mm:.4f}" for value in part.lands_mm)
    of_tapes = [(_degrees(house.written_deg(parts.rotation_deg), house), len(parts.xy_mm)) for parts in drawing.parts]
    same = {**_part_cells(part, fab), "side": house.side, "length": length, "width": width, **dict(house.fixed)}
    return {
        "designator": drawing.designators(),
        "rotation": [text for text, count in of_tapes for _ in range(count)],
        "x": x,
        "y": y,
        **{content: repeat(text) for content, text in same.items()},
    }


def _degrees(rotation_deg: float, house: PlacementTable) -> str:
    text = f"{rotation_deg:.4f}"
    # pcbnew writes all numbers with the same number of decimals
    return text if house.style == "kicad" else text.rstrip("0").rstrip(".")


def _kicad_text(house: PlacementTable, rows: Iterable[Sequence[str]]) -> bytes:
    """Text as pcbnew writes it: columns as wide as their longest entry, without blanks inside entries."""
    table = [[cell.replace(" ", "_") for cell in row] for row in rows]
    ref, value, package = (max(least, *(len(row[i]) for row in table)) for i, least in enumerate(_KICAD_LEAST_WIDTHS))
    template = f"{{:<{ref}}}  {{:<{value}}}  {{:<{package}}}  {{:>9}}  {{:>9}}  {{:>8}}  {{}}"
    head = [
        f"### Footprint positions - created on {build_date():%a %b %d %H:%M:%S %Y} ###",
        f"### Printed by tactape-fab version {__version__}",
        "## Unit = mm, Angle = deg.",
        f"## Side : {house.side}",
        template.format("# " + house.headers[0], *house.headers[1:]),
    ]
    return "\n".join([*head, *(template.format(*row) for row in table), "## End", ""]).encode("ascii")


def render_bom(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Bill of materials of all parts, with at most `DESIGNATORS_PER_ROW` designators per row."""
    bom = FORMATS[fab.assembly].bom
    names = drawing.designators()
    groups = [names[i : i + DESIGNATORS_PER_ROW] for i in range(0, len(names), DESIGNATORS_PER_ROW)]
    same = {**_part_cells(drawing.part, fab), **dict(bom.fixed)}
    rows = [
        {**same, "item": str(number), "designator": ",".join(group), "quantity": str(len(group))}
        for number, group in enumerate(groups, start=1)
    ]
    data = _table(bom.headers, ([row[content] for _, content in bom.columns] for row in rows))
    return (Artifact(role="bom", path=f"assembly/{drawing.name}-bom.csv", data=data),)


def _part_cells(part: PartProfile, fab: FabProfile) -> dict[str, str]:
    return {
        "value": part.value,
        "footprint": part.footprint,
        "description": part.description,
        "value_description": f"{part.value}, {part.description}",
        "part_number": part.part_numbers.get(fab.assembly, ""),
    }
