"""Checks of CPL and BOM against the manifest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields, named, shown
from tactape_fab.kit.profiles import LandPattern
from tactape_fab.kit.profiles.assembly import FORMATS
from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.kit.read.readback import read_bom
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS, PLACEMENTS, CplContent
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM, ROTATION_TOLERANCE_DEG

DESIGNATORS_PER_ROW = 200
"""Most designators that JLCPCB accepts in one row of a BOM."""
_MOST_NAMED = 8
_CELL = r"[A-Za-z0-9][A-Za-z0-9 ._()+/,:#-]{0,199}"
_CELL_REMEDY = "a cell begins with a letter or digit and holds no formula"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedAssembly:
    """The manifest's record of the assembly: format of the house, and the part's texts in CPL and BOM."""

    format: str
    value: str
    footprint: str
    description: str
    part_number: str


def read_assembly(table: Fields) -> RecordedAssembly:
    """Read the manifest's ``assembly``; problems are collected in `table`."""
    assembly = table.table("assembly")
    numbered = assembly.values.get("part_number") is not None
    return RecordedAssembly(
        format=assembly.text("format", choices=ASSEMBLY_FORMATS, default=ASSEMBLY_FORMATS[0]),
        value=assembly.text("value", pattern=_CELL, remedy=_CELL_REMEDY),
        footprint=assembly.text("footprint", pattern=_CELL, remedy=_CELL_REMEDY),
        description=assembly.text("description", pattern=_CELL, remedy=_CELL_REMEDY),
        part_number=assembly.text("part_number", pattern=_CELL, remedy=_CELL_REMEDY) if numbered else "",
    )


def check_cpl(cpl: CplContent, tape: Tape, recorded: RecordedAssembly, pads: LandPattern) -> list[Check]:
    """Check that the CPL has one row per part, in order, with place, top side, rotation and texts of the manifest."""
    expected = tape.designators()
    problems = []
    house = PLACEMENTS[recorded.format]
    if cpl.table != house:
        problems.append(f"it is no list of format '{recorded.format}': its columns are {','.join(cpl.table.headers)}")
    if list(cpl.designators) != expected:
        found, known = Counter(cpl.designators), set(expected)
        missing = [d for d in expected if d not in found]
        extra = [d for d in found if d not in known]
        twice = [d for d, times in found.items() if times > 1]
        for what, items in (("misses", missing), ("has unknown", extra), ("repeats", twice)):
            if items:
                problems.append(f"it {what} {named(items)}")
        if not problems:
            i = next(i for i, (a, b) in enumerate(zip(cpl.designators, expected, strict=True)) if a != b)
            problems.append(f"rows are out of order: row {i + 1} is {cpl.designators[i]}, not {expected[i]}")
    if any(side != "Top" for side in cpl.sides):
        problems.append(f"{sum(side != 'Top' for side in cpl.sides)} rows are not on layer Top")
    problems += _text_problems(cpl, recorded, pads)
    message = "; ".join(problems[:_MOST_NAMED]) or f"{len(expected)} rows, R1 to R{len(expected)} in order"
    rows = Check(name="cpl rows", passed=not problems, message=message, figure=float(len(cpl.designators)))
    return [rows, _check_places(cpl, tape), _check_rotation(cpl, tape)]


def _text_problems(cpl: CplContent, recorded: RecordedAssembly, pads: LandPattern) -> list[str]:
    """Problems of cells other than place and side that differ from the manifest."""
    # KiCad's position file is aligned by blanks, so that cells have none
    blank = "_" if cpl.table.style == "kicad" else " "
    # MacroFab's X-Size and Y-Size: the bounding box of both lands of an unrotated part
    lands_mm = {"length": 2 * pads.offset_mm + pads.size_mm[0], "width": pads.size_mm[1]}
    expected = {
        "value": recorded.value.replace(" ", blank),
        "footprint": recorded.footprint.replace(" ", blank),
        "part_number": recorded.part_number,
        **{content: f"{value_mm / cpl.table.unit_mm:.4f}" for content, value_mm in lands_mm.items()},
        **dict(cpl.table.fixed),
    }
    problems = []
    for content, cells in cpl.texts.items():
        wrong = [i for i, cell in enumerate(cells) if cell != expected[content]]
        if wrong:
            at = named([f"{cpl.designators[i]} {shown(cells[i])}" for i in wrong])
            problems.append(f"the {content} of {len(wrong)} rows is not {shown(expected[content])}: {at}")
    return problems


def _check_places(cpl: CplContent, tape: Tape) -> Check:
    place = {name: i for i, name in enumerate(tape.designators())}
    index = np.array([place.get(name, -1) for name in cpl.designators], dtype=np.int64)
    known = index >= 0
    if not known.any():
        return Check(name="cpl places", passed=False, message="no row names a part of this tape")
    error = np.hypot(*(cpl.xy_mm[known] - tape.part_xy_mm()[index[known]]).T)
    names = [name for name, keep in zip(cpl.designators, known, strict=True) if keep]
    far = np.flatnonzero(error > PLACE_TOLERANCE_MM)
    figure = float(error.max() * 1000)
    message = (
        f"{len(far)} rows are off the manifest's grid: {named([f'{names[i]} by {error[i] * 1000:.1f} um' for i in far])}"
        if len(far)
        else f"every row within {figure:.3f} um of the manifest's grid"
    )
    return Check(name="cpl places", passed=not len(far), message=message, figure=figure, unit="um")


def _check_rotation(cpl: CplContent, tape: Tape) -> Check:
    # absolute difference of two angles, 0 to 180 deg; half a turn is wrong, although a chip resistor is symmetric
    turn = np.abs((cpl.rotation_deg - tape.part.rotation_deg + 180.0) % 360.0 - 180.0)
    wrong = np.flatnonzero(turn > ROTATION_TOLERANCE_DEG)
    message = (
        f"{len(wrong)} parts are turned: {named([f'{cpl.designators[i]} at {cpl.rotation_deg[i]:g} deg' for i in wrong])}"
        f", the manifest says {tape.part.rotation_deg:g} deg"
        if len(wrong)
        else f"all at {tape.part.rotation_deg:g} deg"
    )
    return Check(name="cpl rotation", passed=not len(wrong), message=message, figure=float(turn.max(initial=0.0)), unit="deg")


def check_bom(data: bytes, expected: Sequence[str], recorded: RecordedAssembly) -> Check:
    """Check that every part is in exactly one BOM row, at most 200 per row, with the manifest's columns, quantities and texts."""
    bom = FORMATS[recorded.format].bom
    try:
        rows = read_bom(data, bom)
    except ReadbackError as error:
        return Check(name="bom", passed=False, message=f"it cannot be read: {error}")
    # ranges such as R1-R9 are not allowed, as houses count the items between commas
    groups = [row["designator"].split(",") for row in rows]
    found = [name for group in groups for name in group]
    known, seen = set(expected), set(found)
    problems = []
    missing, extra = [d for d in expected if d not in seen], [d for d in found if d not in known]
    for what, items in (("misses", missing), ("has unknown", extra)):
        if items:
            problems.append(f"it {what} {named(items)}")
    if len(seen) < len(found):
        problems.append(f"it repeats {named([d for d, times in Counter(found).items() if times > 1])}")
    longest = max(map(len, groups), default=0)
    if longest > DESIGNATORS_PER_ROW:
        problems.append(f"a row has {longest} designators, more than {DESIGNATORS_PER_ROW}")
    same = {
        "value": recorded.value,
        "footprint": recorded.footprint,
        "description": recorded.description,
        "value_description": f"{recorded.value}, {recorded.description}",
        "part_number": recorded.part_number,
        **dict(bom.fixed),
    }
    for number, (row, group) in enumerate(zip(rows, groups, strict=True), start=1):
        problems += _row_problems(number, row, {**same, "item": str(number), "quantity": str(len(group))})
    listed = f"{len(groups)} row{'s' * (len(groups) != 1)}"
    message = "; ".join(problems[:_MOST_NAMED]) or f"{len(found)} designators in {listed}, each once"
    return Check(name="bom", passed=not problems, message=message, figure=float(len(found)))


def _row_problems(number: int, row: Mapping[str, str], expected: Mapping[str, str]) -> list[str]:
    return [
        f"the {content} of row {number} is {shown(cell)}, not {shown(expected[content])}"
        for content, cell in row.items()
        if content != "designator" and cell != expected[content]
    ]
