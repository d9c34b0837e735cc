"""plan: the grid is as large as the edge rules allow and no larger, measured with geometry of its own; holes and corners
take away exactly the parts that come too near; a size that is refused comes with one that works.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tactape_fab import Tape, TapeSpec
from tactape_fab.base.errors import CapacityError, SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import FabProfile, load_fab, load_part
from tactape_fab.kit.rules.spacing import check

FAB = load_fab("generic-fpc")
PART = load_part("r0201")
TOLERANCE_MM = 0.0005
ROUNDING_MM = 2e-6
"""Coordinates are whole nanometres."""
PAD_ARC_MM = 0.6e-3
"""How far the polyline of a pad's corner lies inside its arc."""
PART_REACH_MM = 1.0
"""No shape of a part reaches further from its centre."""
STEP = {"N": (0.0, 1.0), "S": (0.0, -1.0), "W": (-1.0, 0.0), "E": (1.0, 0.0)}
"""Direction of each letter in the board frame."""

Floats = npt.NDArray[np.float64]
Shapes = npt.NDArray[Any]


# Geometry of one part, drawn here from the profile's numbers alone


def turned(xy: Floats, rotation_deg: float) -> Floats:
    a = np.radians(rotation_deg)
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([x * np.cos(a) - y * np.sin(a), x * np.sin(a) + y * np.cos(a)], axis=-1)


def rectangle(length_mm: float, width_mm: float, at_mm: tuple[float, float] = (0.0, 0.0), radius_mm: float = 0.0) -> Floats:
    box = shapely.box(-length_mm / 2, -width_mm / 2, length_mm / 2, width_mm / 2)
    if radius_mm:
        box = box.buffer(-radius_mm, join_style="mitre").buffer(radius_mm, quad_segs=16)
    outline: Floats = np.array(box.exterior.coords, dtype=np.float64) + np.array(at_mm)
    return outline


def repeated(outline_mm: Floats, centres_mm: Floats) -> Shapes:
    return np.asarray(shapely.polygons(centres_mm[:, None] + outline_mm))


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Shapes of every part: each array of length n, pads as two arrays in one of shape (2, n)."""

    body: Shapes
    largest_body: Shapes
    courtyard: Shapes
    opening: Shapes
    pads: Shapes


def draw(centres_mm: Floats, rotation_deg: float, fab: FabProfile = FAB) -> Drawn:
    def shapes(outline: Floats) -> Shapes:
        return repeated(turned(outline, rotation_deg), centres_mm)

    length, width, _ = PART.body_mm
    pad = PART.pads
    wider = 2 * fab.coverlay_expansion_mm
    tolerance = PART.body_tolerance_mm
    lands = [rectangle(*pad.size_mm, (s * pad.offset_mm, 0.0), pad.corner_radius_mm) for s in (-1, 1)]
    return Drawn(
        body=shapes(rectangle(length, width)),
        largest_body=shapes(rectangle(length + tolerance, width + tolerance)),
        courtyard=shapes(rectangle(*PART.courtyard_mm)),
        opening=shapes(rectangle(2 * pad.offset_mm + pad.size_mm[0] + wider, pad.size_mm[1] + wider)),
        pads=np.stack([shapes(land) for land in lands]),
    )


def grid_centres(tape: Tape) -> Floats:
    """Displaced centre of every grid point, omitted ones too, row-major; board frame, mm."""
    mapping = tape.to_mapping()
    x0, y0 = mapping["board"]["texture_origin_mm"]
    pitch, displacement = mapping["pitch_mm"], mapping["displacement_mm"]
    return np.array(
        [
            (x0 + c * pitch + displacement * STEP[letter][0], y0 - r * pitch + displacement * STEP[letter][1])
            for r, row in enumerate(mapping["symbols"])
            for c, letter in enumerate(row)
        ]
    )


def placed_mask(tape: Tape) -> npt.NDArray[np.bool_]:
    omitted = {(c, r) for c, r in tape.to_mapping()["omitted"]}
    return np.array([(c, r) not in omitted for r in range(tape.rows) for c in range(tape.columns)])


def board_shape(tape: Tape) -> shapely.Polygon:
    (width, height), radius = tape.board.size_mm, tape.board.corner_radius_mm
    if radius == 0.0:
        return shapely.box(0.0, 0.0, width, height)
    return shapely.box(radius, radius, width - radius, height - radius).buffer(radius, quad_segs=256)


def edge_gap(shapes: Shapes, board: shapely.Polygon) -> Floats:
    """Distance of shapes from the outline, negative where they reach over it."""
    distance: Floats = shapely.distance(board.exterior, shapes)
    return np.where(shapely.covers(board, shapes), distance, -distance)


def edge_margins(centres_mm: Floats, tape: Tape, fab: FabProfile = FAB) -> Floats:
    """By how much each part keeps the strictest of its edge rules, +inf far from every edge; shape (n,)."""
    board = board_shape(tape)
    limits = {rule: fab.limits[rule].value_mm for rule in ("body-edge", "pad-edge", "opening-edge")}
    near = edge_gap(np.asarray(shapely.points(centres_mm)), board) < max(limits.values()) + PART_REACH_MM
    drawn = draw(centres_mm[near], tape.part.rotation_deg, fab)
    margins = np.full(len(centres_mm), np.inf)
    margins[near] = np.minimum.reduce(
        [
            edge_gap(drawn.body, board) - limits["body-edge"],
            edge_gap(drawn.opening, board) - limits["opening-edge"],
            *(edge_gap(land, board) - limits["pad-edge"] for land in drawn.pads),
        ]
    )
    return margins


def hole_margins(centres_mm: Floats, tape: Tape, fab: FabProfile = FAB) -> Floats:
    """By how much each part keeps the strictest of its hole rules; shape (n,)."""
    drawn = draw(centres_mm, tape.part.rotation_deg, fab)
    copper, body = fab.limits["hole-copper"].value_mm, fab.limits["hole-part"].value_mm
    margins = np.full(len(centres_mm), np.inf)
    for x, y, diameter in tape.board.holes:
        hole = shapely.Point(x, y)
        for shapes, limit in ((drawn.body, body), (drawn.opening, copper), (drawn.pads[0], copper), (drawn.pads[1], copper)):
            margins = np.minimum(margins, shapely.distance(hole, shapes) - diameter / 2 - limit)
    return margins


def tape_of(fab: FabProfile = FAB, **values: Any) -> Tape:
    return plan(TapeSpec(**{"sector": 7, **values}), fab, PART)


def with_limits(**values_mm: float) -> FabProfile:
    limits = dict(FAB.limits)
    for rule, value_mm in values_mm.items():
        limits[rule.replace("_", "-")] = replace(limits[rule.replace("_", "-")], value_mm=value_mm)
    return replace(FAB, limits=limits)


# The main job


def test_the_main_job() -> None:
    tape = tape_of()
    assert (tape.columns, tape.rows) == (62, 32)
    assert tape.board.texture_origin_mm == (6.9, 48.25)
    assert tape.board.thickness_mm == 0.11
    assert len(tape.omitted) == 0
    assert tape.tag is not None
    assert (tape.tag.id, tape.tag.center_mm, tape.tag.rotation_deg) == (7, (3.0, 3.5), 0.0)


def test_bodies_of_the_main_job_stay_a_millimetre_inside() -> None:
    tape = tape_of()
    gaps = edge_gap(draw(grid_centres(tape), 45.0).body, board_shape(tape))
    assert len(gaps) == 62 * 32
    assert gaps.min() >= 1.0
    assert gaps.min() == pytest.approx(1.032, abs=0.0005)


# The grid fills what the edge rules leave

SIZES = st.tuples(st.integers(200, 2000), st.integers(200, 1000)).map(lambda s: (s[0] / 10, s[1] / 10))


def assert_grid_is_the_largest(tape: Tape) -> None:
    """Every part keeps every edge rule, and one more column or row of outward displaced parts would not."""
    centres = grid_centres(tape)
    width, height = tape.board.size_mm
    x0, y0 = tape.board.texture_origin_mm
    pitch, displacement = tape.pitch_mm, tape.displacement_mm
    assert edge_margins(centres[placed_mask(tape)], tape).min() >= -TOLERANCE_MM
    right = np.array([(x0 + tape.columns * pitch + displacement, height / 2)])
    assert edge_margins(right, tape)[0] < -TOLERANCE_MM + ROUNDING_MM
    top = height / 2 + tape.rows * pitch / 2 + displacement
    assert edge_margins(np.array([(width / 2, top)]), tape)[0] < -TOLERANCE_MM + ROUNDING_MM
    lowest = y0 - (tape.rows - 1) * pitch
    assert lowest == pytest.approx(height - y0, abs=ROUNDING_MM), "leftover height is centred"


@settings(deadline=None, derandomize=True, max_examples=25)
@given(size_mm=SIZES, tag=st.sampled_from(["strip", "none"]), rotation_deg=st.sampled_from([0.0, 30.0, 45.0, 90.0, 135.0]))
def test_one_more_column_or_row_would_break_a_margin(size_mm: tuple[float, float], tag: str, rotation_deg: float) -> None:
    assert_grid_is_the_largest(tape_of(size_mm=size_mm, tag=tag, rotation_deg=rotation_deg, corner_radius_mm=1.0))


@settings(deadline=None, derandomize=True, max_examples=25)
@given(
    size_mm=SIZES,
    pitch_um=st.integers(1000, 4000),
    share=st.floats(0.05, 0.45),
    code=st.sampled_from(["microdots-4x4", "debruijn-4x4"]),
)
def test_the_grid_fills_the_field_at_any_pitch(size_mm: tuple[float, float], pitch_um: int, share: float, code: str) -> None:
    assume(min(size_mm) > 6 * pitch_um / 1000 + 8)
    pitch_mm = pitch_um / 1000
    assert_grid_is_the_largest(
        tape_of(size_mm=size_mm, pitch_mm=pitch_mm, displacement_mm=share * pitch_mm, code=code, tag="none", corner_radius_mm=0.5)
    )


@pytest.mark.parametrize("size_mm", [(20.0, 20.0), (60.0, 20.0), (100.0, 50.0), (200.0, 100.0)])
def test_without_a_strip_the_field_begins_at_the_left_margin(size_mm: tuple[float, float]) -> None:
    tape = tape_of(size_mm=size_mm, tag="none")
    x0 = tape.board.texture_origin_mm[0]
    outermost = np.array([(x0 - tape.displacement_mm, size_mm[1] / 2), (x0 - 0.1 - tape.displacement_mm, size_mm[1] / 2)])
    kept, broken = edge_margins(outermost, tape)
    assert tape.tag is None
    assert kept >= 0.0 > broken
    assert x0 == 1.6


def test_the_field_begins_beside_the_strip() -> None:
    """The strip is ten cells and a free film of 0.5 mm on both sides; no opening reaches into it."""
    for tag_cell_mm in (0.3, 0.5, 0.8):
        tape = tape_of(size_mm=(60.0, 30.0), tag_cell_mm=tag_cell_mm)
        x0 = tape.board.texture_origin_mm[0]
        strip_mm = 10 * tag_cell_mm + 1.0
        west = draw(np.array([(x0 - tape.displacement_mm, 15.0)]), 45.0).opening[0].bounds[0]
        assert strip_mm <= west + ROUNDING_MM < strip_mm + 0.1 + ROUNDING_MM
        assert tape.tag is not None
        assert tape.tag.center_mm[0] == pytest.approx(0.5 + 5 * tag_cell_mm)


def test_texture_origin_follows_the_documented_formula() -> None:
    tape = tape_of(size_mm=(83.7, 41.3), pitch_mm=1.7, displacement_mm=0.3)
    assert tape.board.texture_origin_mm == pytest.approx((7.0, (41.3 + (tape.rows - 1) * 1.7) / 2), abs=1e-9)


@pytest.mark.parametrize("count", [4, 10, 57])
@pytest.mark.parametrize("short_mm", [0.0, 0.0004])
def test_a_margin_that_is_met_exactly_counts(count: int, short_mm: float) -> None:
    """A threshold is met when value >= limit - 0.5 um; at 0 degrees the margin is 1.0 + 0.3 + 0.25 = 1.55 mm, along y 1.4."""
    width_mm, height_mm = 1.6 + (count - 1) * 1.5 + 1.55, 2 * 1.4 + (count - 1) * 1.5
    tape = tape_of(size_mm=(width_mm - short_mm, height_mm - 2 * short_mm), tag="none", rotation_deg=0.0)
    assert (tape.columns, tape.rows) == (count, count)
    fewer = tape_of(size_mm=(width_mm + 1.5 - 0.002, height_mm + 1.5 - 0.002), tag="none", rotation_deg=0.0)
    assert (fewer.columns, fewer.rows) == (count, count)


# Holes and corners take parts away


def assert_exactly_the_near_parts_are_omitted(tape: Tape, fab: FabProfile = FAB) -> None:
    centres = grid_centres(tape)
    margins = np.minimum(hole_margins(centres, tape, fab), edge_margins(centres, tape, fab))
    clear = np.abs(margins + TOLERANCE_MM) > PAD_ARC_MM
    wrong = clear & (placed_mask(tape) != (margins >= -TOLERANCE_MM))
    assert [(i % tape.columns, i // tape.columns, margins[i]) for i in np.flatnonzero(wrong)] == []


def planned(fab: FabProfile, **values: Any) -> Tape:
    """The tape, or no example where holes and corners leave no whole window of it."""
    try:
        return tape_of(fab, **values)
    except SpecError as error:
        assert [p.key for p in error.problems] == ["holes_mm"]
        assume(False)
        raise


HOLES = st.lists(
    st.tuples(st.integers(30, 370), st.integers(30, 270), st.integers(1, 30)).map(lambda h: tuple(v / 10 for v in h)), max_size=6
)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(holes_mm=HOLES, rotation_deg=st.sampled_from([0.0, 20.0, 45.0, 120.0]))
def test_holes_omit_exactly_the_parts_that_come_too_near(holes_mm: list[tuple[float, float, float]], rotation_deg: float) -> None:
    tape = planned(FAB, size_mm=(40.0, 30.0), holes_mm=holes_mm, rotation_deg=rotation_deg)
    assert_exactly_the_near_parts_are_omitted(tape)


@pytest.mark.parametrize("radius_mm", [0.0, 3.0, 12.0])
@pytest.mark.parametrize(
    "limits_mm",
    [
        {"hole_copper": 2.5},
        {"hole_part": 2.5},
        {"hole_copper": 0.0, "hole_part": 0.0},
        {"pad_edge": 3.0},
        {"body_edge": 3.0},
        {"opening_edge": 3.0, "body_edge": 0.0},
    ],
    ids=str,
)
def test_holes_and_corners_follow_whatever_limits_a_profile_has(limits_mm: dict[str, float], radius_mm: float) -> None:
    fab = with_limits(**limits_mm)
    holes_mm = [(20.0, 15.0, 3.0), (9.3, 20.1, 0.3)]
    tape = tape_of(fab, size_mm=(40.0, 30.0), holes_mm=holes_mm, corner_radius_mm=radius_mm, tag="none")
    assert_exactly_the_near_parts_are_omitted(tape, fab)


@pytest.mark.parametrize("radius_mm", [0.0, 1.0, 5.0, 12.5])
def test_rounded_corners_omit_exactly_the_parts_that_come_too_near(radius_mm: float) -> None:
    tape = tape_of(size_mm=(40.0, 25.0), corner_radius_mm=radius_mm, tag="none")
    assert_exactly_the_near_parts_are_omitted(tape)
    assert (len(tape.omitted) > 0) == (radius_mm >= 5.0)


def test_omitted_points_keep_the_code_and_the_grid() -> None:
    plain = tape_of(size_mm=(40.0, 30.0))
    holed = tape_of(size_mm=(40.0, 30.0), holes_mm=[(20.0, 15.0, 3.0)])
    assert np.array_equal(plain.symbols, holed.symbols)
    assert plain.board.texture_origin_mm == holed.board.texture_origin_mm
    assert holed.part_count == plain.part_count - len(holed.omitted)
    assert len(holed.omitted) > 0


def test_a_planned_tape_breaks_no_edge_or_hole_rule() -> None:
    holes_mm = [(12.0, 8.0, 2.0), (30.3, 20.1, 0.4), (20.0, 15.0, 5.0)]
    examined = examine(TapeSpec(sector=3, size_mm=(40.0, 30.0), holes_mm=holes_mm))
    assert all(f.passed for f in check(examined.layout, examined.fab, examined.spec) if "edge" in f.rule or "hole" in f.rule)


def test_holes_that_leave_no_window_are_refused() -> None:
    holes_mm = [(3.0 + 4.0 * i, 3.0 + 4.0 * j, 2.0) for i in range(9) for j in range(6)]
    with pytest.raises(SpecError, match="holes and corners leave no whole 4x4 window of code 'microdots-4x4'") as caught:
        tape_of(size_mm=(40.0, 30.0), holes_mm=holes_mm, tag="none")
    assert caught.value.problems[0].key == "holes_mm"


# Refused sizes


def named_size(error: SpecError) -> tuple[float, float]:
    found = re.search(r"needs ([\d.]+) x ([\d.]+) mm; use --size", str(error))
    assert found, str(error)
    return float(found[1]), float(found[2])


def refused_size(values: dict[str, Any]) -> tuple[float, float]:
    with pytest.raises(SpecError) as caught:
        tape_of(**values)
    assert [p.key for p in caught.value.problems] == ["size_mm"]
    return named_size(caught.value)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    pitch_um=st.integers(800, 5000),
    share=st.floats(0.02, 0.48),
    code=st.sampled_from(["microdots-4x4", "anoto-6x6"]),
    tag=st.sampled_from(["strip", "none"]),
    tag_cell_mm=st.sampled_from([0.3, 0.5, 1.2]),
    rotation_deg=st.sampled_from([0.0, 10.0, 45.0, 90.0]),
)
def test_a_size_too_small_comes_with_the_least_that_works(
    pitch_um: int, share: float, code: str, tag: str, tag_cell_mm: float, rotation_deg: float
) -> None:
    pitch_mm = pitch_um / 1000
    displacement_mm = max(share * pitch_mm, 0.02)
    values: dict[str, Any] = {"pitch_mm": pitch_mm, "displacement_mm": displacement_mm, "code": code, "tag": tag}
    values |= {"rotation_deg": rotation_deg, "tag_cell_mm": tag_cell_mm, "corner_radius_mm": 0.5}
    width, height = refused_size({**values, "size_mm": (2.0, 2.0)})
    tape = tape_of(**values, size_mm=(width, height))
    assert min(tape.columns, tape.rows) >= (6 if code == "anoto-6x6" else 4)
    assert edge_margins(grid_centres(tape)[placed_mask(tape)], tape).min() >= -TOLERANCE_MM
    assert refused_size({**values, "size_mm": (round(width - 0.1, 1) - 0.001, height)}) == (width, height)
    assert refused_size({**values, "size_mm": (width, round(height - 0.1, 1) - 0.001)}) == (width, height)


@pytest.mark.parametrize("radius_mm", [0.0, 1.0, 2.0, 3.0])
def test_the_least_size_works_whatever_the_corner_radius(radius_mm: float) -> None:
    values: dict[str, Any] = {"corner_radius_mm": radius_mm, "tag": "none"}
    width, height = refused_size({**values, "size_mm": (6.0, 6.0)})
    assert tape_of(**values, size_mm=(width, height)).part_count >= 16


def test_the_message_of_a_size_too_small() -> None:
    with pytest.raises(SpecError) as caught:
        tape_of(size_mm=(10.0, 50.0))
    assert str(caught.value) == (
        "size_mm = 10 x 50 mm is too small: a strip with a tag and one 4x4 window of code 'microdots-4x4' at pitch 1.5 mm "
        "needs 13 x 7.7 mm; use --size 13x50, or --tag none"
    )


@pytest.mark.parametrize(
    "values",
    [{"size_mm": (10.0, 50.0)}, {"corner_radius_mm": 3.5}, {"holes_mm": [(3.0, 3.5, 0.5)]}],
    ids=["size", "corner", "hole"],
)
def test_an_id_of_the_tag_goes_with_the_tag(values: dict[str, Any]) -> None:
    for tag_id, without in ((7, "--tag none"), (8, "--tag none without --tag-id")):
        try:
            said = "; ".join(
                f.message for f in examine(TapeSpec(**{"sector": 7, "tag_id": tag_id, **values})).findings if not f.passed
            )
        except SpecError as error:
            said = str(error)
        # with an id that was asked for, --tag none alone would be refused in its turn
        assert re.findall(r"--tag none(?: without --tag-id)?", said) == [without]


def test_a_size_beyond_the_code_names_its_reach_and_the_reach_works() -> None:
    with pytest.raises(CapacityError) as caught:
        TapeSpec(sector=7, size_mm=(5600.0, 50.0))
    assert str(caught.value) == (
        "size_mm[0] = 5600.0 mm exceeds 5062.5 mm, the reach of code 'microdots-4x4' at pitch 1.5 mm; "
        "use --code debruijn-4x4 or a smaller tape"
    )
    assert tape_of(size_mm=(5062.5, 10.0), origin=(0, 0)).columns > 3360
    assert tape_of(size_mm=(5600.0, 10.0), code="debruijn-4x4").columns > 3720


@pytest.mark.parametrize("size_mm", [(5600.0, 20.0), (7000.0, 20.0), (20.0, 9999.0)])
@pytest.mark.parametrize("code", ["microdots-4x4", "debruijn-4x4"])
def test_the_code_that_a_refused_size_names_has_the_reach(size_mm: tuple[float, float], code: str) -> None:
    try:
        TapeSpec(sector=0, size_mm=size_mm, code=code)
    except CapacityError as error:
        found = re.search(r"use --code (\S+) or a smaller tape", str(error))
        assert found
        assert max(tape_of(sector=0, size_mm=size_mm, code=found[1], tag="none").symbols.shape) > 3700
    else:
        assert (code, max(size_mm)) == ("debruijn-4x4", 5600.0)


@pytest.mark.parametrize(
    ("sector", "size_mm", "axis"), [(255, (1000.0, 20.0), "column"), (15, (20.0, 600.0), "row"), (255, (5000.0, 20.0), "column")]
)
def test_a_tape_past_the_range_names_an_origin_that_works(sector: int, size_mm: tuple[float, float], axis: str) -> None:
    with pytest.raises(CapacityError) as caught:
        tape_of(sector=sector, size_mm=size_mm)
    found = re.search(rf"exceed 3375, .*; use --origin \d+,\d+, with {axis} at most (\d+)", str(caught.value))
    assert found, str(caught.value)
    assert [p.key for p in caught.value.problems] == ["origin"]
    most = int(found[1])
    origin = (most, 0) if axis == "column" else (0, most)
    tape = tape_of(sector=sector, size_mm=size_mm, origin=origin)
    assert most + (tape.columns if axis == "column" else tape.rows) == 3375
    with pytest.raises(CapacityError):
        tape_of(sector=sector, size_mm=size_mm, origin=(most + 1, 0) if axis == "column" else (0, most + 1))


def test_too_many_grid_points_are_refused_before_any_is_made() -> None:
    with pytest.raises(
        CapacityError,
        match=r"size_mm = 9000 x 9000 mm gives \d+ x \d+ grid points, more than the 500000 of a tape .*; use a smaller --size",
    ):
        tape_of(size_mm=(9000.0, 9000.0), code="anoto-6x6")


@pytest.mark.parametrize("radius_mm", [3.0, 10.0])
def test_a_corner_that_cuts_into_the_tag_is_refused(radius_mm: float) -> None:
    with pytest.raises(SpecError, match="cuts into the tag") as caught:
        tape_of(size_mm=(60.0, 30.0), corner_radius_mm=radius_mm)
    assert caught.value.problems[0].key == "corner_radius_mm"
    assert tape_of(size_mm=(60.0, 30.0), corner_radius_mm=radius_mm, tag="none").tag is None


@pytest.mark.parametrize(("edge_mm", "ways"), [(0.3, "use --corner-radius 1.7, or --tag none"), (0.6, "use --tag none")])
def test_a_tag_too_near_to_straight_sides_is_not_told_to_have_other_corners(edge_mm: float, ways: str) -> None:
    """The ring is half a millimetre from the left side, where no corner's radius helps."""
    fab = replace(FAB, legend=replace(FAB.legend, edge_mm=edge_mm))
    with pytest.raises(SpecError) as caught:
        plan(TapeSpec(sector=7, size_mm=(60.0, 30.0), corner_radius_mm=3.0), fab, PART)
    assert str(caught.value).endswith(f"mm inside the outline; {ways}")
