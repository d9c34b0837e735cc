"""Checks of outline, clearances from it, component layer and drill file against the manifest and the CPL."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import ceil, pi, sqrt

import numpy as np
import shapely

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named, shown
from tactape_fab.kit.film.gaps import gaps_mm, pen_strokes, polygons
from tactape_fab.kit.profiles import LandPattern
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import area_mm2, inset_mm, rotate
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM, Recorded, nearest

OUTLINE_TOLERANCE_MM = 0.001
EDGE_TOLERANCE_MM = 0.0005
_ARC_MISFIT_MM, _MOST_ARC_POINTS = 1e-6, 2048
_CORNERS = np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)])
OUTLINE_LINE_MM = 0.1
_BODY_LINE_MM = 0.1
_COMPONENT_FUNCTIONS, _COMPONENT_MM = ("ComponentMain", "ComponentPin", "ComponentPin"), (0.3, 0.36, 0.0)
"""Function and diameter of the apertures of a part's centre, pin 1 and pin 2, which Gerber 2024.05 section 6.2 prescribes."""
PART_DATA = re.compile(rb"%TO\.C([A-Z][A-Za-z]*),([^*]*)\*%")


def check_outline(content: GerberContent, tape: Tape) -> Check:
    """Check that there is one closed outline with the manifest's size and corner radius."""
    board = tape.board
    if len(content.strokes_mm) != 1 or len(content.flash_xy_mm) or len(content.areas_mm):
        return Check(name="profile", passed=False, message=f"{len(content.strokes_mm)} contours instead of one")
    if (pen := stroke_problem(content)) is not None:
        return Check(name="profile", passed=False, message=pen)
    stroke = content.strokes_mm[0]
    if len(stroke) < 4 or np.hypot(*(stroke[0] - stroke[-1])) > 1e-9:
        return Check(name="profile", passed=False, message="the outline is not closed")
    (width, height), radius = board.size_mm, board.corner_radius_mm
    corners = [(radius, radius), (width - radius, radius), (width - radius, height - radius), (radius, height - radius)]
    # a rounded rectangle is the rectangle of its corner centres offset by the radius
    core = shapely.MultiPoint(corners).convex_hull
    expected = core.buffer(radius, quad_segs=_arc_points(radius)) if radius else core
    if not shapely.Polygon(stroke).is_valid:
        return Check(name="profile", passed=False, message="the outline crosses itself")
    sides = shapely.STRtree(shapely.linestrings(np.stack([stroke[:-1], stroke[1:]], axis=1)), node_capacity=2)
    from_drawn_mm = nearest(shapely.get_coordinates(expected.exterior), sides)[1]
    # in both directions: drawn points from the exact outline, and expected points from the drawn chords
    error_mm = float(max(off_outline_mm(stroke, board.size_mm, radius), from_drawn_mm.max()))
    passed = error_mm <= OUTLINE_TOLERANCE_MM
    size = stroke.max(axis=0) - stroke.min(axis=0)
    message = f"closed, {size[0]:g} x {size[1]:g} mm" + ("" if passed else f", {error_mm:.3f} mm from the manifest's outline")
    return Check(name="profile", passed=passed, message=message, figure=error_mm * 1000, unit="um")


def off_outline_mm(closed_mm: FloatArray, size_mm: tuple[float, float], radius_mm: float) -> float:
    """Largest distance of a closed polyline from a board's outline, or the mean distance by their areas if larger, mm."""
    # middles of segments as well, as a segment across the board may end on the outline
    points = np.concatenate([closed_mm, (closed_mm[1:] + closed_mm[:-1]) / 2])
    width, height = size_mm
    missing_mm2 = width * height - (4 - pi) * radius_mm**2 - area_mm2(closed_mm)
    return float(max(np.abs(inset_mm(points, size_mm, radius_mm)).max(), abs(missing_mm2) / (2 * (width + height))))


def stroke_problem(content: GerberContent) -> str | None:
    """Problem of the strokes of an outline, which must be thin and of dark polarity, as fabs use their centre line."""
    widest = float(np.abs(content.stroke_width_mm - OUTLINE_LINE_MM).max(initial=0.0))
    if content.clear:
        return "it draws in clear polarity"
    return f"its line is {widest:.3f} mm wider or narrower than {OUTLINE_LINE_MM:g} mm" if widest > 1e-6 else None


def _arc_points(radius_mm: float) -> int:
    """Number n of chords of a quarter circle whose sagitta r (pi / 4n)² / 2 is at most a thousandth of the tolerance."""
    return min(_MOST_ARC_POINTS, ceil(pi / 4 * sqrt(radius_mm / (2 * _ARC_MISFIT_MM))))


def check_edges(layers: Mapping[str, GerberContent], recorded: Recorded, tape: Tape, cpl: CplContent) -> list[Check]:
    """Check that nothing is outside the outline, and that copper and bodies keep the recorded distances from it."""
    board = tape.board

    def inset(points: list[FloatArray]) -> float:
        joined = np.concatenate([np.empty((0, 2)), *points])
        return float(inset_mm(joined, board.size_mm, board.corner_radius_mm).min(initial=np.inf))

    def drawn(content: GerberContent) -> list[FloatArray]:
        stamps = [
            outermost(content.flash_xy_mm[content.flash_aperture == i], outline, tape)
            for i, outline in enumerate(content.aperture_outlines_mm)
        ]
        return [*stamps, *content.areas_mm, *content.strokes_mm]

    checks = []
    half = np.array(tape.part.body_mm[:2]) / 2
    bodies = [
        outermost(cpl.xy_mm[cpl.rotation_deg == angle], rotate(half * _CORNERS, angle), tape)
        for angle in sorted(set(cpl.rotation_deg.tolist()))
    ]
    cases = [(role, drawn(layers[role]), 0.0) for role in ("coverlay-top", "paste-top", "legend-top") if role in layers]
    cases.insert(0, ("copper-top", drawn(layers["copper-top"]), recorded.pad_edge_mm))
    cases.append(("bodies", bodies, recorded.body_edge_mm))
    for role, points, limit_mm in cases:
        value = inset(points)
        passed = value >= limit_mm - EDGE_TOLERANCE_MM
        message = f"{value:.3f} mm inside the outline" + ("" if passed else f", less than {limit_mm:g} mm")
        checks.append(Check(name=f"{role} to edge", passed=passed, message=message, figure=value, unit="mm"))
    return checks


def outermost(xy_mm: FloatArray, outline_mm: FloatArray, tape: Tape) -> FloatArray:
    """Vertices of those copies of a shape that may be the nearest to the board's outline.

    Points of a copy are within the shape's radius of its place, which bounds their distance from the outline.
    """
    inset = inset_mm(xy_mm, tape.board.size_mm, tape.board.corner_radius_mm)
    reach_mm = np.hypot(*outline_mm.T).max()
    # with the least inset d of a place, the nearest point is at most at d + reach; a copy at inset i has none below i - reach
    near = xy_mm[inset <= inset.min(initial=np.inf) + 2 * reach_mm + EDGE_TOLERANCE_MM]
    return np.asarray((near[:, None] + outline_mm).reshape(-1, 2))


def check_legend_clear(legend: GerberContent, coverlay: GerberContent, recorded: Recorded) -> Check:
    """Check that ink keeps the recorded distance from every coverlay opening."""
    # GEOS gives no distance for self-intersecting polygons
    areas = shapely.make_valid(polygons(legend.areas_mm))
    ink = np.concatenate([areas, pen_strokes(legend.strokes_mm, legend.stroke_width_mm)])
    # 5 mm more than the limit, as the place of a flash is the centre of its opening, which extends less than that
    bounds = shapely.total_bounds(ink) + np.array([-1, -1, 1, 1]) * (recorded.opening_legend_mm + 5.0)
    close = ((coverlay.flash_xy_mm >= bounds[:2]) & (coverlay.flash_xy_mm <= bounds[2:])).all(axis=1)
    stamps = [
        shapely.polygons(coverlay.flash_xy_mm[close & (coverlay.flash_aperture == i), None] + outline)
        for i, outline in enumerate(coverlay.aperture_outlines_mm)
    ]
    near = np.concatenate([*stamps, shapely.make_valid(polygons(coverlay.areas_mm))])
    value = float(gaps_mm(near, ink).min(initial=np.inf))
    passed = value >= recorded.opening_legend_mm - EDGE_TOLERANCE_MM
    message = f"{value:.3f} mm from the nearest opening" if len(near) else "far from every opening"
    limit = "" if passed else f", less than {recorded.opening_legend_mm:g} mm"
    return Check(name="legend-top to openings", passed=passed, message=message + limit, figure=value, unit="mm")


def check_components(content: GerberContent, cpl: CplContent) -> Check:
    """Check that the component layer names every part at its CPL place."""
    main = np.array([f.startswith("ComponentMain") for f in content.aperture_functions], dtype=bool)
    is_centre = main[content.flash_aperture] if len(content.flash_aperture) else np.zeros(0, dtype=bool)
    centres = content.flash_xy_mm[is_centre]
    names = [name for name, keep in zip(content.flash_component, is_centre, strict=True) if keep]
    if names != list(cpl.designators):
        wrong = sorted(set(names) ^ set(cpl.designators))
        return Check(
            name="components-top", passed=False, message=f"its designators differ from the CPL's: {named(wrong) or 'their order'}"
        )
    error = np.hypot(*(centres - cpl.xy_mm).T)
    far = np.flatnonzero(error > PLACE_TOLERANCE_MM)
    figure = float(error.max(initial=0.0) * 1000)
    message = (
        f"{len(far)} parts are off the CPL: {named([f'{names[i]} by {error[i] * 1000:.1f} um' for i in far])}"
        if len(far)
        else f"{len(centres)} parts within {figure:.3f} um of the CPL"
    )
    return Check(name="components-top", passed=not len(far), message=message, figure=figure, unit="um")


def check_part_data(content: GerberContent, data: bytes, tape: Tape, recorded: RecordedAssembly, pads: LandPattern) -> Check:
    """Check the parts' data in the component layer: rotation, value, footprint, height, both pins and body outline."""
    fields = {
        "Rot": f"{tape.part.rotation_deg:g}",
        "Mnt": "SMD",
        "Val": recorded.value.replace(",", "\\u002C"),
        "Ftp": recorded.footprint.replace(",", "\\u002C"),
        "Hgt": f"{tape.part.body_mm[2]:g}",
    }
    found = [(name.decode("ascii"), value.decode("ascii", "replace")) for name, value in PART_DATA.findall(data)]
    problems = []
    if found != list(fields.items()):
        wrong = [f".C{name} {shown(value)}" for name, value in found if fields.get(name) != value]
        problems.append(f"it says {named(wrong) or 'a value twice, or not at all'}, which the manifest does not")
    pin = np.array([bool(name) for name in content.flash_pin], dtype=bool)
    # flashes with a pin are the two pins of each part; the flash without is its centre
    names = [name for name, keep in zip(content.flash_component, pin, strict=True) if keep]
    numbers = [name for name in content.flash_pin if name]
    half = rotate(np.array([(-pads.offset_mm, 0.0), (pads.offset_mm, 0.0)]), tape.part.rotation_deg)
    expected = (tape.part_xy_mm()[:, None] + half).reshape(-1, 2)
    if names != [name for name in tape.designators() for _ in "12"] or numbers != ["1", "2"] * tape.part_count:
        problems.append("its pins are not 1 and 2 of each part, in order")
    elif np.hypot(*(content.flash_xy_mm[pin] - expected).T).max() > PLACE_TOLERANCE_MM:
        problems.append("a pin does not stand on its pad")
    sizes_mm = [float(np.ptp(outline[:, 0])) for outline in content.aperture_outlines_mm]
    if (
        content.flash_aperture.tolist() != [0, 1, 2] * tape.part_count
        or content.aperture_functions != _COMPONENT_FUNCTIONS
        or not np.allclose(sizes_mm, _COMPONENT_MM, rtol=0.0, atol=PLACE_TOLERANCE_MM)
    ):
        problems.append("a centre or pin is flashed with another aperture")
    bodies = rotate(np.array(tape.part.body_mm[:2]) / 2 * _CORNERS, tape.part.rotation_deg)
    outlines = [stroke for stroke in content.strokes_mm if len(stroke) == len(_CORNERS) + 1]
    if len(outlines) != len(content.strokes_mm) or len(outlines) != tape.part_count:
        problems.append("it does not draw one body for each part")
    else:
        corners = np.array(outlines) - tape.part_xy_mm()[:, None]
        # an outline may begin at any of the four corners, and returns to it
        begun = np.stack([np.concatenate([rolled, rolled[:1]]) for rolled in (np.roll(bodies, -k, axis=0) for k in range(4))])
        far = np.abs(corners[:, None] - begun).max(axis=(-2, -1)).min(axis=-1)
        if far.max(initial=0.0) > PLACE_TOLERANCE_MM:
            problems.append("the body of a part has another size or place")
        if np.abs(content.stroke_width_mm - _BODY_LINE_MM).max(initial=0.0) > PLACE_TOLERANCE_MM:
            problems.append("the body of a part is drawn with another aperture")
    message = named(problems) or f"rotation, value, footprint, height, pins and body of {tape.part_count} parts as the manifest's"
    return Check(name="components-top data", passed=not problems, message=message)


def check_drill(holes: FloatArray, tape: Tape) -> Check:
    """Check that the drill file has exactly the holes of the manifest."""
    expected, found = sorted(tape.board.holes), sorted((x, y, d) for x, y, d in holes.tolist())

    def apart(hole: tuple[float, float, float], others: list[tuple[float, float, float]]) -> bool:
        return all(max(abs(a - b) for a, b in zip(hole, other, strict=True)) > PLACE_TOLERANCE_MM for other in others)

    missing = [f"({x:g}, {y:g}) d {d:g} mm is missing" for x, y, d in expected if apart((x, y, d), found)]
    strange = [f"({x:g}, {y:g}) d {d:g} mm is not in the manifest" for x, y, d in found if apart((x, y, d), expected)]
    problems = [*missing, *strange]
    if not problems and len(found) != len(expected):
        problems.append(f"{len(found)} holes where the manifest has {len(expected)}")
    message = named(problems) or f"{len(found)} hole{'s' * (len(found) != 1)} as in the manifest"
    return Check(name="drill-npth", passed=not problems, message=message, figure=float(len(found)))
