"""Checks of pads, paste and coverlay openings against manifest and CPL: number, place, rotation, shape, area, name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields, named
from tactape_fab.kit.profiles import LandPattern, read_land
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray, IntArray, pair_of
from tactape_fab.texture.shapes import area_mm2, axis_angle_deg, placed_outline, rotate
from tactape_fab.texture.tape import Tape

PLACE_TOLERANCE_MM = 0.001
ROTATION_TOLERANCE_DEG = 0.05
AREA_TOLERANCE = 0.01
_PARTNER_TOLERANCE_MM = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """The manifest's record of lands, openings and edge limits."""

    pads: LandPattern
    paste: LandPattern
    expansion_mm: float
    pad_edge_mm: float
    body_edge_mm: float
    opening_legend_mm: float


def read_recorded(table: Fields) -> Recorded:
    """Read the manifest's ``land_pattern`` and the edge limits of ``fab``; problems are collected in `table`."""
    lands = table.table("land_pattern")
    limits = table.table("fab").table("limits_mm")

    return Recorded(
        pads=read_land(lands.table("pads")),
        paste=read_land(lands.table("paste")),
        expansion_mm=lands.number("opening_expansion_mm", low=0.0, high=1.0),
        pad_edge_mm=limits.number("pad-edge", low=0.0, high=100.0),
        body_edge_mm=limits.number("body-edge", low=0.0, high=100.0),
        opening_legend_mm=limits.number("opening-legend", low=0.0, high=100.0),
    )


def nearest(points_mm: FloatArray, tree: shapely.STRtree) -> tuple[IntArray, FloatArray]:
    """Index and distance of the nearest point in a tree, for every point; shapes (n,)."""
    # one of several equally near points; sorted, as the order of the pairs is not guaranteed
    (asked, found), distance = tree.query_nearest(shapely.points(points_mm), return_distance=True, all_matches=False)
    order = np.argsort(asked, kind="stable")
    return found[order].astype(np.int64), distance[order]


def point_tree(xy_mm: FloatArray) -> shapely.STRtree:
    """R-tree of points for `nearest`; xy_mm of shape (n, 2)."""
    return shapely.STRtree(shapely.points(xy_mm), node_capacity=4)  # finds the nearest in three quarters of the usual time


def apart_mm(points: FloatArray, others: FloatArray) -> float:
    """Largest distance of a point from the nearest one of the other set, in both directions; a third column is compared too."""
    if not len(points) or not len(others):
        return 0.0 if len(points) == len(others) else np.inf
    far, rest = 0.0, points
    for _ in range(2):
        index, distance = nearest(rest[:, :2], point_tree(others[:, :2]))
        far = max(far, *(float(np.abs(off).max(initial=0.0)) for off in (distance, rest[:, 2:] - others[index, 2:])))
        # then the other way, as one set may have a point twice and lack another; one that was found is no farther than its finder
        rest, others = np.delete(others, index, axis=0), points
    return far


def outlines_apart_mm(drawn: Any, expected: Any) -> float:
    """Distance of two polygons: Hausdorff distance of corners and middles of sides, or the mean distance by area if larger."""
    # a slit may have its corners on the other outline, and a sliver along a side all of its points
    sides_mm = shapely.hausdorff_distance(drawn.exterior, expected.exterior, densify=0.5)
    return max(float(sides_mm), float(abs(drawn.area - expected.area) / expected.length))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LandPairs:
    """Pairs of lands: middles, and vectors from land 1 to land 2, shape (p, 2), mm; indices of the flashes of land 1 and 2,
    shape (p,); and the flashes without a partner.
    """

    centre_mm: FloatArray
    axis_mm: FloatArray
    first: IntArray
    second: IntArray
    alone: IntArray


def pair_lands(xy_mm: FloatArray, offset_mm: float, rotation_deg: float) -> LandPairs:
    """Find pairs of lands from flashes alone.

    xy_mm (m, 2)
    offset_mm, rotation_deg: Half the distance of the lands of a pair, and its direction.
    """
    if len(xy_mm) < 2:
        nothing, none = np.empty((0, 2)), np.empty(0, dtype=np.int64)
        return LandPairs(centre_mm=nothing, axis_mm=nothing, first=none, second=none, alone=np.arange(len(xy_mm)))
    # land 2 is a step of twice the offset along the part from land 1
    first, second = _alternate(_following(xy_mm, rotate((2 * offset_mm, 0.0), rotation_deg)))
    used = np.zeros(len(xy_mm), dtype=bool)
    used[first], used[second] = True, True
    return LandPairs(
        centre_mm=(xy_mm[first] + xy_mm[second]) / 2,
        axis_mm=xy_mm[second] - xy_mm[first],
        first=first,
        second=second,
        alone=np.flatnonzero(~used),
    )


def _following(xy_mm: FloatArray, step_mm: FloatArray) -> IntArray:
    """Index of the flash one step from each flash, -1 if there is none or another flash is nearer to it; shape (m,)."""
    partner, distance = nearest(xy_mm + step_mm, point_tree(xy_mm))
    # if two flashes have the same partner, the nearer one gets it: unique keeps the first of equal partners
    by_distance = np.argsort(distance, kind="stable")
    by_distance = by_distance[distance[by_distance] < _PARTNER_TOLERANCE_MM]
    _, first = np.unique(partner[by_distance], return_index=True)
    linked = by_distance[first]
    following = np.full(len(xy_mm), -1)
    following[linked] = partner[linked]
    return following


def _alternate(following: IntArray) -> tuple[IntArray, IntArray]:
    """Split chains of flashes into pairs from their starts, as lands of neighbouring parts may be as far apart as a pair.

    ``following`` is the next flash of each, -1 at the end of a chain.
    """
    # a flash that follows none begins a chain: 1-2 of one part, or 1-2-1-2 of neighbours that are a pair's distance apart
    heads = np.ones(len(following), dtype=bool)
    heads[following[following >= 0]] = False
    first, second = [], []
    now = np.flatnonzero(heads & (following >= 0))
    while len(now):
        first.append(now)
        second.append(following[now])
        # the flash after a land 2 is a neighbour's land 1, and begins a pair if another one follows
        onward = following[second[-1]]
        now = onward[onward >= 0]
        now = now[following[now] >= 0]
    nothing = np.empty(0, dtype=np.int64)
    return np.concatenate([nothing, *first]), np.concatenate([nothing, *second])


def check_lands(
    name: str,
    content: GerberContent,
    pairs: LandPairs,
    land: LandPattern,
    tape: Tape,
    cpl: CplContent,
    rows: shapely.STRtree,
    *,
    lines: bool,
) -> list[Check]:
    """Check that each part has two lands, centred at its CPL place, with direction and shape at the CPL's rotation.

    ``lines``: whether the layer may have lines, which are checked elsewhere.
    """
    count = len(content.flash_xy_mm)
    expected = 2 * tape.part_count
    centre, axis, alone, rotation = pairs.centre_mm, pairs.axis_mm, pairs.alone, tape.part.rotation_deg
    problems = []
    if count != expected:
        problems.append(f"{count} flashes where {tape.part_count} parts need {expected}")
    if len(alone):
        x, y = content.flash_xy_mm[alone[0]]
        problems.append(f"{len(alone)} flashes have no partner, first at ({x:.3f}, {y:.3f}) mm")
    if len(content.aperture_outlines_mm) > 1:
        problems.append(f"{len(content.aperture_outlines_mm)} different apertures instead of one")
    if len(content.areas_mm) or (len(content.strokes_mm) and not lines) or content.clear:
        problems.append("objects that are not pads")
    shapeless = any(area_mm2(outline) == 0.0 for outline in content.aperture_outlines_mm)
    if shapeless:
        problems.append("an aperture without area")
    message = "; ".join(problems) or f"{len(centre)} pairs for {tape.part_count} parts"
    checks = [Check(name=f"{name} pairs", passed=not problems, message=message, figure=float(len(centre)))]
    if shapeless or len(centre) == 0 or len(cpl.xy_mm) == 0:
        return checks
    row, distance = nearest(centre, rows)
    names = [cpl.designators[i] for i in row]
    checks.append(_place_check(name, "pair", centre, distance, cpl, row, _moved_lands(pairs, land, rotation, distance, names)))
    checks.append(_rotation_check(name, content, land, axis, cpl.rotation_deg[row], cpl, row))
    checks.append(_area_check(name, content, land.area_mm2 * expected))
    checks.append(_shape_check(name, content.aperture_outlines_mm, placed_outline(land.size_mm, land.corner_radius_mm, rotation)))
    if any(content.flash_component):
        checks.append(_names_check(name, content, pairs, names))
    return checks


def _moved_lands(pairs: LandPairs, land: LandPattern, rotation_deg: float, distance: FloatArray, names: list[str]) -> list[str]:
    """Problem of pairs that are in place although their lands are moved in opposite directions."""
    moved_mm = np.hypot(*(pairs.axis_mm / 2 - rotate((land.offset_mm, 0.0), rotation_deg)).T)
    # pairs that are out of place are reported already
    moved_mm[distance > PLACE_TOLERANCE_MM] = 0.0
    worst, count = int(np.argmax(moved_mm)), int((moved_mm > PLACE_TOLERANCE_MM).sum())
    return [f"lands of {count} parts are off, worst by {moved_mm[worst] * 1000:.1f} um at {names[worst]}"] if count else []


def _place_check(
    name: str,
    what: str,
    centre: FloatArray,
    distance: FloatArray,
    cpl: CplContent,
    row: IntArray,
    also: Sequence[str] = (),
) -> Check:
    worst = int(np.argmax(distance))
    taken, times = np.unique(row, return_counts=True)
    far = np.flatnonzero(distance > PLACE_TOLERANCE_MM)
    problems = []
    if len(far):
        problems.append(
            f"{len(far)} {what}s are off the CPL, worst by {distance[worst] * 1000:.1f} um at {cpl.designators[row[worst]]} "
            f"({centre[worst, 0]:.3f}, {centre[worst, 1]:.3f}) mm"
        )
    if (times > 1).any():
        problems.append(f"two {what}s stand at {cpl.designators[taken[times > 1][0]]}")
    if len(taken) < len(cpl.xy_mm):
        missing = np.setdiff1d(np.arange(len(cpl.xy_mm)), taken)
        problems.append(f"no {what} stands at {named([cpl.designators[i] for i in missing])}")
    problems += also
    figure = float(distance.max() * 1000)
    message = "; ".join(problems) or f"centre of every {what} within {figure:.3f} um of its CPL row"
    return Check(name=f"{name} places", passed=not problems, message=message, figure=figure, unit="um")


def _turn_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between two undirected lines, 0 to 90 degrees."""
    return np.abs((a - b + 90.0) % 180.0 - 90.0)


def _rotation_check(
    name: str,
    content: GerberContent,
    land: LandPattern,
    axis: FloatArray,
    rotation_deg: FloatArray,
    cpl: CplContent,
    row: IntArray,
) -> Check:
    pair_deg = np.degrees(np.arctan2(axis[:, 1], axis[:, 0]))
    # undirected, as half a turn exchanges two equal lands
    turn = _turn_deg(pair_deg, rotation_deg)
    worst = int(np.argmax(turn))
    problems = []
    # pads that are off by the place tolerance rotate their pair by up to this angle
    if turn[worst] > ROTATION_TOLERANCE_DEG + np.degrees(PLACE_TOLERANCE_MM / land.offset_mm):
        problems.append(f"pads of {cpl.designators[row[worst]]} lie {turn[worst]:.2f} deg from the CPL's rotation")
    shape_deg = _outline_axis_deg(content.aperture_outlines_mm[0], land)
    if shape_deg is not None and len(rotation_deg):
        # an aperture may be rotated although its flashes are in place, as readers draw rotated macros differently
        shape_turn = float(_turn_deg(np.array(shape_deg), rotation_deg).max())
        if shape_turn > ROTATION_TOLERANCE_DEG:
            problems.append(f"the pad itself is turned by {shape_turn:.2f} deg from the CPL's rotation")
    message = "; ".join(problems) or f"pairs and pads within {turn[worst]:.4f} deg of the CPL's rotation"
    return Check(name=f"{name} rotation", passed=not problems, message=message, figure=float(turn[worst]), unit="deg")


def _outline_axis_deg(outline: FloatArray, land: LandPattern) -> float | None:
    """Direction of an aperture's side along the part, degrees; None if the land is square."""
    if abs(land.size_mm[0] - land.size_mm[1]) < 0.01:
        return None
    box = shapely.minimum_rotated_rectangle(shapely.Polygon(outline))
    corners = np.array(box.exterior.coords)
    # two adjacent sides; the others are parallel to them
    sides = np.diff(corners[:3], axis=0)
    lengths = np.hypot(*sides.T)
    along = sides[int(np.argmax(lengths) if land.size_mm[0] > land.size_mm[1] else np.argmin(lengths))]
    return axis_angle_deg(pair_of(along))


def _shape_check(name: str, outlines: Sequence[FloatArray], expected: FloatArray) -> Check:
    """Check that every flashed outline is that of the manifest, relative to its own origin."""
    drawn = [shapely.Polygon(outline) for outline in outlines]
    # Hausdorff distance, which shows a missing corner radius that changes the area by less than 1 %
    error_mm = max(outlines_apart_mm(polygon, shapely.Polygon(expected)) for polygon in drawn)
    passed, crossed = error_mm <= PLACE_TOLERANCE_MM, not all(polygon.is_valid for polygon in drawn)
    message = f"outline {'within' if passed else 'off by'} {error_mm * 1000:.1f} um of the manifest's"
    if crossed:
        passed, message = False, f"{message}; it crosses itself"
    return Check(name=f"{name} shape", passed=passed, message=message, figure=error_mm * 1000, unit="um")


def _names_check(name: str, content: GerberContent, pairs: LandPairs, designators: list[str]) -> Check:
    """Check that pads 1 and 2 have the designator of the CPL row at their place."""
    wrong = [
        f"{content.flash_component[flash]}.{content.flash_pin[flash]} stands where {part}.{pin} is"
        for pin, flashes in (("1", pairs.first), ("2", pairs.second))
        for flash, part in zip(flashes.tolist(), designators, strict=True)
        if (content.flash_component[flash], content.flash_pin[flash]) != (part, pin)
    ]
    return Check(name=f"{name} names", passed=not wrong, message=named(wrong) or "every pad names its part and pin")


def _area_check(name: str, content: GerberContent, expected_mm2: float) -> Check:
    # 1 % tolerates the chords of rounded corners: some 0.1 % of an 0201's pad with nine points per corner
    areas = np.array([area_mm2(outline) for outline in content.aperture_outlines_mm])
    area = float(areas[content.flash_aperture].sum())
    error = area / expected_mm2 - 1.0
    passed = abs(error) <= AREA_TOLERANCE
    message = f"{area:.2f} mm2 drawn, {expected_mm2:.2f} mm2 specified ({error * 100:+.2f} %)"
    return Check(name=f"{name} area", passed=passed, message=message, figure=error * 100, unit="%")


def check_openings(content: GerberContent, recorded: Recorded, tape: Tape, cpl: CplContent, rows: shapely.STRtree) -> list[Check]:
    """Check that each part has one coverlay opening, at its CPL place, around both pads with the fab's expansion."""
    name = "coverlay-top"
    count = len(content.flash_xy_mm)
    problems = []
    if count != tape.part_count:
        problems.append(f"{count} openings for {tape.part_count} parts")
    shapeless = any(area_mm2(outline) == 0.0 for outline in content.aperture_outlines_mm)
    if len(content.aperture_outlines_mm) != 1 or len(content.areas_mm) or len(content.strokes_mm) or content.clear or shapeless:
        problems.append("other objects than one opening per part")
    checks = [
        Check(
            name=f"{name} openings", passed=not problems, message="; ".join(problems) or f"{count} openings", figure=float(count)
        )
    ]
    if shapeless or count == 0 or len(cpl.xy_mm) == 0:
        return checks
    row, distance = nearest(content.flash_xy_mm, rows)
    checks.append(_place_check(name, "opening", content.flash_xy_mm, distance, cpl, row))
    checks.append(_shape_check(name, content.aperture_outlines_mm, opening_outline(recorded, tape)))
    return checks


def opening_outline(recorded: Recorded, tape: Tape) -> FloatArray:
    """Corners of a part's opening about its centre: the bounding box of both pads plus the expansion, mm; shape (4, 2)."""
    return placed_outline(opening_size_mm(recorded), 0.0, tape.part.rotation_deg)


def between_lands_mm(recorded: Recorded) -> float:
    """Gap between the two lands of a part, mm, which bounds the copper spacing from above."""
    return 2 * recorded.pads.offset_mm - recorded.pads.size_mm[0]


def opening_size_mm(recorded: Recorded) -> tuple[float, float]:
    """Length and width of a part's opening."""
    pads, wider_mm = recorded.pads, 2 * recorded.expansion_mm
    return 2 * pads.offset_mm + pads.size_mm[0] + wider_mm, pads.size_mm[1] + wider_mm
