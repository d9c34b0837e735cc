"""Anchors: copper that extends from each pad under the coverlay, either spurs alone or spurs connected by a mesh of webs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import sqrt

import numpy as np
import shapely

from tactape_fab.kit.film.coverlay import Mode, least_pitch_mm, whole_um_up
from tactape_fab.kit.outlines import PartOutlines, spur_tips
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import FabProfile, LandPattern
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray, snap_mm, texture_to_board
from tactape_fab.texture.shapes import inset_mm, rotate
from tactape_fab.texture.tape import Tape

_REACHES_MM = (0.3, 0.6, 2.0, 20.0)
"""Search radii for the nearest shapes, tried in this order."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Anchors:
    """Copper lines of the anchors.

    mode: ``spur`` or ``mesh``.
    web_mm: Width of every line.
    spurs_mm (2 n, 2, 2): From the centre of each pad outward; R1 land 1, R1 land 2, R2 land 1 ...
    webs_mm (m, 2, 2): The mesh between the openings; empty for spurs.
    """

    mode: str
    web_mm: float
    spurs_mm: FloatArray
    webs_mm: FloatArray

    @property
    def lines_mm(self) -> FloatArray:
        """All lines, shape (2 n + m, 2, 2)."""
        return np.concatenate([self.spurs_mm, self.webs_mm])


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorPlan:
    """Parameters that decide the anchors of a tape, as its manifest records them."""

    mode: str
    web_mm: float
    opening_mm: float
    tip_mm: float
    pad_edge_mm: float
    hole_copper_mm: float


def anchor_plan(mode: str, fab: FabProfile, outlines: PartOutlines) -> AnchorPlan:
    """The anchor values of a fab profile."""
    return AnchorPlan(
        mode=mode,
        web_mm=fab.anchor.web_mm,
        opening_mm=clearance_mm(fab),
        tip_mm=float(np.hypot(*spur_tips(outlines.opening_size_mm, fab, 0.0)[1])),
        pad_edge_mm=fab.limits["pad-edge"].value_mm,
        hole_copper_mm=fab.limits["hole-copper"].value_mm,
    )


def clearance_mm(fab: FabProfile) -> float:
    """Clearance of a line from openings of other parts, such that the copper gap to the pads in them holds as well."""
    # an opening extends one expansion beyond its pad: a line c from the opening is c + expansion from the copper
    return max(fab.anchor.opening_mm, fab.limits["pad-pad"].value_mm - fab.coverlay_expansion_mm)


def build_anchors(plan: AnchorPlan, tape: Tape, pads: LandPattern) -> Anchors:
    """Draw the anchors of every placed part.

    A spur runs along its part, out of the opening. The webs of a mesh form a brick pattern: lines half way between the diagonals
    of the grid, with ties across them where two parts face each other, and every spur is extended to its tie. Webs too near to
    the outline or a hole are left out; a spur without a tie has the same length as without a mesh.
    """
    rotation_deg = tape.part.rotation_deg
    axis = rotate((1.0, 0.0), rotation_deg)
    # land 1 is at -axis and land 2 at +axis, as in `part_outlines`; shapes (n, 2, 2): part, land, xy
    ends = np.array([-1.0, 1.0])
    centres = tape.part_xy_mm()
    start = centres[:, None] + ends[:, None] * pads.offset_mm * axis
    tip = centres[:, None] + ends[:, None] * plan.tip_mm * axis
    webs = np.empty((0, 2, 2))
    if plan.mode == "mesh":
        webs, tied, tie_mm = _mesh(plan, tape)
        # the tie is a line across the axis at tie_mm: a displaced part meets it at most Δ sin 45 deg (with eight directions Δ)
        # from the tie's middle, and the tie extends W/sqrt(8) to each side
        on = tie_mm - (centres @ axis)[:, None]
        tip = np.where(tied[..., None], centres[:, None] + on[..., None] * axis, tip)
    spurs = np.stack([start, tip], axis=2).reshape(-1, 2, 2)
    return Anchors(mode=plan.mode, web_mm=plan.web_mm, spurs_mm=snap_mm(spurs), webs_mm=snap_mm(webs))


def _mesh(plan: AnchorPlan, tape: Tape) -> tuple[FloatArray, np.ndarray, FloatArray]:
    """Webs (m, 2, 2) in the board frame; whether each pad's tie exists; its distance along the part. Shapes (n, 2)."""
    rotation_deg, half_mm = tape.part.rotation_deg, tape.pitch_mm / sqrt(2)
    origin = np.array(tape.board.texture_origin_mm)
    # Along and across the parts, which are at 45 degrees, the grid point (c, r) is at W/sqrt(2) (c - r) and W/sqrt(2) (c + r), up
    # to signs. In units of (W/sqrt(2), W/sqrt(8)) it is a pair (i, j) of integers, j even, with neighbours of one diagonal 2
    # apart in i. Odd j are the lines half way between two diagonals; i +- 1 is half way to the facing part. rint removes only the
    # rounding of the rotation
    points = texture_to_board(tape.cells() * tape.pitch_mm, (0.0, 0.0))
    i, j = np.rint(rotate(points, -rotation_deg) / (half_mm, half_mm / 2)).astype(np.int64).T
    sides = [(i + a, j + b, i + a + 1, j + b) for a in (-1, 0) for b in (-1, 1)]
    ties = [(i + a, j - 1, i + a, j + 1) for a in (-1, 1)]
    # rows (i, j, i, j): both ends of each web; first the ties at i - 1 of all parts, then those at i + 1, then the sides
    of_parts: IntArray = np.concatenate([np.column_stack(edge) for edge in [*ties, *sides]])
    # a web between two cells is listed by both and drawn once; `which` maps each row to its web
    edges, which = np.unique(of_parts, axis=0, return_inverse=True)
    lattice = edges.reshape(-1, 2, 2) * (half_mm, half_mm / 2)
    webs = rotate(lattice, rotation_deg) + origin
    kept = _clear_of_outline_and_holes(plan, tape, webs)
    # the first 2 n rows are the ties; (2, n) becomes (n, 2), one column for each land
    tied = kept[which.ravel()[: 2 * len(i)]].reshape(2, -1).T
    # the lattice's coordinates start at grid point (0, 0), whose own place along the axis is added
    along = float(origin @ rotate((1.0, 0.0), rotation_deg))
    return webs[kept], tied, np.column_stack([i - 1, i + 1]) * half_mm + along


def _clear_of_outline_and_holes(plan: AnchorPlan, tape: Tape, webs_mm: FloatArray) -> np.ndarray:
    board = tape.board
    # the outline is convex, so a segment inside is nearest to it at one of its ends
    inside = inset_mm(webs_mm, board.size_mm, board.corner_radius_mm).min(axis=1) - plan.web_mm / 2
    kept = inside >= plan.pad_edge_mm - TOLERANCE_MM
    # a segment may be nearest to a hole anywhere along it
    lines = shapely.linestrings(webs_mm)
    for x, y, diameter in board.holes:
        gap = shapely.distance(lines, shapely.Point(x, y)) - (diameter + plan.web_mm) / 2
        kept &= gap >= plan.hole_copper_mm - TOLERANCE_MM
    return np.asarray(kept)


def foreign_openings_mm(anchors: Anchors, parts_xy_mm: FloatArray, opening_mm: FloatArray) -> tuple[float, FloatArray]:
    """Least distance of the copper lines from openings of other parts, mm, and its place; inf if none is near."""
    boxes = shapely.polygons(parts_xy_mm[:, None] + opening_mm)
    return nearest_foreign(anchors, boxes)


def nearest_foreign(anchors: Anchors, openings: np.ndarray) -> tuple[float, FloatArray]:
    """As `foreign_openings_mm`, with the openings as polygons in designator order."""
    lines = shapely.linestrings(anchors.lines_mm)
    # each part has two spurs; a web belongs to no part, so that it is measured against every opening
    owner = np.concatenate([np.arange(len(anchors.spurs_mm)) // 2, np.full(len(anchors.webs_mm), -1)])
    gap_mm, line = _least_gap(lines, openings, lambda line, box: owner[line] != box, anchors.web_mm / 2)
    return gap_mm, np.zeros(2) if line is None else anchors.lines_mm[line].mean(axis=0)


def foreign_pads_mm(anchors: Anchors, pads_mm: FloatArray) -> float:
    """Least distance of the copper lines from pads of other parts, and of webs from any, mm; inf if none is near.

    pads_mm (2 n, k, 2): Outlines of all pads; R1 land 1, R1 land 2, R2 land 1 ...
    """
    pads = shapely.multipolygons(shapely.polygons(pads_mm), indices=np.arange(len(pads_mm)) // 2)
    return nearest_foreign(anchors, pads)[0]


def between_spurs_mm(anchors: Anchors) -> tuple[float, FloatArray]:
    """Least gap between spurs of two parts, mm, and its place; inf if no two are near. Not for a mesh, which connects them."""
    lines = shapely.linestrings(anchors.spurs_mm)
    gap_mm, spur = _least_gap(lines, lines, lambda a, b: a // 2 < b // 2, anchors.web_mm)
    return gap_mm, np.zeros(2) if spur is None else anchors.spurs_mm[spur, 1]


def _least_gap(
    lines: np.ndarray, others: np.ndarray, counts: Callable[[IntArray, IntArray], BoolArray], wide_mm: float
) -> tuple[float, int | None]:
    """Least distance of a line from the others less `wide_mm`, mm, and the line's index; inf and None if no two are near.

    counts: Gives a mask of the pairs to consider, from the indices of line and other.
    """
    tree = shapely.STRtree(others)
    # dwithin finds all pairs within the radius: as soon as one counts, the least distance among them is the overall least
    for reach in _REACHES_MM:  # the first one nearly always contains the least distance
        line, other = tree.query(lines, predicate="dwithin", distance=reach)
        kept = counts(line, other)
        line, other = line[kept], other[kept]
        if len(line):
            gap = shapely.distance(lines[line], others[other]) - wide_mm
            worst = int(np.argmin(gap))
            return float(gap[worst]), int(line[worst])
    return float("inf"), None


@dataclass(frozen=True, slots=True, kw_only=True)
class Placing:
    """Parameters of the placement on the grid other than the pitch."""

    rotation_deg: float
    displacement_mm: float
    directions: int


def anchor_pitch_mm(
    name: str, fab: FabProfile, outlines: PartOutlines, pads: LandPattern, placing: Placing, *, copper_mm: float | None = None
) -> float | None:
    """Least pitch, mm, at which spurs or mesh are legal for any symbols; None if at no pitch.

    ``copper_mm`` is the gap between spurs of two parts, by default the fab's limit.
    """
    rotation_deg, displacement_mm = placing.rotation_deg, placing.displacement_mm
    # a, b: length and width of an opening; clear: from its edge to the middle of a line
    rules, (a, b) = fab.anchor, outlines.opening_size_mm
    clear = clearance_mm(fab) + rules.web_mm / 2
    if name == "mesh":
        if rotation_deg % 90.0 != 45.0:
            return None
        # A side web runs W/sqrt(8) beside the parts' axes, a tie W/sqrt(2) from their middles. An opening displaced by s across
        # or along needs b/2 + s, or a/2 + s, of that: W >= sqrt(8) (clear + b/2 + s), W >= sqrt(2) (clear + a/2 + s), where
        # sqrt(2) s is Δ (|x| + |y|) of the unit displacement, sqrt(2) times its component along a diagonal of the grid
        sideways_mm = displacement_mm * DIRECTIONS[placing.directions].reach_diagonal
        return max(sqrt(2) * (2 * clear + b) + 2 * sideways_mm, sqrt(2) * (clear + a / 2) + sideways_mm)
    plan = anchor_plan("spur", fab, outlines)
    # a spur as a segment along the part: half its length, and the distance of its middle from the part's
    half, middle = (plan.tip_mm - pads.offset_mm) / 2, (plan.tip_mm + pads.offset_mm) / 2
    apart = (fab.limits["pad-pad"].value_mm if copper_mm is None else copper_mm) + rules.web_mm
    of_symbols = partial(least_pitch_mm, directions=placing.directions)
    # The forbidden shifts of a neighbour are the Minkowski sum of the two shapes: for opening and segment a box of half sides
    # a/2 + half and b/2 about the spur's middle, for two segments a segment of twice their half length. Neighbours and pairs of
    # symbols occur with both signs, so that the part's other spur needs no box of its own
    return max(
        of_symbols((half + a / 2, b / 2), clear, rotation_deg, displacement_mm, (middle, 0.0)),
        # spurs at opposite ends (the middles 2 middle apart), then at equal ends of two parts
        of_symbols((2 * half, 0.0), apart, rotation_deg, displacement_mm, (2 * middle, 0.0)),
        of_symbols((2 * half, 0.0), apart, rotation_deg, displacement_mm),
    )


def anchor_modes(fab: FabProfile, outlines: PartOutlines, pads: LandPattern, tape: Tape) -> tuple[Mode, ...]:
    """Least pitch, mm, at which spurs and mesh are legal for any symbols."""
    placing = Placing(rotation_deg=tape.part.rotation_deg, displacement_mm=tape.displacement_mm, directions=tape.directions)
    return tuple(_judged(name, anchor_pitch_mm(name, fab, outlines, pads, placing), fab, tape) for name in ("spur", "mesh"))


def _judged(name: str, pitch_mm: float | None, fab: FabProfile, tape: Tape) -> Mode:
    if pitch_mm is None:
        return Mode(name=name, legal=False, least_pitch_mm=None, reason="its webs lie along the parts")
    least = whole_um_up(pitch_mm)
    if fab.coverlay_mode == "gang":
        reason = "in coverlay mode gang there is no coverlay to hold an anchor"
        return Mode(name=name, legal=False, least_pitch_mm=None, reason=reason)
    legal = tape.pitch_mm >= pitch_mm - TOLERANCE_MM
    web = f"webs of {fab.anchor.web_mm:g} mm with {clearance_mm(fab):g} mm to each opening"
    return Mode(name=name, legal=legal, least_pitch_mm=least, reason=f"{web} need W of at least {least:.3f} mm")
