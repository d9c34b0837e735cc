"""Checks of a panel outside its tapes: outline and slots, fiducials, tooling holes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named
from tactape_fab.kit.panel.geometry import Panel
from tactape_fab.kit.panel.panel_drawing import slots_mm
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.verify.layers.board import stroke_problem
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM, outlines_apart_mm
from tactape_fab.verify.layers.on_panel import OnPanel, inside, whole

_DIAMETER_TOLERANCE_MM = 0.005


def check_cut(content: GerberContent, panel: Panel) -> Check:
    """Check the outline, and that the slots around every tape do not cut into it and leave exactly its tabs."""
    name, strokes = "profile", content.strokes_mm
    expected = slots_mm(panel)
    open_ended = [stroke for stroke in strokes if len(stroke) < 4 or np.hypot(*(stroke[0] - stroke[-1])) > 1e-9]
    if len(content.flash_xy_mm) or len(content.areas_mm) or open_ended:
        return Check(name=name, passed=False, message="objects that are not closed contours")
    if len(strokes) != 1 + len(expected):
        return Check(name=name, passed=False, message=f"{len(strokes)} contours instead of {1 + len(expected)}")
    if (pen := stroke_problem(content)) is not None:
        return Check(name=name, passed=False, message=pen)
    drawn = [shapely.Polygon(stroke) for stroke in strokes]
    if not all(polygon.is_valid for polygon in drawn):
        return Check(name=name, passed=False, message="a contour crosses itself")
    outline = shapely.Polygon(panel.outline_mm)
    wanted = [outline, *map(shapely.Polygon, expected)]
    errors = [outlines_apart_mm(polygon, contour) for polygon, contour in zip(drawn, wanted, strict=True)]
    # the effect of the slots is checked: whether a tape stays whole, and how many pieces of its outline stay uncut
    slots, tapes = shapely.union_all(drawn[1:]), [shapely.Polygon(place.outline_mm) for place in panel.places]
    problems = [
        f"a slot cuts {shapely.area(shapely.intersection(slots, t)):.3f} mm2 off a tape" for t in tapes if _cuts(slots, t)
    ]
    # slots touch a tape along its outline; slightly widened they cover the outline except at the tabs
    near, tabs = slots.buffer(2 * PLACE_TOLERANCE_MM), [2 * (place.tabs_x + place.tabs_y) for place in panel.places]
    # merged, as a tab over the start point of the ring would be two pieces
    uncut = [shapely.get_parts(shapely.line_merge(shapely.difference(tape.exterior, near))) for tape in tapes]
    wrong = [(len(pieces), count) for pieces, count in zip(uncut, tabs, strict=True) if len(pieces) != count]
    problems += [f"a tape is held by {held} tabs, not {count}" for held, count in wrong]
    counts = " or ".join(str(count) for count in sorted(set(tabs)))
    if max(errors) > PLACE_TOLERANCE_MM:
        problems.append(f"a contour is {max(errors):.3f} mm off the manifest's panel")
    size = panel.size_mm
    right = f"{size[0]:g} x {size[1]:g} mm with {len(expected)} slots, every tape whole and held by {counts} tabs"
    return Check(name=name, passed=not problems, message=named(problems) or right, figure=max(errors) * 1000, unit="um")


def _cuts(slots: Any, tape: Any) -> bool:
    # the tape is shrunk by the tolerance, as a slot may touch it
    return float(shapely.area(shapely.intersection(slots, tape.buffer(-PLACE_TOLERANCE_MM)))) > 0.0


def check_rails(
    gerbers: Mapping[str, GerberContent], holes: FloatArray | None, panel: Panel, tapes: Sequence[OnPanel]
) -> list[Check]:
    """Check that outside the tapes there are only the fiducials and the tooling holes."""
    checks = [_check_marks(role, content, panel, tapes) for role, content in gerbers.items() if role != "profile"]
    return checks if holes is None else [*checks, _check_tooling(holes, panel, tapes)]


def _on_tapes(xy_mm: FloatArray, tapes: Sequence[OnPanel]) -> BoolArray:
    """Mask of the points on any tape; shape (n,)."""
    found = np.zeros(len(xy_mm), dtype=bool)
    for on in tapes:
        found |= inside(xy_mm, on)
    return found


def _check_marks(role: str, content: GerberContent, panel: Panel, tapes: Sequence[OnPanel]) -> Check:
    marks = {"copper-top": panel.fiducial_mm, "coverlay-top": panel.fiducial_opening_mm}
    # objects on a tape are checked with that tape; one on two tapes, or partly on one, counts as outside
    flashes = np.flatnonzero(~_on_tapes(content.flash_xy_mm, tapes))
    outlines = [content.aperture_outlines_mm[i] for i in content.flash_aperture[flashes]]
    wanted = np.array(panel.fiducials_mm if role in marks else ()).reshape(-1, 2)
    problems = _mark_problems(content.flash_xy_mm[flashes], outlines, wanted, marks.get(role, 0.0))
    for kind, shapes in (("areas", content.areas_mm), ("lines", content.strokes_mm)):
        strange = len(shapes) - sum(len(whole(shapes, on)) for on in tapes)
        if strange:
            problems.append(f"{strange} {kind} lie beside the tapes")
    message = "; ".join(problems) or (f"{len(wanted)} fiducials" if role in marks else "nothing beside the tapes")
    return Check(name=f"{role} of the rails", passed=not problems, message=message, figure=float(len(flashes)))


def _check_tooling(holes: FloatArray, panel: Panel, tapes: Sequence[OnPanel]) -> Check:
    found = np.array(sorted(holes[~_on_tapes(holes[:, :2], tapes)].tolist())).reshape(-1, 3)
    expected = np.array(sorted(panel.tooling_holes_mm)).reshape(-1, 3)
    passed = found.shape == expected.shape and bool(np.allclose(found, expected, rtol=0.0, atol=PLACE_TOLERANCE_MM))
    message = f"{len(found)} tooling holes" + ("" if passed else f", not the {len(expected)} of the manifest at their places")
    return Check(name="drill-npth of the rails", passed=passed, message=message, figure=float(len(found)))


def _mark_problems(xy_mm: FloatArray, outlines: Sequence[FloatArray], wanted_mm: FloatArray, diameter_mm: float) -> list[str]:
    if len(xy_mm) != len(wanted_mm):
        where = "" if len(xy_mm) <= len(wanted_mm) else f", one of them at ({xy_mm[-1, 0]:.3f}, {xy_mm[-1, 1]:.3f}) mm"
        return [f"{len(xy_mm)} flashes beside the tapes instead of {len(wanted_mm)} fiducials{where}"]
    problems = []
    if len(xy_mm) and np.abs(xy_mm - wanted_mm).max() > PLACE_TOLERANCE_MM:
        i = int(np.argmax(np.abs(xy_mm - wanted_mm).max(axis=1)))
        problems.append(
            f"a fiducial is at ({xy_mm[i, 0]:.3f}, {xy_mm[i, 1]:.3f}) mm, not at ({wanted_mm[i, 0]:g}, {wanted_mm[i, 1]:g}) mm"
        )
    # all vertices of a disc are a radius from its centre; 5 um for the chords of readers
    radii = [np.hypot(*outline.T) for outline in outlines]
    disc = shapely.Point(0.0, 0.0).buffer(diameter_mm / 2, quad_segs=32)
    # a square also has its vertices on a circle
    if any(np.abs(2 * r - diameter_mm).max() > _DIAMETER_TOLERANCE_MM for r in radii) or any(
        outlines_apart_mm(shapely.Polygon(outline), disc) > _DIAMETER_TOLERANCE_MM for outline in outlines
    ):
        problems.append(f"a fiducial is no disc of {diameter_mm:g} mm")
    return problems
