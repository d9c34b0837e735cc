"""rules: every worst value equals what brute-force geometry over all parts finds, stands where it says, and a threshold is
met down to half a micrometre below it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import shapely

from tactape_fab import Tape, TapeSpec
from tactape_fab.base.errors import Finding, SpecError
from tactape_fab.cli.printing import finding_lines
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.film.layout import Layout, build_layout
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import LIMIT_IDS
from tactape_fab.kit.rules.spacing import check, hole_rules, size_finding
from tactape_fab.texture.board import Board
from tests.unit.kit.test_plan import FAB, PAD_ARC_MM, PART, Floats, Shapes, board_shape, draw, edge_gap, grid_centres, placed_mask

FAR_MM = 30.0


def findings_of(examined: Examined) -> dict[str, Finding]:
    return by_rule(examined.findings)


def by_rule(findings: Sequence[Finding]) -> dict[str, Finding]:
    """The worst finding of each rule."""
    falling = sorted(findings, key=lambda f: np.inf if f.value is None else f.value, reverse=True)
    return {finding.rule: finding for finding in falling}


@cache
def random_design(seed: int) -> Examined:
    """Any pitch and displacement that fit the parts or not, any rotation and code, with or without a strip."""
    rng = np.random.default_rng(seed)
    pitch_mm = float(rng.uniform(1.0, 2.5))
    values: dict[str, Any] = {
        "sector": int(rng.integers(256)),
        "code": str(rng.choice(["microdots-4x4", "debruijn-4x4"])),
        "pitch_mm": round(pitch_mm, 3),
        "displacement_mm": round(float(rng.uniform(0.05, 0.4)) * pitch_mm, 3),
        "rotation_deg": float(rng.choice([0.0, 45.0, 90.0, 135.0, round(float(rng.uniform(0, 360)), 1)])),
        "size_mm": (round(float(rng.uniform(20, 40)), 1), round(float(rng.uniform(14, 30)), 1)),
        "tag": "strip" if seed % 3 == 0 else "none",
        "corner_radius_mm": 0.5,
        "coverlay": "per-part",
    }
    width, height = values["size_mm"]
    values["holes_mm"] = [
        (float(rng.uniform(2, width - 2)), float(rng.uniform(2, height - 2)), round(float(rng.uniform(0.1, 1.5)), 2))
        for _ in range(seed % 4)
    ]
    if seed % 5 == 3:  # parts long against the pitch: the worst neighbour is the diagonal one
        values |= {"pitch_mm": round(float(rng.uniform(0.88, 0.98)), 3), "displacement_mm": 0.02}
        values["rotation_deg"] = 45.0 if seed % 2 else 135.0
    if seed % 5 == 4:  # holes take most parts away, often one of the worst pair
        values |= {"size_mm": (14.0, 11.0), "tag": "none", "pitch_mm": 1.5, "displacement_mm": round(rng.uniform(0.1, 0.4), 3)}
        values["holes_mm"] = [(float(rng.uniform(9, 12)), y, round(float(rng.uniform(0.5, 2.0)), 2)) for y in (2.5, 5.5, 8.5)]
    return examine(TapeSpec(**values))


def parts_of(tape: Tape) -> Floats:
    return np.asarray(grid_centres(tape)[placed_mask(tape)])


def worst_pair_gap(shapes: Sequence[Shapes]) -> float:
    """Least distance between shapes of two different parts; shapes[k][i] belongs to part i."""
    every = np.concatenate(shapes)
    part = np.tile(np.arange(len(shapes[0])), len(shapes))
    reach = 0.05
    while reach < FAR_MM:
        a, b = shapely.STRtree(every).query(every, predicate="dwithin", distance=reach)
        apart = part[a] < part[b]
        if apart.any():
            return float(shapely.distance(every[a[apart]], every[b[apart]]).min())
        reach *= 3
    return reach


def assert_same_gap(measured: float, brute_mm: float, tolerance_mm: float = 1e-5) -> None:
    """Brute force says 0 for every overlap, the rule how deep it is."""
    if brute_mm > 0.0:
        assert measured == pytest.approx(brute_mm, abs=tolerance_mm)
    else:
        assert measured <= tolerance_mm


SEEDS = range(30)
EVERY_DESIGN = pytest.mark.parametrize("seed", SEEDS)


def test_designs_lie_on_both_sides_of_the_limits() -> None:
    for rule in ("pad-pad", "body-body", "opening-bridge", "courtyard"):
        assert {findings_of(random_design(seed))[rule].passed for seed in SEEDS} == {True, False}


@EVERY_DESIGN
def test_worst_gaps_are_those_of_brute_force(seed: int) -> None:
    examined = random_design(seed)
    tape, findings = examined.layout.tape, findings_of(examined)
    drawn = draw(parts_of(tape), tape.part.rotation_deg)
    assert_same_gap(findings["body-body"].value or 0.0, worst_pair_gap([drawn.largest_body]))
    assert_same_gap(findings["courtyard"].value or 0.0, worst_pair_gap([drawn.courtyard]))
    assert_same_gap(findings["opening-bridge"].value or 0.0, worst_pair_gap([drawn.opening]))
    assert_same_gap(findings["pad-pad"].value or 0.0, worst_pair_gap(list(drawn.pads)), 2 * PAD_ARC_MM)


def test_omitted_parts_are_nobodys_neighbours() -> None:
    """With every other part taken away as on a chess board, only diagonal and farther neighbours count."""
    spec = TapeSpec(sector=7, size_mm=(20.0, 20.0), tag="none")
    whole = plan(spec, FAB, PART)
    omitted = np.array([(c, r) for r in range(whole.rows) for c in range(whole.columns) if (c + r) % 2])
    tape = replace(whole, omitted=omitted)
    findings = by_rule(check(build_layout(tape, spec, FAB, PART), FAB, spec))
    drawn = draw(parts_of(tape), 45.0)
    for rule, shapes in (("body-body", drawn.largest_body), ("courtyard", drawn.courtyard), ("opening-bridge", drawn.opening)):
        assert findings[rule].value == pytest.approx(worst_pair_gap([shapes]), abs=1e-5)


def test_two_parts_alone_are_neighbours() -> None:
    spec = TapeSpec(sector=7, size_mm=(20.0, 20.0), tag="none")
    whole = plan(spec, FAB, PART)
    omitted = [(c, r) for r in range(whole.rows) for c in range(whole.columns) if (c, r) not in ((3, 4), (4, 4))]
    tape = replace(whole, omitted=np.array(omitted))
    findings = by_rule(check(build_layout(tape, spec, FAB, PART), FAB, spec))
    drawn = draw(parts_of(tape), 45.0)
    assert findings["body-body"].value == pytest.approx(float(shapely.distance(*drawn.largest_body)), abs=1e-5)


def test_anchors_keep_their_distance_from_the_outline() -> None:
    layout = examine(TapeSpec(sector=7, size_mm=(26.0, 22.0), pitch_mm=2.0, coverlay="per-part", anchor="mesh")).layout
    assert layout.anchors is not None
    edge_mm = shapely.distance(board_shape(layout.tape).exterior, shapely.linestrings(layout.anchors.lines_mm))
    wider = replace(layout.anchors, web_mm=2 * float(edge_mm.min()))  # the nearest line touches the outline
    finding = by_rule(check(replace(layout, anchors=wider), FAB, TapeSpec(sector=7)))["pad-edge"]
    assert finding.value == pytest.approx(0.0, abs=1e-3)
    nearest = layout.anchors.lines_mm[edge_mm < edge_mm.min() + 1e-6].reshape(-1, 2)
    assert finding.at_mm is not None
    assert np.hypot(*(nearest - finding.at_mm).T).min() < 1e-6


@EVERY_DESIGN
def test_worst_edge_distances_are_those_of_brute_force(seed: int) -> None:
    examined = random_design(seed)
    tape, findings = examined.layout.tape, findings_of(examined)
    board, drawn = board_shape(tape), draw(parts_of(tape), tape.part.rotation_deg)
    assert findings["body-edge"].value == pytest.approx(edge_gap(drawn.body, board).min(), abs=1e-5)
    assert findings["opening-edge"].value == pytest.approx(edge_gap(drawn.opening, board).min(), abs=1e-5)
    assert findings["pad-edge"].value == pytest.approx(min(edge_gap(p, board).min() for p in drawn.pads), abs=PAD_ARC_MM)


@EVERY_DESIGN
def test_worst_hole_distances_are_those_of_brute_force(seed: int) -> None:
    examined = random_design(seed)
    tape, findings = examined.layout.tape, findings_of(examined)
    if not tape.board.holes:
        assert not any(rule.startswith("hole") for rule in findings)
        return
    x, y, diameter = np.array(tape.board.holes).T
    centres, radii = np.asarray(shapely.points(x, y)), diameter / 2
    board, drawn = board_shape(tape), draw(parts_of(tape), tape.part.rotation_deg)
    assert findings["hole-edge"].value == pytest.approx((edge_gap(centres, board) - radii).min(), abs=1e-4)
    assert findings["hole-size"].value == pytest.approx(diameter.min())
    bodies = (shapely.distance(drawn.body[:, None], centres) - radii).min()
    lands = (shapely.distance(drawn.pads[..., None], centres) - radii).min()
    assert findings["hole-part"].value == pytest.approx(bodies, abs=1e-5)
    assert findings["hole-copper"].value == pytest.approx(lands, abs=PAD_ARC_MM)


@EVERY_DESIGN
def test_worst_film_between_two_holes_is_that_of_brute_force(seed: int) -> None:
    examined = random_design(seed)
    holes = examined.layout.tape.board.holes
    gaps = [np.hypot(a[0] - b[0], a[1] - b[1]) - (a[2] + b[2]) / 2 for i, a in enumerate(holes) for b in holes[:i]]
    finding = findings_of(examined).get("hole-hole")
    if finding is None:
        assert min(gaps, default=np.inf) > 5.0
    else:
        assert finding.value == pytest.approx(min(gaps), abs=1e-9)


def test_holes_far_apart_are_no_finding_rather_than_another_pair() -> None:
    """Between the large hole and its neighbour there are 15.35 mm of film, between the small ones 19.9 mm."""
    holes = [(20.0, 25.0, 10.0), (40.6, 25.0, 0.5), (61.0, 25.0, 0.5)]
    spec = TapeSpec(sector=3, size_mm=(100.0, 50.0), holes_mm=holes, tag="none", models=False)
    assert "hole-hole" not in findings_of(examine(spec))


def ink_of(layout: Layout) -> shapely.Geometry:
    legend = layout.legend
    strokes = [shapely.LineString(s).buffer(legend.line_mm / 2, quad_segs=32) for s in legend.strokes_mm]
    return shapely.union_all([*(shapely.Polygon(area) for area in legend.areas_mm), *strokes])


@EVERY_DESIGN
def test_worst_legend_distances_are_those_of_brute_force(seed: int) -> None:
    examined = random_design(seed)
    tape, findings = examined.layout.tape, findings_of(examined)
    assert ("opening-legend" in findings) == (tape.tag is not None)
    if tape.tag is None:
        return
    ink, drawn = ink_of(examined.layout), draw(parts_of(tape), tape.part.rotation_deg)
    assert findings["opening-legend"].value == pytest.approx(shapely.distance(ink, drawn.opening).min(), abs=1e-3)
    if tape.board.holes:
        nearest = min(shapely.distance(ink, shapely.Point(x, y)) - d / 2 for x, y, d in tape.board.holes)
        assert findings["hole-legend"].value == pytest.approx(nearest, abs=1e-3)


def test_each_rule_has_one_finding_its_worst() -> None:
    holes_mm = [(18.0, 10.0, 1.0), (22.0, 10.0, 1.0)]
    rules = [finding.rule for finding in examine(TapeSpec(sector=7, size_mm=(30.0, 20.0), holes_mm=holes_mm)).findings]
    assert sorted(rules) == sorted(set(rules))


@EVERY_DESIGN
def test_the_worst_edge_stands_where_the_finding_says(seed: int) -> None:
    examined = random_design(seed)
    tape, findings = examined.layout.tape, findings_of(examined)
    board, centres = board_shape(tape), parts_of(tape)
    for rule in ("body-edge", "opening-edge", "pad-edge"):
        finding = findings[rule]
        assert finding.at_mm is not None
        at = int(np.argmin(np.hypot(*(centres - finding.at_mm).T)))
        assert centres[at] == pytest.approx(finding.at_mm, abs=1e-5)
        drawn = draw(centres[at : at + 1], tape.part.rotation_deg)
        shapes = {"body-edge": drawn.body, "opening-edge": drawn.opening, "pad-edge": drawn.pads.ravel()}[rule]
        assert edge_gap(shapes, board).min() == pytest.approx(finding.value, abs=PAD_ARC_MM)


@EVERY_DESIGN
def test_the_worst_gap_stands_between_the_grid_points_that_the_finding_says(seed: int) -> None:
    examined = random_design(seed)
    tape, findings = examined.layout.tape, findings_of(examined)
    x0, y0 = tape.board.texture_origin_mm
    centres = grid_centres(tape)
    drawn = draw(centres, tape.part.rotation_deg)
    placed = placed_mask(tape)
    for rule, shapes in (("body-body", drawn.largest_body), ("courtyard", drawn.courtyard), ("opening-bridge", drawn.opening)):
        finding = findings[rule]
        assert finding.at_mm is not None
        middle = np.array([(finding.at_mm[0] - x0) / tape.pitch_mm, (y0 - finding.at_mm[1]) / tape.pitch_mm])
        twice = np.rint(2 * middle).astype(int)
        assert 2 * middle == pytest.approx(twice, abs=1e-4)
        gaps = []
        for c in range(max(twice[0] - tape.columns + 1, 0), min(tape.columns, twice[0] + 1)):
            for r in range(max(twice[1] - tape.rows + 1, 0), min(tape.rows, twice[1] + 1)):
                a, b = r * tape.columns + c, (twice[1] - r) * tape.columns + twice[0] - c
                if a < b and placed[a] and placed[b]:
                    gaps.append(float(shapely.distance(shapes[a], shapes[b])))
        assert_same_gap(finding.value or 0.0, min(gaps))


# Figures and limits


def test_figures_of_the_main_job() -> None:
    findings = findings_of(examine(TapeSpec(sector=7)))
    assert findings["body-body"].value == pytest.approx(0.385, abs=0.0005)
    assert findings["pad-pad"].value == pytest.approx(0.307, abs=0.0005)
    assert findings["pad-pair"].value == pytest.approx(0.180, abs=0.0005)
    assert findings["courtyard"].value == pytest.approx(0.007, abs=0.0005)
    assert findings["opening-bridge"].value == pytest.approx(0.207, abs=0.0005)
    assert findings["opening-size"].value == pytest.approx(0.5, abs=1e-6)
    assert findings["body-edge"].value == pytest.approx(1.032, abs=0.0005)
    assert {rule for rule, finding in findings.items() if not finding.passed} == {
        *("coverlay-lpi", "anchor-mesh", "part-count", "assembly-size")
    }
    assert not any(finding.level != "info" for finding in findings.values() if not finding.passed)


def test_limits_are_those_of_the_generic_profile() -> None:
    findings = findings_of(examine(TapeSpec(sector=7, size_mm=(40.0, 30.0), holes_mm=[(20.0, 15.0, 1.0), (30.0, 15.0, 1.0)])))
    limits = {
        rule: (finding.limit, finding.level) for rule, finding in findings.items() if not rule.startswith(("coverlay", "anchor"))
    }
    assert limits == {
        "pad-pad": (0.10, "block"),
        "pad-pair": (0.10, "block"),
        "body-body": (0.15, "block"),
        "courtyard": (0.0, "warn"),
        "opening-bridge": (0.20, "block"),
        "opening-size": (0.50, "block"),
        "pad-edge": (0.30, "block"),
        "body-edge": (1.0, "block"),
        "opening-edge": (0.0, "block"),
        "opening-legend": (0.15, "block"),
        "hole-edge": (0.50, "block"),
        "hole-size": (0.10, "block"),
        "hole-hole": (0.50, "block"),
        "hole-copper": (0.20, "block"),
        "hole-part": (0.20, "block"),
        "hole-legend": (0.15, "block"),
        "size": (600.0, "warn"),
        "opening-expansion": (0.05, "info"),
        "corner-radius": (1.0, "warn"),
        "legend-line": (0.15, "block"),
        "paste-ratio": (0.66, "warn"),
        "chip-size": (0.6, "warn"),
        "part-count": (300, "info"),
        "assembly-size": (70.0, "info"),
    }
    assert set(LIMIT_IDS) <= set(limits)


def test_thresholds_are_met_down_to_half_a_micrometre_below_them() -> None:
    examined = examine(TapeSpec(sector=7, size_mm=(30.0, 20.0), holes_mm=[(18.0, 10.0, 1.0), (22.0, 10.0, 1.0)]))
    measured = {rule: finding.value for rule, finding in findings_of(examined).items() if rule in LIMIT_IDS}
    assert set(measured) == set(LIMIT_IDS)
    for above_mm, passed in ((-0.01, True), (0.0, True), (0.00049, True), (0.00051, False), (0.01, False)):
        limits = {rule: replace(FAB.limits[rule], value_mm=(value or 0.0) + above_mm) for rule, value in measured.items()}
        findings = by_rule(check(examined.layout, replace(FAB, limits=limits), examined.spec))
        for rule in LIMIT_IDS:
            assert findings[rule].passed is passed, rule
            assert findings[rule].limit == limits[rule].value_mm
            assert findings[rule].blocks is (not passed and limits[rule].level == "block")


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"displacement_mm": 0.27, "coverlay": "per-part"}, "opening-bridge"),
        ({"rotation_deg": 0.0, "coverlay": "per-part"}, "opening-bridge"),
        ({"rotation_deg": 0.0, "pitch_mm": 1.2, "displacement_mm": 0.2}, "pad-pad"),
        ({"pitch_mm": 1.0, "displacement_mm": 0.25}, "body-body"),
        ({"holes_mm": [(1.0, 45.0, 1.2)]}, "hole-edge"),
        ({"holes_mm": [(50.0, 25.0, 0.05)]}, "hole-size"),
        ({"holes_mm": [(50.0, 25.0, 1.0), (51.4, 25.0, 1.0)]}, "hole-hole"),
        ({"holes_mm": [(3.0, 3.5, 0.5)]}, "hole-legend"),
    ],
)
def test_a_broken_rule_names_value_limit_profile_and_remedy(values: dict[str, Any], rule: str) -> None:
    finding = next(f for f in examine(TapeSpec(sector=7, **values)).findings if f.rule == rule)
    assert finding.blocks
    assert finding.value is not None
    assert finding.limit is not None
    assert finding.value < finding.limit
    assert f"{finding.value:.3f} mm is below the limit {finding.limit:.3f} mm of generic-fpc; " in finding.message
    assert finding.source


def test_a_gap_of_nothing_has_no_sign() -> None:
    spec = TapeSpec(sector=7, size_mm=(40.0, 30.0), rotation_deg=90.0, pitch_mm=1.63, displacement_mm=0.265, models=False)
    gap = findings_of(examine(spec))["pad-pad"]
    assert -0.0005 < (gap.value or 0.0) < 0.0  # but for rounding they touch
    assert "gap between pads of two parts 0.000 mm is below" in gap.message
    assert "-0.000" not in "".join(finding_lines([gap]))


def test_all_broken_rules_come_together() -> None:
    spec = TapeSpec(sector=7, pitch_mm=0.8, holes_mm=[(50.0, 25.0, 0.05)], coverlay="per-part")
    broken = {f.rule for f in examine(spec).findings if f.blocks}
    assert broken >= {"pad-pad", "body-body", "opening-bridge", "hole-size"}


def test_an_overlap_is_negative_by_its_depth() -> None:
    """Two openings of 1.2 x 0.5 mm, E next to W at W 1.5 and rotation 0: centres 1.0 mm apart, so 0.2 mm of overlap."""
    findings = findings_of(examine(TapeSpec(sector=7, rotation_deg=0.0, coverlay="per-part")))
    assert findings["opening-bridge"].value == pytest.approx(-0.2, abs=1e-6)


@pytest.mark.parametrize(
    ("size_mm", "passed", "value_mm", "limit_mm"),
    [
        ((600.0, 20.0), True, 600.0, 600.0),
        ((601.0, 20.0), False, 601.0, 600.0),
        ((20.0, 600.0), True, 600.0, 600.0),
        ((260.0, 255.0), False, 255.0, 250.0),
        ((600.0, 255.0), False, 255.0, 250.0),
    ],
)
def test_a_board_larger_than_the_fab_takes_is_a_warning(
    size_mm: tuple[float, float], passed: bool, value_mm: float, limit_mm: float
) -> None:
    whole = random_design(0)
    layout = replace(whole.layout, tape=replace(whole.layout.tape, board=replace(whole.layout.tape.board, size_mm=size_mm)))
    finding = size_finding(layout.tape.board.size_mm, FAB)
    assert (finding.value, finding.limit) == (value_mm, limit_mm)
    assert (finding.passed, finding.level, finding.blocks) == (passed, "warn", False)
    assert "600 x 250 mm of generic-fpc" in finding.message


def test_a_strip_without_room_says_what_it_left_out() -> None:
    finding = findings_of(examine(TapeSpec(sector=7, size_mm=(20.0, 12.0))))["label"]
    assert (finding.level, finding.passed, finding.blocks) == ("warn", False, False)
    assert "the strip has no room for" in finding.message
    width_mm, height_mm = map(float, re.findall(r"--size ([\d.]+)x([\d.]+)", finding.message)[0])
    assert width_mm != height_mm
    assert "label" not in findings_of(examine(TapeSpec(sector=7, size_mm=(width_mm, height_mm))))
    assert "label" not in findings_of(examine(TapeSpec(sector=7)))


@pytest.mark.parametrize(("height_mm", "helps"), [(25.0, False), (28.0, True)])
def test_a_shorter_name_is_proposed_only_where_the_label_then_has_room(height_mm: float, helps: bool) -> None:
    named = TapeSpec(sector=7, size_mm=(40.0, height_mm))
    assert findings_of(examine(named))["label"].message.endswith("or a shorter --name") is helps
    assert ("label" not in findings_of(examine(replace(named, name="a")))) is helps


def test_a_profile_that_cannot_be_read_is_no_rule() -> None:
    with pytest.raises(SpecError, match="cannot be opened"):
        examine(TapeSpec(sector=7, fab="nowhere.toml"))


HOLE_OPTION = re.compile(r"--hole ([\d.]+),([\d.]+),([\d.]+)")


@pytest.mark.parametrize(
    ("holes_mm", "rule"),
    [
        ([(0.8, 25.0, 1.0)], "hole-edge"),
        ([(99.3, 49.4, 0.3)], "hole-edge"),
        ([(40.0, 0.7, 1.0), (99.5, 49.5, 0.4)], "hole-edge"),
        ([(50.0, 25.0, 0.05)], "hole-size"),
    ],
)
def test_holes_stand_well_where_the_remedy_puts_them(holes_mm: list[tuple[float, float, float]], rule: str) -> None:
    broken = by_rule(examine(TapeSpec(sector=7, holes_mm=holes_mm, models=False)).findings)[rule]
    assert broken.blocks
    moved = [(float(x), float(y), float(d)) for x, y, d in HOLE_OPTION.findall(broken.message)]
    assert len(moved) == len(holes_mm)
    assert by_rule(examine(TapeSpec(sector=7, holes_mm=moved, models=False)).findings)[rule].passed


@pytest.mark.parametrize(
    ("holes_mm", "size_mm", "rule", "remedy"),
    [
        ([(0.8, 25.0, 1.0)], (100.0, 50.0), "hole-edge", "use --hole 1,25,1 in its place"),
        ([(0.8, 25.0, 1.0), (30.0, 0.6, 0.6)], (100.0, 50.0), "hole-edge", "use --hole 1,25,1, --hole 30,0.8,0.6 in their place"),
        ([(15.005, 0.6, 0.6)], (30.01, 20.0), "hole-edge", "use --hole 15,0.8,0.6 in its place"),
        ([(29.999, 19.999, 0.4)], (30.0, 20.0), "hole-edge", "use --hole 29.15,19.2,0.4 in its place"),
        ([(50.0, 25.0, 0.05), (60.0, 25.0, 0.1)], (100.0, 50.0), "hole-size", "use --hole 50,25,0.1 in its place"),
        (
            [(50.0, 25.0, 0.05), (60.0, 25.0, 0.06)],
            (100.0, 50.0),
            "hole-size",
            "use --hole 50,25,0.1, --hole 60,25,0.1 in their place",
        ),
        ([(50.0, 25.0, 1.0), (51.4, 25.0, 1.0), (52.8, 25.0, 1.0)], (100.0, 50.0), "hole-hole", "leave out --hole 51.4,25,1"),
    ],
)
def test_what_a_remedy_of_holes_says(
    holes_mm: list[tuple[float, float, float]], size_mm: tuple[float, float], rule: str, remedy: str
) -> None:
    board = Board(size_mm=size_mm, texture_origin_mm=(0.0, 0.0), corner_radius_mm=1.0, thickness_mm=0.1, holes=tuple(holes_mm))
    (finding,) = (found for found in hole_rules(board, FAB, "film") if found.rule == rule)
    assert finding.message.endswith(f"; {remedy}")


@pytest.mark.parametrize(
    ("size_mm", "side"), [((600.0003, 255.0), 1), ((255.0, 600.0003), 1), ((605.0, 250.0003), 0), ((605.0, 255.0), 0)]
)
def test_a_board_is_too_long_by_the_side_that_is(size_mm: tuple[float, float], side: int) -> None:
    said = size_finding(size_mm, FAB)
    assert not said.passed
    assert said.value == sorted(size_mm, reverse=True)[side] and said.limit == FAB.size.largest_mm[side]


@pytest.mark.parametrize(("limit_mm", "tag", "says"), [(1.5, "strip", ""), (2.5, "strip", " --tag none"), (2.5, "none", "")])
def test_corners_that_would_cut_into_the_tag_take_it_away(limit_mm: float, tag: str, says: str) -> None:
    spec = TapeSpec(sector=7, size_mm=(60.0, 30.0), tag=tag)
    fab = replace(FAB, limits={**FAB.limits, "corner-radius": replace(FAB.limits["corner-radius"], value_mm=limit_mm)})
    finding = by_rule(check(build_layout(plan(spec, FAB, PART), spec, FAB, PART), fab, spec))["corner-radius"]
    assert finding.message.endswith(f"; use --corner-radius {limit_mm:g}{says}")


def test_a_hole_that_is_made_wider_stays_within_the_outline() -> None:
    board = Board(
        size_mm=(60.0, 30.0), texture_origin_mm=(3.0, 27.0), corner_radius_mm=1.0, thickness_mm=0.1, holes=((20, 29.6, 0.05),)
    )
    fab = replace(FAB, limits={**FAB.limits, "hole-size": replace(FAB.limits["hole-size"], value_mm=2.0)})
    (finding,) = (f for f in hole_rules(board, fab, "film") if f.rule == "hole-size")
    x, y, diameter = map(float, re.findall(r"--hole ([\d.]+),([\d.]+),([\d.]+) in its place", finding.message)[0])
    assert (x, diameter) == (20.0, 2.0) and y + diameter / 2 <= 30.0 - FAB.limits["hole-edge"].value_mm
