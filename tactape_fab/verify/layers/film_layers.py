"""Checks of a film's optional features: anchors in the copper, one window for all parts, laminated backings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import shapely

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.kit.film.anchors import AnchorPlan, Anchors, build_anchors, nearest_foreign
from tactape_fab.kit.film.coverlay import gang_window
from tactape_fab.kit.profiles import COVERLAY_MODES, LandPattern, LegendSizes, material_words
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import inset_mm
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly
from tactape_fab.verify.layers.job_file import FabOrder
from tactape_fab.verify.layers.lands import Recorded, outlines_apart_mm
from tactape_fab.verify.layers.written_form import segments

TOLERANCE_MM = 0.001
_EDGE_TOLERANCE_MM = 0.0005
_MOST_MM = 100.0
_FORCED_CHECKS = {
    "pad-edge": "copper-top to edge",
    "body-edge": "bodies to edge",
    "opening-edge": "coverlay-top to edge",
    "opening-legend": "legend-top to openings",
    "anchor-opening": "anchors to openings",
}
"""Name of the check that concerns the same limit as a design rule."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmRecord:
    """The manifest's record of optional features of a film.

    ``backings`` maps the roles of laminated backings to material and thickness; ``forced`` has the broken rules in
    spite of which it was made, ``broken`` the lines that say so in the order notes.
    """

    mode: str
    anchor: AnchorPlan | None
    backings: Mapping[str, str]
    job_in_zip: bool
    frame_mm: float
    forced: frozenset[str]
    broken: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmManifest:
    """Film and assembly as recorded in the manifest of a kit or a panel.

    ``paths`` are those of fabrication files by role, by the fab's profile or, for a profile of the user's, by the generic one;
    ``stencil_mm`` is the thickness of the profile's stencil, None for a profile of the user's.
    """

    lands: Recorded
    assembly: RecordedAssembly
    film: FilmRecord
    x2: object
    legend_is_light: bool
    legend: LegendSizes | None
    order: FabOrder | None
    limits_mm: Mapping[str, object]
    paths: Mapping[str, str]
    names_known: bool
    stencil_mm: float | None


def read_film_record(table: Fields) -> FilmRecord:
    """Read the optional features from a manifest; problems are collected in `table`."""
    fab = table.table("fab")
    backings = {}
    for key in ("stiffener", "adhesive"):
        if key in table.values:
            pattern = r"[A-Za-z0-9]{1,20} \d{1,2}(\.\d{1,3})?"
            backings[f"{key}-bottom"] = table.text(key, pattern=pattern, remedy="give material and mm, such as 'FR4 0.2'")
    forced = table.rows("forced", longest=1000) if "forced" in table.values else ()
    return FilmRecord(
        mode=fab.choice("coverlay_mode", COVERLAY_MODES),
        anchor=_anchor(table) if "anchor" in table.values else None,
        backings=backings,
        job_in_zip=fab.flag("job_in_zip"),
        frame_mm=fab.table("limits_mm").number("opening-edge", low=0.0, high=_MOST_MM),
        forced=frozenset(str(row.get("rule")) for row in forced if isinstance(row, Mapping)),
        broken=frozenset(f"{row.get('rule')}: {row.get('message')}" for row in forced if isinstance(row, Mapping)),
    )


def _anchor(table: Fields) -> AnchorPlan:
    names = [f.name for f in fields(AnchorPlan)]
    anchor = table.table("anchor", names)
    numbers: dict[str, Any] = {name: anchor.number(name, low=0.0, high=_MOST_MM) for name in names if name != "mode"}
    return AnchorPlan(mode=anchor.text("mode", choices=("spur", "mesh")), **numbers)


def forced_as_warnings(checks: list[Check], record: FilmRecord) -> list[Check]:
    """The checks, with failures of forced rules changed to warnings."""
    names = {_FORCED_CHECKS[rule]: rule for rule in record.forced if rule in _FORCED_CHECKS}
    return [
        replace(c, warning=True, message=f"{c.message}; made in spite of rule {names[c.name]}")
        if c.name in names and not c.passed
        else c
        for c in checks
    ]


# Anchors


def check_anchors(copper: GerberContent, coverlay: GerberContent, plan: AnchorPlan, pads: LandPattern, tape: Tape) -> list[Check]:
    """Check that the copper's lines are the anchors of these parts, clear of other parts' openings, outline and holes."""
    expected = build_anchors(plan, tape, pads)
    found = segments(copper.strokes_mm).reshape(-1, 2, 2)
    problems = []
    missing, strange = without_counterpart(expected.lines_mm, found), without_counterpart(found, expected.lines_mm)
    for what, lines in (("missing", missing), ("not an anchor of any part", strange)):
        if len(lines):
            (x, y), _ = lines[0]
            problems.append(f"{len(lines)} lines are {what}, first at ({x:.3f}, {y:.3f}) mm")
    if not problems and len(found) != len(expected.lines_mm):
        problems.append(f"{len(found)} lines instead of {len(expected.lines_mm)}")
    widths = copper.stroke_width_mm
    if len(widths) and np.abs(widths - plan.web_mm).max() > TOLERANCE_MM:
        problems.append(f"a line is {widths[np.argmax(np.abs(widths - plan.web_mm))]:.3f} mm wide instead of {plan.web_mm:g} mm")
    message = "; ".join(problems) or f"{len(found)} lines hold {len(expected.spurs_mm)} pads"
    checks = [Check(name="anchors", passed=not problems, message=message, figure=float(len(found)))]
    return checks if problems else [*checks, _clear_of_openings(expected, coverlay, plan), _clear_of_outline(found, plan, tape)]


def without_counterpart(lines_mm: FloatArray, others_mm: FloatArray) -> FloatArray:
    """Lines without an equal among `others`, in either direction; all of shape (n, 2, 2), mm."""
    if len(lines_mm) == 0 or len(others_mm) == 0:
        return lines_mm
    # each line in both directions, looked up by its middle, which they share
    both = np.concatenate([others_mm, others_mm[:, ::-1]])
    tree = shapely.STRtree(shapely.points(both.mean(axis=1)))
    line, other = tree.query(shapely.points(lines_mm.mean(axis=1)), predicate="dwithin", distance=TOLERANCE_MM)
    near = np.abs(lines_mm[line] - both[other]).max(axis=(1, 2)) <= TOLERANCE_MM
    alone = np.ones(len(lines_mm), dtype=bool)
    alone[line[near]] = False
    return lines_mm[alone]


def _clear_of_openings(anchors: Anchors, coverlay: GerberContent, plan: AnchorPlan) -> Check:
    name = "anchors to openings"
    if 2 * len(coverlay.flash_xy_mm) != len(anchors.spurs_mm):
        return Check(name=name, passed=False, message=f"{len(coverlay.flash_xy_mm)} openings for {len(anchors.spurs_mm)} pads")
    outlines = coverlay.aperture_outlines_mm
    boxes = np.array(
        [shapely.Polygon(outlines[i] + xy) for i, xy in zip(coverlay.flash_aperture, coverlay.flash_xy_mm, strict=True)]
    )
    # a line in another part's opening would be bare copper, and draw off its solder
    gap_mm, _ = nearest_foreign(anchors, boxes)
    passed = gap_mm >= plan.opening_mm - _EDGE_TOLERANCE_MM
    message = f"{gap_mm:.3f} mm from openings of other pads" + ("" if passed else f", less than {plan.opening_mm:g} mm")
    return Check(name=name, passed=passed, message=message, figure=gap_mm, unit="mm")


def _clear_of_outline(lines_mm: FloatArray, plan: AnchorPlan, tape: Tape) -> Check:
    board = tape.board
    # the nearest point to a convex outline is an end of the line; the copper extends half the width beyond
    edge = float(inset_mm(lines_mm, board.size_mm, board.corner_radius_mm).min()) - plan.web_mm / 2
    drawn = shapely.linestrings(lines_mm)
    holes = [float(shapely.distance(drawn, shapely.Point(x, y)).min()) - (d + plan.web_mm) / 2 for x, y, d in board.holes]
    hole = min(holes, default=float("inf"))
    passed = edge >= plan.pad_edge_mm - _EDGE_TOLERANCE_MM and hole >= plan.hole_copper_mm - _EDGE_TOLERANCE_MM
    message = f"{edge:.3f} mm inside the outline" + (f", {hole:.3f} mm from the nearest hole" if holes else "")
    return Check(name="anchors to edge", passed=passed, message=message, figure=edge, unit="mm")


# One window for all parts


def check_window(coverlay: GerberContent, opening_mm: FloatArray, record: FilmRecord, tape: Tape, cpl: CplContent) -> list[Check]:
    """Check that one opening contains those of all parts, has the right size, and leaves a frame of coverlay around it."""
    name = "coverlay-top window"
    if len(coverlay.areas_mm) != 1 or len(coverlay.flash_xy_mm) or len(coverlay.strokes_mm) or coverlay.clear:
        return [Check(name=name, passed=False, message="other objects than one window")]
    window = shapely.Polygon(coverlay.areas_mm[0])
    expected = shapely.Polygon(gang_window(tape.board, tape.part_xy_mm(), opening_mm))
    if not window.is_valid:
        return [Check(name=name, passed=False, message="the window crosses itself")]
    error_mm = outlines_apart_mm(window, expected)
    passed = error_mm <= TOLERANCE_MM
    message = f"{'within' if passed else 'off by'} {error_mm * 1000:.1f} um of the window that these parts ask for"
    checks = [Check(name=name, passed=passed, message=message, figure=error_mm * 1000, unit="um")]
    boxes = shapely.polygons(cpl.xy_mm[:, None] + opening_mm) if len(cpl.xy_mm) else np.empty(0)
    # wider by the tolerance, so that an opening on the window's edge does not fail by rounding
    covered = ~shapely.covers(window.buffer(TOLERANCE_MM), boxes)
    message = f"{int(covered.sum())} parts of the CPL are partly covered" if covered.any() else "every part of the CPL lies in it"
    checks.append(Check(name="coverlay-top parts", passed=not covered.any(), message=message, figure=float(covered.sum())))
    frame = float(inset_mm(coverlay.areas_mm[0], tape.board.size_mm, tape.board.corner_radius_mm).min())
    passed = frame >= record.frame_mm - _EDGE_TOLERANCE_MM
    message = f"{frame:.3f} mm of coverlay round it" + ("" if passed else f", less than {record.frame_mm:g} mm")
    return [*checks, Check(name="coverlay-top frame", passed=passed, message=message, figure=frame, unit="mm")]


# Stiffener and adhesive


def file_function(role: str, backing: str) -> str:
    """File function that the attributes of a backing's file must state."""
    return f"Other,{role.split('-', maxsplit=1)[0].capitalize()}_Bottom_{material_words(backing)}"


def check_backing(role: str, content: GerberContent, path: str, backing: str, outline_mm: FloatArray) -> Check:
    """Check that a backing is one area equal to the outline, in a file whose name contains material and thickness."""
    problems = []
    if len(content.areas_mm) != 1 or len(content.flash_xy_mm) or len(content.strokes_mm) or content.clear:
        problems.append("other objects than one area")
    else:
        area, outline = shapely.Polygon(content.areas_mm[0]), shapely.Polygon(outline_mm)
        error_mm = outlines_apart_mm(area, outline)
        if not area.is_valid:
            problems.append("its area crosses itself")
        if error_mm > TOLERANCE_MM:
            problems.append(f"it leaves the outline by {error_mm:.3f} mm")
    # a Gerber layer does not contain material and thickness, which the fab has only from its name
    if material_words(backing) not in path:
        problems.append(f"its name {path.rsplit('/', 1)[-1]} does not say {material_words(backing)}")
    message = "; ".join(problems) or f"{backing} mm, as large as the board"
    return Check(name=role, passed=not problems, message=message)
