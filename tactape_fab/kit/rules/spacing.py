"""Design rules of a layout, each with its worst measured value and the place of that value."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import ceil

import numpy as np
import shapely

from tactape_fab.base.errors import Finding
from tactape_fab.kit.film.gaps import Geometries, gaps_mm, pen_strokes, polygons
from tactape_fab.kit.film.layout import Layout, labelled_size_mm, shorter_name_fits
from tactape_fab.kit.plan import TOLERANCE_MM, tag_inside
from tactape_fab.kit.profiles import FabProfile, PartProfile, ProcessProfile, cited
from tactape_fab.kit.rules.remedies import opening_words, part_words, wider_words
from tactape_fab.kit.spec.board_options import no_tag
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.board import Board
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, texture_to_board
from tactape_fab.texture.shapes import inset_mm, reach_mm
from tactape_fab.texture.tape import Tape

_NEAR_LEGEND_MM = 5.0

Measured = tuple[float, tuple[float, float] | None]
"""The worst value and its place (board frame, mm)."""
Remedies = str | Callable[[float], str]
"""A remedy, or a function that gives it for a limit in mm."""


def check(layout: Layout, fab: FabProfile, spec: TapeSpec, *, may_turn: bool = True) -> list[Finding]:
    """Check a layout against its fab's limits; remedies are for the spec, and rotate its parts only if they may be (`may_turn`).

    Returns: A finding for every rule that applies, broken or not.
    """
    findings = [
        *_gap_rules(layout, fab, spec, may_turn=may_turn),
        *_edge_rules(layout, fab, spec),
        *_legend_rules(layout, fab),
        *_hole_rules(layout, fab),
    ]
    findings.append(size_finding(layout.tape.board.size_mm, fab))
    return findings


def finding(profile: FabProfile | ProcessProfile, rule: str, measured: Measured, what: str, remedy: Remedies) -> Finding:
    """Compare a measured value with the profile's limit of that rule; the remedy is found only if the rule is broken."""
    value, at_mm = measured
    limit = profile.limits[rule]
    level, least_mm = limit.level, limit.value_mm
    # rounding to decimals and 1 nm may make a value 0.5 um too small, which still meets the limit
    passed = value >= least_mm - TOLERANCE_MM
    if passed and limit.warn_mm is not None and value < limit.warn_mm - TOLERANCE_MM:
        level, least_mm, passed = "warn", limit.warn_mm, False
    relation = "meets" if passed else "is below"
    kind = "limit" if least_mm == limit.value_mm else "limit without asking"
    message = f"{what} {round(value, 3) + 0.0:.3f} mm {relation} the {kind} {least_mm:.3f} mm of {profile.name}"
    return Finding(
        rule=rule,
        level=level,
        passed=passed,
        value=value,
        limit=least_mm,
        at_mm=at_mm,
        **cited(limit),
        message=message if passed else f"{message}; {remedy if isinstance(remedy, str) else remedy(least_mm)}",
    )


# Gaps between equal shapes


def gap_mm(outline_mm: FloatArray, shift_mm: FloatArray) -> FloatArray:
    """Gap between a convex outline and its copy at each shift, negative by the depth of an overlap; shape (m,).

    The gap is the signed distance of the shift from the outline's difference body (Minkowski).
    """
    # A and A + s overlap if and only if s = a - b for some a, b of A; for a convex A the hull of all such differences is that
    # set. The gap is the distance of s from it; inside, minus the distance to its boundary
    difference = (outline_mm[:, None] - outline_mm).reshape(-1, 2)
    body = shapely.MultiPoint(difference).convex_hull
    points = shapely.points(shift_mm)
    # covers is also true on the boundary, where both distances are 0
    depth = np.where(shapely.covers(body, points), shapely.distance(body.exterior, points), 0.0)
    return np.asarray(shapely.distance(body, points) - depth)


def neighbours(tape: Tape, reach: float) -> tuple[FloatArray, FloatArray]:
    """Vectors between the centres of placed parts that may be nearer than `reach`, and the first place of each.

    Returns shifts, places (m, 2): One row for each grid offset and each pair of symbols that occurs at it; board frame, mm.
    """
    found = [*_neighbours(tape, reach), (np.empty((0, 2)), np.empty((0, 2)))]
    shifts, places = (np.concatenate(rows) for rows in zip(*found, strict=True))
    return shifts, places


def _neighbours(tape: Tape, reach: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Pairs of placed parts that may be nearer than `reach`, by grid offset.

    Yields, for each offset, the vectors between centres for the pairs of symbols that occur at it, and the board
    positions half way between the first such pairs; shapes (k, 2).
    """
    placed, kinds = tape.placed, tape.directions
    # displacements may bring neighbours nearer by 2 Δ
    furthest = int((reach + 2 * tape.displacement_mm) / tape.pitch_mm) + 1
    for down in range(furthest + 1):
        for right in range(-furthest, furthest + 1):
            # half of the neighbours suffice: the others have the same shifts
            # with the opposite sign, and a difference body is symmetric
            if down == 0 and right <= 0:
                continue
            rows, columns = tape.rows - down, tape.columns - abs(right)
            if rows <= 0 or columns <= 0:
                continue
            # overlap of the grid and the grid moved by (right, down): equal indices are the two parts of a pair
            first = (slice(0, rows), slice(max(-right, 0), max(-right, 0) + columns))
            second = (slice(down, down + rows), slice(max(right, 0), max(right, 0) + columns))
            # a pair of symbols as one number; kinds**2, which no pair gives, if either part is omitted
            pair = np.where(placed[first] & placed[second], tape.symbols[first] * kinds + tape.symbols[second], kinds**2)
            # first place of each of the at most 64 distinct pairs, as a gap depends only on the pair
            value, place = np.unique(pair, return_index=True)
            a, b = np.divmod(value[value < kinds**2], kinds)
            row, column = np.divmod(place[value < kinds**2], columns)
            step = np.array([right, down]) * tape.pitch_mm
            shift = step + tape.displacement_mm * (DIRECTIONS_XY[b] - DIRECTIONS_XY[a])
            middle = np.column_stack([column + max(-right, 0), row]) * tape.pitch_mm + step / 2
            yield texture_to_board(shift, (0.0, 0.0)), texture_to_board(middle, tape.board.texture_origin_mm)


def _gap_rules(layout: Layout, fab: FabProfile, spec: TapeSpec, *, may_turn: bool) -> Iterator[Finding]:
    tape = layout.tape
    outlines = layout.outlines
    # the outer shapes of a part: the opening holds its pads, the courtyard its body
    part_reach = 2 * float(np.hypot(*np.maximum(reach_mm(outlines.courtyard), reach_mm(outlines.opening))))
    shifts, places = neighbours(tape, part_reach + max(limit.value_mm for limit in fab.limits.values()))
    if len(shifts) == 0:
        return

    def worst(gaps: FloatArray) -> Measured:
        return worst_at(gaps, places)

    between_own = gap_mm(outlines.pad, (outlines.pad_xy[1] - outlines.pad_xy[0])[None])
    # all four combinations of land j of the second part and land i of the first
    lands = [gap_mm(outlines.pad, shifts + outlines.pad_xy[j] - outlines.pad_xy[i]) for i in range(2) for j in range(2)]

    def wider(rule: str) -> Remedies:
        return lambda _: wider_words(spec, fab, layout.part, rule, may_turn=may_turn)

    yield finding(fab, "pad-pad", worst(np.min(lands, axis=0)), "gap between pads of two parts", wider("pad-pad"))
    own = (float(between_own[0]), None)
    pair = finding(
        fab,
        "pad-pad",
        own,
        "gap between the two pads of a part",
        lambda limit_mm: part_words(spec, fab, lambda part: _own_gap_mm(part) >= limit_mm, "whose pads lie further apart"),
    )
    yield replace(pair, rule="pad-pair")
    bodies = worst(gap_mm(outlines.largest_body, shifts))
    yield finding(fab, "body-body", bodies, "gap between two largest bodies", wider("body-body"))
    yield finding(fab, "courtyard", worst(gap_mm(outlines.courtyard, shifts)), "gap between courtyards", wider("courtyard"))
    if layout.window_mm is not None:
        return
    bridges = worst(gap_mm(outlines.opening, shifts))
    yield finding(fab, "opening-bridge", bridges, f"{fab.mask_name} bridge between openings", wider("opening-bridge"))
    yield finding(
        fab,
        "opening-size",
        (min(outlines.opening_size_mm), None),
        f"shorter side of a {fab.mask_name} opening",
        lambda limit_mm: opening_words(spec, fab, limit_mm),
    )


def _own_gap_mm(part: PartProfile) -> float:
    return 2.0 * part.pads.offset_mm - part.pads.size_mm[0]


# Distances from the outline


def _edge_rules(layout: Layout, fab: FabProfile, spec: TapeSpec) -> Iterator[Finding]:
    board = layout.tape.board
    wider = (fab.coverlay_expansion_mm, None)
    yield finding(fab, "opening-expansion", wider, f"expansion of the {fab.mask_name}", "ask the fab")
    radius = (board.corner_radius_mm, None)

    def rounder(limit_mm: float) -> str:
        without = "" if tag_inside(spec, limit_mm, fab.legend.edge_mm) else f" {no_tag(spec.tag_id, spec.sector)}"
        return f"use --corner-radius {limit_mm:g}{without}"

    yield finding(fab, "corner-radius", radius, "corner radius of the outline", rounder)
    remedy = "use a larger --size or another --rotation"
    for rule, outline, what in (
        ("pad-edge", layout.outlines.pads, "pad to outline"),
        ("body-edge", layout.outlines.body, "body to outline"),
        ("opening-edge", layout.outlines.opening, f"{fab.mask_name} opening to outline"),
    ):
        measured = to_outline(layout.parts_xy_mm, outline, board, fab.limits[rule].value_mm)
        if rule == "pad-edge" and layout.anchors is not None:
            lines = layout.anchors.lines_mm.reshape(-1, 2)
            # the smaller (value, place) wins; the copper extends half a web beyond a line
            measured = min(measured, worst_at(_inside(lines, board) - layout.anchors.web_mm / 2, lines))
        if rule == "opening-edge" and layout.window_mm is not None:
            measured = worst_at(_inside(layout.window_mm, board), layout.window_mm)
        yield finding(fab, rule, measured, what, remedy)


def _inside(points_mm: FloatArray, board: Board) -> FloatArray:
    return inset_mm(points_mm, board.size_mm, board.corner_radius_mm)


def to_outline(parts_xy_mm: FloatArray, outline_mm: FloatArray, board: Board, limit_mm: float) -> Measured:
    """Least distance of an outline about each part's centre from the board's outline.

    Only the parts nearest to the outline are measured: enough of them to contain the worst one.
    """
    # The distance to the outline is 1-Lipschitz, and a vertex is within sqrt(2) reach of its centre. The worst vertex is no
    # farther inside than the outermost centre, so a part whose centre is more than 2 reach farther inside cannot have it
    inset = inset_mm(parts_xy_mm, board.size_mm, board.corner_radius_mm)
    near = parts_xy_mm[inset <= max(inset.min(), 0.0) + 2 * (limit_mm + max(reach_mm(outline_mm)))]
    return worst_at(inset_mm(near[:, None] + outline_mm, board.size_mm, board.corner_radius_mm).min(axis=1), near)


def worst_at(values: FloatArray, at_mm: FloatArray) -> Measured:
    """The least value and its place."""
    i = int(np.argmin(values))
    return float(values[i]), (float(at_mm[i, 0]), float(at_mm[i, 1]))


# Legend


def _ink(layout: Layout) -> Geometries:
    """Everything that the legend prints, piece by piece."""
    legend = layout.legend
    return np.concatenate([polygons(legend.areas_mm), pen_strokes([s for s in legend.strokes_mm if len(s) > 1], legend.line_mm)])


def _legend_rules(layout: Layout, fab: FabProfile) -> Iterator[Finding]:
    legend = layout.legend
    if not legend.areas_mm:
        return
    tag = layout.tape.tag
    without = no_tag(None if tag is None else tag.id, layout.tape.sector)
    ink = _ink(layout)
    right_end = shapely.total_bounds(ink)[2] + _NEAR_LEGEND_MM
    # the strip is at the left end: openings more than 5 mm right of the ink are far from every limit. At least one column is
    # kept, so that there is something to measure
    near = layout.openings.xy_mm[layout.openings.xy_mm[:, 0] <= max(right_end, layout.openings.xy_mm[:, 0].min())]
    openings = shapely.polygons(near[:, None] + layout.openings.outline_mm)
    if layout.window_mm is not None:
        near, openings = layout.window_mm.mean(axis=0)[None], polygons([layout.window_mm])
    yield finding(
        fab,
        "opening-legend",
        worst_at(gaps_mm(openings, ink), near),
        f"legend to {fab.mask_name} opening",
        f"use {without}",
    )
    if layout.tape.board.holes:
        holes = np.array(layout.tape.board.holes)
        gaps = gaps_mm(shapely.points(holes[:, :2]), ink) - holes[:, 2] / 2
        yield finding(fab, "hole-legend", worst_at(gaps, holes), "legend to hole", f"use {without}, or leave the hole out")
    if legend.left_out:
        yield Finding(
            rule="label",
            level="warn",
            passed=False,
            unit="",
            message=f"the strip has no room for {', '.join(legend.left_out)}; {_label_words(layout, fab, without)}",
        )


def _label_words(layout: Layout, fab: FabProfile, without: str) -> str:
    size_mm = labelled_size_mm(layout.tape, fab)
    ways = [] if size_mm is None else [f"--size {size_mm[0]:g}x{size_mm[1]:g}"]
    ways += ["a shorter --name"] * shorter_name_fits(layout.tape, fab)
    return f"use {', or '.join(ways or [without])}"


# Holes


def _hole_rules(layout: Layout, fab: FabProfile) -> Iterator[Finding]:
    if not layout.tape.board.holes:
        return
    yield from hole_rules(layout.tape.board, fab, "film")
    for rule, outline, what in (
        ("hole-copper", layout.outlines.pad_xy[:, None] + layout.outlines.pad, "hole to copper"),
        ("hole-part", layout.outlines.body[None], "hole to body"),
    ):
        yield from hole_to_parts(layout.tape.board, fab, rule, layout.parts_xy_mm, outline, what)
    if layout.anchors is not None:
        holes, lines = np.array(layout.tape.board.holes), shapely.linestrings(layout.anchors.lines_mm)
        gaps = shapely.distance(lines[:, None], shapely.points(holes[:, :2])).min(axis=0)
        measured = worst_at(gaps - (holes[:, 2] + layout.anchors.web_mm) / 2, holes)
        yield finding(fab, "hole-copper", measured, "hole to anchor", "use --anchor none, or leave the hole out")


def hole_rules(board: Board, profile: FabProfile | ProcessProfile, between: str) -> Iterator[Finding]:
    """Check distances of holes from the outline and each other, and diameters; `between` names the material between two."""
    holes = np.array(board.holes)
    centres, radii = holes[:, :2], holes[:, 2] / 2
    edge = inset_mm(centres, board.size_mm, board.corner_radius_mm) - radii

    def inward(limit_mm: float) -> str:
        moved = [_moved_inward(hole, board, limit_mm) for hole, gap in zip(board.holes, edge, strict=True) if gap < limit_mm]
        return f"use {', '.join(map(_hole_words, moved))} in {'its' if len(moved) == 1 else 'their'} place"

    def wider(limit_mm: float) -> str:
        # a wider hole may be too near to the outline, or beyond it
        edge_mm = profile.limits["hole-edge"].value_mm
        wide = [_moved_inward((x, y, _up(limit_mm)), board, edge_mm) for x, y, diameter in board.holes if diameter < limit_mm]
        return f"use {', '.join(map(_hole_words, wide))} in {'its' if len(wide) == 1 else 'their'} place"

    yield finding(profile, "hole-edge", worst_at(edge, centres), "hole to outline", inward)
    yield finding(profile, "hole-size", worst_at(2 * radii, centres), "smallest hole", wider)
    if len(holes) > 1:
        tree = shapely.STRtree(shapely.points(centres))
        # pairs whose gap exceeds the limit by more than 10 mm are ignored
        furthest = profile.limits["hole-hole"].value_mm + 10.0
        a, b = tree.query(shapely.points(centres), predicate="dwithin", distance=2 * radii.max() + furthest)
        gaps = np.hypot(*(centres[a] - centres[b]).T) - radii[a] - radii[b]
        # beyond that a pair of small holes may be found where a nearer one of larger holes is not
        a, b, gaps = (of[(a < b) & (gaps <= furthest)] for of in (a, b, gaps))
        if len(a):
            what = f"{between} between two holes"

            def fewer(limit_mm: float) -> str:
                left_out: dict[int, str] = {}
                for i, j in zip(a[gaps < limit_mm].tolist(), b[gaps < limit_mm].tolist(), strict=True):
                    # of a pair whose holes both remain, j is left out
                    if i not in left_out and j not in left_out:
                        left_out[j] = _hole_words(board.holes[j])
                return f"leave out {', '.join(left_out.values())}"

            yield finding(profile, "hole-hole", worst_at(gaps, centres[a]), what, fewer)


def _up(length_mm: float) -> float:
    """Rounded up to the decimals of a hole."""
    # rounded before ceil: a binary fraction just above a decimal would go up by a whole step
    return ceil(round(length_mm * 1e4, 3)) / 1e4


def _hole_words(hole: Sequence[float]) -> str:
    return "--hole " + ",".join(f"{value:.10g}" for value in hole)


def _moved_inward(hole: tuple[float, float, float], board: Board, limit_mm: float) -> tuple[float, float, float]:
    """The hole, moved towards the board's middle until it is `limit_mm` from the outline, at hundredths of a millimetre."""
    x, y, diameter = hole
    middle = np.array(board.size_mm) / 2
    far_mm = limit_mm + diameter / 2
    # on a board narrower than twice that distance both bounds are its middle
    straight = np.clip((x, y), np.minimum(far_mm, middle), np.maximum(np.array(board.size_mm) - far_mm, middle))
    # at a rounded corner the hole also moves along the line to the middle, in steps of a hundredth of it
    for share in np.linspace(0.0, 1.0, 101):  # past a rounded corner
        at = straight + share * (middle - straight)
        # rounded towards the middle, so that the distance is kept
        at = np.where(at < middle, np.ceil(at * 100 - 1e-6), np.floor(at * 100 + 1e-6)) / 100
        if inset_mm(at[None], board.size_mm, board.corner_radius_mm)[0] >= far_mm - TOLERANCE_MM:
            break
    return float(at[0]), float(at[1]), diameter


def hole_to_parts(
    board: Board, profile: FabProfile | ProcessProfile, rule: str, parts_xy_mm: FloatArray, outlines_mm: FloatArray, what: str
) -> Iterator[Finding]:
    """Least distance of a hole from the outlines, shape (m, k, 2), about each part's centre."""
    values, places = [], []
    for x, y, diameter in board.holes:
        # a hole without a part within 5 mm beyond the largest reach is far from every limit
        reach = diameter / 2 + max(reach_mm(outlines_mm.reshape(-1, 2))) + 5.0
        near = parts_xy_mm[np.abs(parts_xy_mm - (x, y)).max(axis=1) < reach]
        if len(near):
            bodies = shapely.polygons(near[:, None, None] + outlines_mm)
            values.append(float(shapely.distance(bodies, shapely.Point(x, y)).min() - diameter / 2))
            places.append((float(x), float(y)))
    if values:
        worst = int(np.argmin(values))
        yield finding(profile, rule, (values[worst], places[worst]), what, "move the hole")


def size_finding(board_mm: tuple[float, float], fab: FabProfile) -> Finding:
    """Check the size of what the fab makes, a tape or a panel."""
    longer, shorter = max(board_mm), min(board_mm)
    most = fab.size.largest_mm
    # the side that is too long in the board's own orientation; the longer one if both or none are
    too_long = [side > limit + TOLERANCE_MM for side, limit in zip((longer, shorter), most, strict=True)]
    passed = not any(too_long)
    value, limit = (shorter, most[1]) if too_long == [False, True] else (longer, most[0])
    least = (min(longer, most[0]), min(shorter, most[1]))
    smaller = least if board_mm[0] >= board_mm[1] else least[::-1]
    message = (
        f"board {longer:g} x {shorter:g} mm {'is within' if passed else 'exceeds'} {most[0]:g} x {most[1]:g} mm of {fab.name}"
    )
    return Finding(
        rule="size",
        level=fab.size.level,
        passed=passed,
        value=value,
        limit=limit,
        **cited(fab.size),
        message=message if passed else f"{message}; ask the fab, or use --size {smaller[0]:g}x{smaller[1]:g}",
    )
