"""Planning of a tape: outline, strip and margins determine the grid. Every value of Tape is decided here.

`plan` is for parts with lands on a film, `plan_texture` for solid elements on a base.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor

import numpy as np

from tactape_fab.base.errors import Problem, ReachProblem, SpecError, refusal
from tactape_fab.kit.outlines import copper_outline, element_outline, part_outlines
from tactape_fab.kit.profiles import ElementProfile, FabProfile, PartProfile, ProcessProfile
from tactape_fab.kit.spec.board_options import no_tag
from tactape_fab.kit.spec.grid_options import code_of_reach
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.board import LONGEST_MM, TAG_FAMILY, Board, Tag
from tactape_fab.texture.code import Code, get_code
from tactape_fab.texture.frames import DIRECTIONS_XY, BoolArray, FloatArray, SymbolArray, snap_mm, texture_to_board
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import inset_mm, reach_mm
from tactape_fab.texture.tag import SIDE_CELLS
from tactape_fab.texture.tape import Tape

TAG_KEEP_OUT_MM = 0.5
"""Free film between the tag's light ring and the outline, and between the ring and the field, mm."""
TAG_RAISE_MM = 1.0
"""Distance of the tag's light ring from the lower edge, mm."""
ORIGIN_STEP_MM = 0.1
TOLERANCE_MM = 0.0005
"""A limit is met if value >= limit - 0.5 um."""
_STEP_SLACK = 1e-6
ELEMENT_KEYS = ("part", "body_mm", "dome_top_mm", "rotation_deg", "pitch_mm", "displacement_mm")
"""Keys of a spec that decide its elements and their distances."""
_FILM_KEYS = (*ELEMENT_KEYS, "fab", "coverlay", "anchor", "tag", "tag_cell_mm")
_TEXTURE_KEYS = (*ELEMENT_KEYS, "process")


def strip_width_mm(spec: TapeSpec) -> float:
    """Width of the tag strip at the left end, mm; 0 without a strip."""
    return SIDE_CELLS * spec.tag_cell_mm + 2 * TAG_KEEP_OUT_MM if spec.tag == "strip" else 0.0


Rule = tuple[FloatArray, float]
"""An outline about the part's centre, and its least distance from the board's outline or from holes (mm)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Claim:
    """Clearances of a part: rules for the distance of its outlines from the board's outline and from holes.

    ``widest`` is the outline that keeps clear of the strip. ``needs`` are the keys of a spec on which
    these values depend.
    """

    edge: tuple[Rule, ...]
    hole: tuple[Rule, ...]
    widest: FloatArray
    needs: tuple[str, ...]
    ink_edge_mm: float = 0.0

    @property
    def furthest_mm(self) -> float:
        """Largest distance from a part's centre within which the board's outline can break a rule, mm."""
        return max(reach_mm(self.widest)) + max(limit for _, limit in self.edge)


def film_claim(spec: TapeSpec, fab: FabProfile, part: PartProfile) -> Claim:
    """Clearances of a part with lands, by the fab's rules for copper, body and opening."""
    outlines = part_outlines(part, fab, spec.rotation_deg)
    anchored = spec.anchor != "none" and fab.coverlay_mode != "gang"
    copper = copper_outline(outlines, fab, spec.rotation_deg, anchored=anchored)
    limit = {rule: fab.limits[rule].value_mm for rule in ("pad-edge", "body-edge", "opening-edge", "hole-copper", "hole-part")}
    return Claim(
        edge=(
            (copper, limit["pad-edge"]),
            (outlines.body, limit["body-edge"]),
            (outlines.opening, limit["opening-edge"]),
        ),
        hole=(
            (copper, limit["hole-copper"]),
            (outlines.body, limit["hole-part"]),
            (outlines.opening, limit["hole-copper"]),
        ),
        widest=outlines.opening,
        needs=_FILM_KEYS,
        ink_edge_mm=fab.legend.edge_mm,
    )


def element_claim(part: ElementProfile, process: ProcessProfile, rotation_deg: float) -> Claim:
    """Clearances of a solid element's foot, by the rules of its process."""
    foot = element_outline(part.shape, part.body_mm, rotation_deg)
    return Claim(
        edge=((foot, process.limits["body-edge"].value_mm),),
        hole=((foot, process.limits["hole-part"].value_mm),),
        widest=foot,
        needs=_TEXTURE_KEYS,
    )


def field_margins_mm(claim: Claim, displacement_mm: float) -> tuple[float, float]:
    """Least distance of a grid point from the outline along x and y, mm, such that its part displaced outward meets all rules."""
    # at a straight side only the outline's reach along that axis matters
    x, y = (max(reach_mm(outline)[axis] + limit for outline, limit in claim.edge) for axis in (0, 1))
    return x + displacement_mm, y + displacement_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class _Grid:
    """Place of the grid on the board, and its number of points."""

    texture_origin_mm: tuple[float, float]
    columns: int
    rows: int


def _grid(size_mm: tuple[float, float], spec: TapeSpec, claim: Claim) -> _Grid:
    width_mm, height_mm = size_mm
    margin_x_mm, margin_y_mm = field_margins_mm(claim, spec.displacement_mm)
    clear_of_strip_mm = strip_width_mm(spec) + reach_mm(claim.widest)[0] + spec.displacement_mm
    first_x_mm = max(margin_x_mm, clear_of_strip_mm if spec.tag == "strip" else 0.0)
    # the slack keeps a first column that is a multiple of the step in
    # decimal from being rounded up a step by its binary fraction
    x0_mm = ceil(first_x_mm / ORIGIN_STEP_MM - _STEP_SLACK) * ORIGIN_STEP_MM
    # n points take (n - 1) pitches between two margins, each of which may be short by the tolerance
    rows = floor((height_mm - 2 * margin_y_mm + 2 * TOLERANCE_MM) / spec.pitch_mm) + 1
    return _Grid(
        # row 0 is the uppermost; the rows are centred on the board's height
        texture_origin_mm=(float(snap_mm(x0_mm)), float(snap_mm((height_mm + (rows - 1) * spec.pitch_mm) / 2))),
        columns=floor((width_mm - margin_x_mm - x0_mm + TOLERANCE_MM) / spec.pitch_mm) + 1,
        rows=rows,
    )


def plan(spec: TapeSpec, fab: FabProfile, part: PartProfile, avoid: Sequence[Tape] | None = ()) -> Tape:
    """Plan a tape of parts with lands.

    avoid: Tapes from which a design has to differ; None for random symbols in place of a design, which takes seconds, if the
        tape is refused and only measured.

    Grid point (0, 0) is at board ``(x0, y0)``: ``x0`` is the strip's width plus the reach of an opening displaced outward
    (without a strip the margin), rounded up to 0.1 mm, and ``y0 = (height + (rows - 1) * pitch) / 2``. The grid has as many
    columns and rows as the margins allow; the remaining width is at the right end.

    Raises SpecError if not even one window of the code fits, or the tag does not.
    Raises CapacityError if the grid exceeds the code's range.
    """
    tape_part = TapePart(name=part.name, shape=part.shape, body_mm=part.body_mm, rotation_deg=spec.rotation_deg)
    tape = _plan(spec, film_claim(spec, fab, part), tape_part, fab.material.thickness_mm, avoid)
    return replace(tape, board=replace(tape.board, flexible=fab.bend is not None))


def plan_texture(spec: TapeSpec, process: ProcessProfile, part: ElementProfile, avoid: Sequence[Tape] | None = ()) -> Tape:
    """Plan a texture of solid elements on a base of the spec's thickness; the grid is as in `plan`, without strip.

    Raises SpecError, CapacityError as `plan`.
    """
    assert spec.base_mm is not None
    tape_part = TapePart(
        name=part.name, shape=part.shape, body_mm=part.body_mm, rotation_deg=spec.rotation_deg, top_mm=part.top_mm
    )
    return _plan(spec, element_claim(part, process, spec.rotation_deg), tape_part, spec.base_mm, avoid)


def film_size_mm(spec: TapeSpec, fab: FabProfile, part: PartProfile) -> tuple[float, float]:
    """The spec's outline; if no window of the code fits in it, enlarged along each axis until one does, mm."""
    return _holding(spec, film_claim(spec, fab, part))


def texture_size_mm(spec: TapeSpec, process: ProcessProfile, part: ElementProfile) -> tuple[float, float]:
    """As `film_size_mm`, for a texture of solid elements."""
    return _holding(spec, element_claim(part, process, spec.rotation_deg))


def _holding(spec: TapeSpec, claim: Claim) -> tuple[float, float]:
    code = get_code(spec.code)
    if not any(_size_problems(spec, code, _grid(spec.size_mm, spec, claim), claim)):
        return spec.size_mm
    least = _least_size_mm(spec, code, claim)
    return max(spec.size_mm[0], least[0]), max(spec.size_mm[1], least[1])


def _symbols(
    spec: TapeSpec, origin: tuple[int, int], grid: _Grid, part: TapePart | None, avoid: Sequence[Tape] | None
) -> SymbolArray:
    """The code's symbols for a grid; a design differs from the tapes in `avoid`."""
    shape = (grid.rows, grid.columns)
    if avoid is None and get_code(spec.code).plane is None:
        # seed 0, so that the findings of a refused tape are reproducible
        return np.random.default_rng(0).integers(spec.directions, size=shape, dtype=np.uint8)
    others = [tape.symbols for tape in avoid or ()]
    long = part is not None and part.open_turns_deg == (0, 180)
    return get_code(spec.code).symbols(spec.sector, origin, shape, others, spec.directions, half_turns=long)


def _plan(spec: TapeSpec, claim: Claim, part: TapePart, thickness_mm: float, avoid: Sequence[Tape] | None) -> Tape:
    code = get_code(spec.code)
    grid = _grid(spec.size_mm, spec, claim)
    problems = list(_size_problems(spec, code, grid, claim)) or list(_tag_problems(spec, claim.ink_edge_mm))
    problems += _reach_problems(spec, code, grid, claim)
    if problems:
        raise refusal(problems)
    symbols = _symbols(spec, spec.place, grid, part, avoid)
    board = Board(
        size_mm=spec.size_mm,
        texture_origin_mm=grid.texture_origin_mm,
        corner_radius_mm=spec.corner_radius_mm,
        thickness_mm=thickness_mm,
        holes=tuple(spec.holes_mm),
    )
    free = _placeable(spec, board, claim, symbols)
    if not _has_window(free, code):
        raise SpecError(
            Problem(
                "holes_mm",
                f"holes and corners leave no whole {code.window}x{code.window} window of code '{code.name}' on the tape; "
                "use fewer holes, a smaller --corner-radius or a larger tape",
                needs=(*claim.needs, "code", "size_mm", "corner_radius_mm"),
            )
        )
    return Tape(
        name=spec.name,
        sector=spec.sector,
        code=spec.code,
        origin=spec.place,
        columns=grid.columns,
        rows=grid.rows,
        pitch_mm=spec.pitch_mm,
        displacement_mm=spec.displacement_mm,
        symbols=symbols,
        omitted=np.argwhere(~free)[:, ::-1].astype(np.int64),
        board=board,
        part=part,
        tag=_plan_tag(spec),
        directions=spec.directions,
    )


def _has_window(free: BoolArray, code: Code) -> bool:
    """Whether the placed parts contain at least one whole window of the code."""
    if min(free.shape) < code.window:
        return False
    # whether any k x k block of the mask is completely placed
    return bool(np.lib.stride_tricks.sliding_window_view(free, (code.window, code.window)).all(axis=(2, 3)).any())


def _holds(spec: TapeSpec, code: Code, claim: Claim) -> bool:
    """Whether a window of the code fits in the outline with its rounded corners."""
    least = _least_size_mm(spec, code, claim)
    return all(side >= least_mm - TOLERANCE_MM for side, least_mm in zip(spec.size_mm, least, strict=True))


def _size_problems(spec: TapeSpec, code: Code, grid: _Grid, claim: Claim) -> Iterator[Problem]:
    least_height_mm = _strip_height_mm(spec)
    fits = grid.columns >= code.window and grid.rows >= code.window
    if fits and spec.size_mm[1] >= least_height_mm - TOLERANCE_MM:
        return
    least = _least_size_mm(spec, code, claim)
    what = "a strip with a tag and " if spec.tag == "strip" else ""
    yield Problem(
        "size_mm",
        f"size_mm = {spec.size_mm[0]:g} x {spec.size_mm[1]:g} mm is too small: {what}one {code.window}x{code.window} window "
        f"of code '{code.name}' at pitch {spec.pitch_mm:g} mm needs {least[0]:g} x {least[1]:g} mm; use --size "
        f"{max(spec.size_mm[0], least[0]):g}x{max(spec.size_mm[1], least[1]):g}"
        + (
            f", or {no_tag(spec.tag_id, spec.sector)}"
            if spec.tag == "strip" and _holds(spec.with_values(tag="none", tag_id=None), code, claim)
            else ""
        ),
        needs=(*claim.needs, "code", "corner_radius_mm"),
    )


def _strip_height_mm(spec: TapeSpec) -> float:
    """Least height of a tape that holds its tag, mm; 0 without a tag."""
    return SIDE_CELLS * spec.tag_cell_mm + TAG_RAISE_MM + TAG_KEEP_OUT_MM if spec.tag == "strip" else 0.0


def _least_size_mm(spec: TapeSpec, code: Code, claim: Claim) -> tuple[float, float]:
    """The smallest size, in tenths of a millimetre, whose field holds a window of the code, and whose strip holds the tag, with
    rounded corners taken into account.
    """
    margin_x_mm, margin_y_mm = field_margins_mm(claim, spec.displacement_mm)
    field_mm = (code.window - 1) * spec.pitch_mm
    x0_mm = _grid(spec.size_mm, spec, claim).texture_origin_mm[0]
    # in tenths of a millimetre, as a user would type it; y also holds the strip
    tenths = np.ceil(
        np.array([x0_mm + field_mm + margin_x_mm, max(2 * margin_y_mm + field_mm, _strip_height_mm(spec))]) * 10 - _STEP_SLACK
    )
    cut = _cuts_tag(spec, (LONGEST_MM, LONGEST_MM), claim)  # true at any size: another problem
    # without rounded corners this is a lower bound; corners may omit parts
    # of the window, and the board grows until none is missing
    while True:
        size_mm = (float(tenths[0]) / 10, float(tenths[1]) / 10)
        grid = _grid(size_mm, spec, claim)
        board = Board(
            size_mm=size_mm,
            texture_origin_mm=grid.texture_origin_mm,
            corner_radius_mm=spec.corner_radius_mm,
            thickness_mm=1.0,
        )
        # the origin is moved so that the grid stays in the code plane, as the size does not depend on it
        origin = (min(spec.place[0], code.range - grid.columns), min(spec.place[1], code.range - grid.rows))
        symbols = _symbols(spec, origin, grid, None, ())
        whole = min(size_mm) >= 2 * spec.corner_radius_mm and (cut or not _cuts_tag(spec, size_mm, claim))
        if whole and _has_window(_placeable(spec, board, claim, symbols), code):
            return size_mm
        tenths += 1


def _reach_problems(spec: TapeSpec, code: Code, grid: _Grid, claim: Claim) -> Iterator[Problem]:
    if grid.columns * grid.rows > code.most_points:
        name = code_of_reach((grid.columns, grid.rows), spec.sector, spec.directions)
        other = f", or --code {name}" if name else ""
        yield ReachProblem(
            "size_mm",
            f"size_mm = {spec.size_mm[0]:g} x {spec.size_mm[1]:g} mm gives {grid.columns} x {grid.rows} grid points, more than "
            f"the {code.most_points} of a tape of code '{code.name}'; use a smaller --size{other}",
            needs=(*claim.needs, "code"),
        )
    last = (code.range - grid.columns, code.range - grid.rows)
    within = ",".join(str(max(min(at, most), 0)) for at, most in zip(spec.place, last, strict=True))
    for name, first, count in (("column", spec.place[0], grid.columns), ("row", spec.place[1], grid.rows)):
        if first + count > code.range:
            yield ReachProblem(
                "origin",
                f"origin {name} {first} + {count} {name}s of the tape exceed {code.range}, the range of code "
                f"'{code.name}'; use --origin {within}, with {name} at most {max(code.range - count, 0)}, or a smaller --size",
                needs=(*claim.needs, "code", "sector", "size_mm"),
            )


def _tag_centre_mm(spec: TapeSpec) -> tuple[float, float]:
    half_mm = SIDE_CELLS * spec.tag_cell_mm / 2
    return float(snap_mm(TAG_KEEP_OUT_MM + half_mm)), float(snap_mm(TAG_RAISE_MM + half_mm))


def tag_inside(spec: TapeSpec, radius_mm: float, ink_edge_mm: float) -> bool:
    """Whether the tag's light ring is far enough inside the outline with corners of this radius; true without a tag."""
    ring = np.array(_tag_centre_mm(spec)) + SIDE_CELLS * spec.tag_cell_mm / 2 * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    return spec.tag_id is None or bool(inset_mm(ring, spec.size_mm, radius_mm).min() >= ink_edge_mm - TOLERANCE_MM)


def _tag_problems(spec: TapeSpec, ink_edge_mm: float) -> Iterator[Problem]:
    if tag_inside(spec, spec.corner_radius_mm, ink_edge_mm):
        return
    radii_mm = np.arange(int(spec.corner_radius_mm * 10) + 1) / 10
    # at straight sides the ring may be nearer than the ink may be: no radius does
    rounder = [f"use --corner-radius {radius:g}, or " for radius in radii_mm if tag_inside(spec, radius, ink_edge_mm)][-1:]
    yield Problem(
        "corner_radius_mm",
        f"corner_radius_mm = {spec.corner_radius_mm:g} mm cuts into the tag, whose ring must stay {ink_edge_mm:g} "
        f"mm inside the outline; {''.join(rounder) or 'use '}{no_tag(spec.tag_id, spec.sector)}",
        needs=("fab", "size_mm", "tag", "tag_cell_mm"),
    )


def _cuts_tag(spec: TapeSpec, size_mm: tuple[float, float], claim: Claim) -> bool:
    return any(_tag_problems(spec.with_values(size_mm=size_mm), claim.ink_edge_mm))


def _plan_tag(spec: TapeSpec) -> Tag | None:
    if spec.tag_id is None:
        return None
    return Tag(family=TAG_FAMILY, id=spec.tag_id, cell_mm=spec.tag_cell_mm, center_mm=_tag_centre_mm(spec), rotation_deg=0.0)


def _placeable(spec: TapeSpec, board: Board, claim: Claim, symbols: SymbolArray) -> BoolArray:
    """Mask of grid points whose part meets every edge and hole rule; shape (rows, columns).

    Parts are omitted at rounded corners and holes, not at straight edges, which the margins cover.
    """
    rows, columns = symbols.shape
    row, column = np.indices((rows, columns))
    texture_mm = np.stack([column, row], axis=-1) * spec.pitch_mm + spec.displacement_mm * DIRECTIONS_XY[symbols]
    centre_mm = texture_to_board(texture_mm, board.texture_origin_mm)
    free = np.ones((rows, columns), dtype=bool)
    # A vertex is beside a rounded corner only if both its coordinates are within the radius of the sides, so that its part's
    # centre is within radius plus reach of both; all other parts are beside straight sides, for which the margins were chosen
    corner_zone_mm = board.corner_radius_mm + claim.furthest_mm
    beyond = np.abs(centre_mm - np.array(board.size_mm) / 2) - (np.array(board.size_mm) / 2 - corner_zone_mm)
    near = np.argwhere((beyond > 0.0).all(axis=-1))
    for outline, limit_mm in claim.edge:
        if len(near) == 0:
            break
        vertices = centre_mm[near[:, 0], near[:, 1], None] + outline
        inside = inset_mm(vertices, board.size_mm, board.corner_radius_mm).min(axis=-1)
        free[near[:, 0], near[:, 1]] &= inside >= limit_mm - TOLERANCE_MM
    # distances along the axes are lower bounds of the true ones; the extra
    # millimetre is for spurs, which may end outside the opening
    widest_mm = max(reach_mm(claim.widest)) + max(limit for _, limit in claim.hole) + 1.0
    for x_mm, y_mm, diameter_mm in board.holes:
        near = np.argwhere(np.abs(centre_mm - (x_mm, y_mm)).max(axis=-1) < diameter_mm / 2 + widest_mm)
        for outline, limit_mm in claim.hole:
            # the hole's centre in the frame of each part: one outline, many points
            gap = _distance_mm(outline, np.array([x_mm, y_mm]) - centre_mm[near[:, 0], near[:, 1]]) - diameter_mm / 2
            free[near[:, 0], near[:, 1]] &= gap >= limit_mm - TOLERANCE_MM
    return free


def _distance_mm(outline_mm: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    """Distance of points from the convex hull of an outline, mm; 0 inside."""
    import shapely

    return np.asarray(shapely.distance(shapely.MultiPoint(outline_mm).convex_hull, shapely.points(points_mm)))
