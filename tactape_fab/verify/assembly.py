"""CPL and BOM against the manifest."""

from __future__ import annotations

from collections import Counter

import numpy as np

from tactape_fab.errors import Check
from tactape_fab.kit.readback import CplContent, ReadbackError, read_csv
from tactape_fab.kit.render.assembly import CPL_COLUMNS, DESIGNATORS_PER_ROW
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import named
from tactape_fab.verify.lands import PLACE_TOLERANCE_MM, ROTATION_TOLERANCE_DEG


def check_cpl(data: bytes, cpl: CplContent, tape: Tape) -> list[Check]:
    """One row per part in order, each at its place on the grid, all on top and turned as the manifest says."""
    expected = tape.designators()
    problems = []
    header = data.decode("utf-8-sig", errors="replace").splitlines()[0].split(",")
    if tuple(header) != CPL_COLUMNS:
        problems.append(f"its columns are {','.join(header)}")
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
    message = "; ".join(problems) or f"{len(expected)} rows, R1 to R{len(expected)} in order"
    rows = Check(name="cpl rows", passed=not problems, message=message, figure=float(len(cpl.designators)))
    return [rows, _check_places(cpl, tape), _check_rotation(cpl, tape)]


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
    turn = np.abs((cpl.rotation_deg - tape.part.rotation_deg + 180.0) % 360.0 - 180.0)
    wrong = np.flatnonzero(turn > ROTATION_TOLERANCE_DEG)
    message = (
        f"{len(wrong)} parts are turned: {named([f'{cpl.designators[i]} at {cpl.rotation_deg[i]:g} deg' for i in wrong])}"
        f", the manifest says {tape.part.rotation_deg:g} deg"
        if len(wrong)
        else f"all at {tape.part.rotation_deg:g} deg"
    )
    return Check(name="cpl rotation", passed=not len(wrong), message=message, figure=float(turn.max(initial=0.0)), unit="deg")


def check_bom(data: bytes, tape: Tape) -> Check:
    """Every part in exactly one row, at most 200 a row, quantities right where the columns have them."""
    try:
        rows = read_csv(data)
        groups = [row["Designator"].split(",") for row in rows]
        quantities = [int(row["Quantity"]) for row in rows if "Quantity" in row]
    except (ReadbackError, KeyError, ValueError) as error:
        return Check(name="bom", passed=False, message=f"it cannot be read: {error}")
    found = [name for group in groups for name in group]
    expected = tape.designators()
    known, seen = set(expected), set(found)
    problems = []
    for what, items in (
        ("misses", [d for d in expected if d not in seen]),
        ("has unknown", [d for d in found if d not in known]),
    ):
        if items:
            problems.append(f"it {what} {named(items)}")
    if len(seen) < len(found):
        problems.append(f"it repeats {named([d for d, times in Counter(found).items() if times > 1])}")
    longest = max(map(len, groups), default=0)
    if longest > DESIGNATORS_PER_ROW:
        problems.append(f"a row has {longest} designators, more than {DESIGNATORS_PER_ROW}")
    if quantities and quantities != [len(group) for group in groups]:
        problems.append("a quantity differs from its row's designators")
    message = "; ".join(problems) or f"{len(found)} designators in {len(groups)} rows, each once"
    return Check(name="bom", passed=not problems, message=message, figure=float(len(found)))
