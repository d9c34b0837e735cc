"""The list for the assembler: every deviation as a row of a CSV."""

from __future__ import annotations

from collections.abc import Sequence

from tactape_fab.sense.inspect.result import Inspection

HEADER = "Tape,Designator,Deviation,Mid X,Mid Y,Shift X,Shift Y,Turn,Value,Limit,Unit"


def complaint_csv(inspections: Sequence[Inspection]) -> str:
    """Rows of all tapes: nominal places and shifts in mm (board frame), turns in degrees counter-clockwise."""
    lines = [HEADER]
    for inspection in inspections:
        number = {name: i for i, name in enumerate(inspection.tape.designators())}
        for d in inspection.deviations():
            i = number.get(d.designator)
            measured = ["", "", ""]
            if i is not None and inspection.present[i]:
                dx, dy = inspection.shift_mm[i]
                measured = [f"{dx:.4f}", f"{dy:.4f}", f"{inspection.turn_deg[i]:.2f}"]
            value = "" if d.value is None else f"{d.value:.4f}"
            limit = "" if d.limit is None else f"{d.limit:g}"
            cells = [inspection.tape.name, d.designator, d.kind, f"{d.at_mm[0]:.4f}", f"{d.at_mm[1]:.4f}", *measured]
            lines.append(",".join([*cells, value, limit, d.unit]))
    return "\n".join(lines) + "\n"
