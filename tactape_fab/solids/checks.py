"""Checks of tape and form before any solid model is built."""

from __future__ import annotations

from collections.abc import Iterator
from math import asin, ceil, pi

import numpy as np

from tactape_fab.base.errors import Problem, refuse
from tactape_fab.base.fields import Fields
from tactape_fab.base.given_value import refuse_other
from tactape_fab.solids.elements import mean_radius_mm, reach_mm
from tactape_fab.solids.forms import Cylinder, SolidForm, read_form
from tactape_fab.solids.rise import foot_radius_mm, meets_cylinder
from tactape_fab.texture.board import Board
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import inset_mm
from tactape_fab.texture.tape import Tape

LEAST_CLEARANCE_MM = 0.002
"""Least distance of an element from the border of its cell, so that readers do not merge faces or edges."""
_TOLERANCE_MM = 0.0005
"""A clearance half a micrometre below the limit is accepted, as for limits of fabs."""
LEAST_SLIT_MM = 0.1
"""Least gap between the ends of a base that is not closed."""
LEAST_EDGE_MM = 0.01
"""Least distance of a foot from the base's edge."""
LEAST_TURN_DEG = 0.5
"""Least angle of a block's sides on a cylinder to its axis and to its circumference, if they are not parallel to one of them."""


def refuse_no_form(form: object) -> None:
    """Refuse a form with invalid values, which the constructor does not check. Raises SpecError."""
    refuse_other(form, SolidForm, "form", "SolidForm", "SolidForm(base_mm=0.8), or leave it out")
    assert isinstance(form, SolidForm)
    refuse_other(form.cylinder, (Cylinder, type(None)), "cylinder", "Cylinder", "Cylinder(radius_mm=R), or leave it out")
    table = Fields({**form.to_mapping(), "mark": form.mark})
    read_form(table)
    refuse(table.problems)


def form_problems(tape: Tape, form: SolidForm) -> list[Problem]:
    """Reasons why the solid models of a tape cannot be built in this form, each with its remedy."""
    problems = list(_cell_problems(tape, form))
    if form.cylinder is not None:
        problems += _cylinder_problems(tape, form, form.cylinder)
    return [*(problems or _edge_problems(tape, form)), *hole_problems(tape.board)]


def hole_problems(board: Board) -> list[Problem]:
    """Problems of holes that overlap or extend beyond the outline, each with its remedy."""
    holes = np.array(board.holes).reshape(-1, 3)
    words = ["--hole " + ",".join(f"{value:.10g}" for value in hole) for hole in board.holes]
    out = inset_mm(holes[:, :2], board.size_mm, board.corner_radius_mm) - holes[:, 2] / 2 < _TOLERANCE_MM
    problems = [
        Problem("holes_mm", f"holes_mm: {words[i]} reaches beyond the outline, as in no model; move it inward, or leave it out")
        for i in np.flatnonzero(out).tolist()
    ]
    for i, (x, y, diameter) in enumerate(board.holes):
        gaps = np.hypot(holes[:i, 0] - x, holes[:i, 1] - y) - (holes[:i, 2] + diameter) / 2
        if (gaps < _TOLERANCE_MM).any():
            other = words[int(gaps.argmin())]
            problems.append(Problem("holes_mm", f"holes_mm: {words[i]} overlaps {other}, as in no model; leave one of them out"))
    return problems


def _cell_problems(tape: Tape, form: SolidForm) -> Iterator[Problem]:
    """Check that every element lies in its cell, on a plane and round the form's cylinder."""
    # the displacement bounds the shift along each axis, also of diagonal directions
    flat_mm = max(reach_mm(tape.part)) + tape.displacement_mm
    foot_mm = float(foot_reach_mm(tape, form).max()) + tape.displacement_mm if _has_feet(tape, form) else flat_mm
    most_mm, worst_mm = tape.pitch_mm / 2 - LEAST_CLEARANCE_MM, max(flat_mm, foot_mm)
    if worst_mm <= most_mm + _TOLERANCE_MM:
        return
    # first rounded to a nanometre, as a float slightly above a whole micrometre would be rounded up to the next
    least_mm = ceil(round(2 * (worst_mm + LEAST_CLEARANCE_MM) * 1000, 3)) / 1000
    wider = f"use --w {least_mm:g} --delta {tape.displacement_mm:g}"
    if flat_mm > most_mm + _TOLERANCE_MM:
        yield Problem(
            "part",
            f"part = '{tape.part.name}' is larger than its cell: displaced by {tape.displacement_mm:g} mm it reaches "
            f"{flat_mm:.3f} mm from its grid point, more than {most_mm:.3f} mm, half the pitch {tape.pitch_mm:g} mm less a "
            f"clearance; {wider}, or a smaller element",
        )
    elif form.cylinder is not None:
        yield Problem(
            "cylinder_mm",
            f"cylinder_mm = {form.cylinder.radius_mm:g} mm: an element leaves its cell where the surface falls away under it: it "
            f"reaches {foot_mm:.3f} mm from its grid point, more than {most_mm:.3f} mm; {wider}, or a larger --cylinder",
        )


def _has_feet(tape: Tape, form: SolidForm) -> bool:
    """Whether the form's cylinder is wide enough for an element to stand on it."""
    cylinder = form.cylinder
    if cylinder is None or cylinder.radius_mm < _least_radius_mm(tape, form):
        return False
    return tape.part.shape != "dome" or meets_cylinder(tape.part, cylinder.radius_mm)


def _least_radius_mm(tape: Tape, form: SolidForm) -> float:
    """Least radius on which elements and base can stand."""
    # a radius of at least twice the reach keeps the surface below a foot within 30 deg of its tangent plane: t / R <= 1 / 2
    return max(2 * _reach_across_mm(tape), 0.0 if form.negative else form.base_mm + 0.1)


def _reach_across_mm(tape: Tape) -> float:
    return max(reach_mm(tape.part)) if tape.part.shape == "block" else mean_radius_mm(tape.part)


def foot_reach_mm(tape: Tape, form: SolidForm) -> FloatArray:
    """Largest |x| and |y| of an element's foot on its surface, board axes; on a cylinder along the arc. Shape (2,)."""
    reach = np.array(reach_mm(tape.part))
    cylinder = form.cylinder
    if cylinder is None:
        return reach
    axis = 0 if cylinder.around == "x" else 1
    if tape.part.shape == "dome":
        # directions 0 and 90 deg: the foot extends farthest along the tangent; along the axis it is that on a plane
        reach[axis], reach[1 - axis] = foot_radius_mm(tape.part, cylinder.radius_mm, np.array([0.0, pi / 2]))
    # from the offset along the tangent to the arc below it, in which base and cells are measured
    reach[axis] = cylinder.radius_mm * asin(min(reach[axis] / cylinder.radius_mm, 1.0))
    return reach


def _edge_problems(tape: Tape, form: SolidForm) -> Iterator[Problem]:
    """Check that all feet are on the base."""
    xy, reach = tape.part_xy_mm(), foot_reach_mm(tape, form)
    gap_mm = float(np.minimum(xy - reach, np.array(tape.board.size_mm) - xy - reach).min(initial=np.inf))
    if gap_mm < LEAST_EDGE_MM:
        yield Problem(
            "size_mm",
            f"size_mm = {tape.board.size_mm[0]:g} x {tape.board.size_mm[1]:g} mm: an element comes within {gap_mm:.3f} mm of the "
            f"edge, less than {LEAST_EDGE_MM:g} mm; use a larger --size or a profile with a larger distance to the edge",
        )


def _cylinder_problems(tape: Tape, form: SolidForm, cylinder: Cylinder) -> Iterator[Problem]:
    radius_mm, least_mm = cylinder.radius_mm, _least_radius_mm(tape, form)
    shown = f"cylinder_mm = {radius_mm:g} mm"
    if radius_mm < least_mm:
        yield Problem(
            "cylinder_mm",
            f"{shown} is below {least_mm:.2f} mm, what an element of reach {_reach_across_mm(tape):.2f} mm on a base of "
            f"{form.base_mm:g} mm needs; use a larger --cylinder or a thinner --base",
        )
        return
    length_mm = tape.board.size_mm[0 if cylinder.around == "x" else 1]  # which becomes arc length
    longest_mm = cylinder.circumference_mm - (LEAST_SLIT_MM if cylinder.shell == "segment" else 0.0)
    if length_mm > cylinder.circumference_mm:
        yield Problem(
            "cylinder_mm",
            f"{shown}: the tape would overlap itself: {length_mm:g} mm along {cylinder.around} exceed the circumference; the "
            f"largest length that fits is {np.floor(longest_mm * 1000) / 1000:.3f} mm; use a smaller --size or a larger "
            "--cylinder",
        )
    else:
        yield from _seam_problems(cylinder, shown, length_mm)
    if tape.board.holes:
        yield Problem("holes_mm", "holes_mm: a wrapped texture has no holes; leave out --hole, or --cylinder")
    if tape.part.shape == "block":
        # the plane of a side at an angle to the axis cuts an ellipse with the semi-axis R / sin(angle): 115 R at half a degree
        turn = (tape.part.rotation_deg + 45.0) % 90.0 - 45.0
        if 1e-9 < abs(turn) < LEAST_TURN_DEG:
            yield Problem(
                "rotation_deg",
                f"rotation_deg = {tape.part.rotation_deg:g} deg is less than {LEAST_TURN_DEG:g} deg from the cylinder's axis: "
                "the block's edges would be ellipses of extreme length; use a multiple of 90 or more turn",
            )
    if tape.part.shape == "dome" and not meets_cylinder(tape.part, radius_mm):
        yield Problem(
            "cylinder_mm",
            f"{shown} is too small for part '{tape.part.name}': the surface falls away under its foot further than its sides "
            "reach; use a larger --cylinder, or a narrower or flatter element",
        )


def _seam_problems(cylinder: Cylinder, shown: str, length_mm: float) -> Iterator[Problem]:
    """Check the slit of a segment that nearly closes on itself."""
    gap_mm = cylinder.circumference_mm - length_mm
    if cylinder.shell == "segment" and gap_mm < LEAST_SLIT_MM:
        yield Problem(
            "shell",
            f"{shown}: a segment of {length_mm:g} mm leaves a slit of {gap_mm:.3f} mm; use --shell whole, or a smaller --size",
        )
