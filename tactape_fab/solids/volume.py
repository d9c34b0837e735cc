"""Volume of a tape's solid, by formulas."""

from __future__ import annotations

from math import pi

from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mark import mark_volume_mm3
from tactape_fab.solids.rise import wrapped_volume_mm3
from tactape_fab.texture.tape import Tape


def solid_volume_mm3(tape: Tape, form: SolidForm) -> float:
    """Volume of a tape's solid, mm^3, computed by formulas independent of any file."""
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    cylinder, height_mm, sunk = form.cylinder, tape.part.body_mm[2], mark_volume_mm3(tape, form)
    if cylinder is None:
        # each of the four rounded corners cuts off r^2 - pi r^2 / 4
        area_mm2 = w * h - (4 - pi) * r**2 - sum(pi / 4 * d**2 for _, _, d in tape.board.holes)
        elements = tape.part_count * element_volume_mm3(tape.part)
        flat = area_mm2 * (height_mm + form.base_mm) - elements if form.negative else area_mm2 * form.base_mm + elements
        return flat - sunk
    around_x = cylinder.around == "x"
    length_mm, across_mm = (w, h) if around_x else (h, w)
    angle_rad = 2 * pi if cylinder.shell == "whole" else length_mm / cylinder.radius_mm
    back_mm = cylinder.radius_mm + (height_mm + form.base_mm if form.negative else -form.base_mm)
    # a sector of a ring has the area |R1^2 - R2^2| / 2 per radian; a mould's back is outside z = 0, a texture's inside
    shell = abs(cylinder.radius_mm**2 - back_mm**2) / 2 * angle_rad * across_mm
    rotation_deg = tape.part.rotation_deg - (0.0 if around_x else 90.0)
    elements = tape.part_count * wrapped_volume_mm3(tape.part, cylinder.radius_mm, rotation_deg)
    return shell - elements - sunk if form.negative else shell + elements - sunk
