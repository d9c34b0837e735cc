"""Remedies: the W that is named is the least at which rules hold, the Δ the largest, recounted by shapes drawn here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import shapely

from tactape_fab import TapeSpec
from tactape_fab.base.errors import Finding
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.anchors import Placing
from tactape_fab.kit.profiles import FabProfile, load_process, profile_names, read_part
from tactape_fab.kit.profiles.parts import ElementProfile, PartProfile
from tactape_fab.kit.rules.remedies import (
    GAPS,
    Pitch,
    Remedy,
    cell_pitch_mm,
    element_pitch_mm,
    film_parts,
    film_pitch_mm,
    film_remedy,
    opening_words,
    part_words,
    texture_remedy,
    wider_words,
)
from tactape_fab.kit.spec.scatter import least_displacement_mm
from tests.unit.kit.film.test_coverlay import box, brute_gap_mm
from tests.unit.kit.test_plan import FAB, PART, rectangle, turned

SPEC = TapeSpec(sector=7, size_mm=(30.0, 20.0), tag="none")


def element(name: str) -> ElementProfile:
    part = read_part(name)
    assert isinstance(part, ElementProfile)
    return part


def lands(rotation_deg: float) -> shapely.Geometry:
    pad = PART.pads
    both = (rectangle(*pad.size_mm, (side * pad.offset_mm, 0.0), pad.corner_radius_mm) for side in (-1, 1))
    return shapely.MultiPolygon([shapely.Polygon(turned(outline, rotation_deg)) for outline in both])


# Least pitches


@pytest.mark.parametrize("rotation_deg", [45.0, 0.0, 20.0])
@pytest.mark.parametrize("displacement_mm", [0.1, 0.3])
def test_from_the_named_pitch_on_shapes_are_so_far_apart(rotation_deg: float, displacement_mm: float) -> None:
    placing = Placing(rotation_deg=rotation_deg, displacement_mm=displacement_mm, directions=4)
    shapes = {
        "opening-bridge": box(1.10 + 2 * FAB.coverlay_expansion_mm, 0.40 + 2 * FAB.coverlay_expansion_mm, rotation_deg),
        "courtyard": box(1.40, 0.70, rotation_deg),
        "body-body": box(0.63, 0.33, rotation_deg),
        "pad-pad": lands(rotation_deg),
    }
    for rule, shape in shapes.items():
        limit_mm = 0.17
        pitch_mm = film_pitch_mm(rule, limit_mm, FAB, PART, placing)
        assert pitch_mm is not None
        assert brute_gap_mm(shape, shape, pitch_mm + 0.001, displacement_mm) >= limit_mm - 1e-6, rule
        assert brute_gap_mm(shape, shape, pitch_mm - 0.003, displacement_mm) < limit_mm, rule


def test_eight_directions_come_nearer_to_each_other_along_the_diagonals() -> None:
    four, eight = (Placing(rotation_deg=45.0, displacement_mm=0.25, directions=n) for n in (4, 8))
    for rule in GAPS:
        few, many = (film_pitch_mm(rule, 0.1, FAB, PART, placing) for placing in (four, eight))
        assert few is not None and many is not None and many >= few
    assert element_pitch_mm(0.1, element("block"), eight) > element_pitch_mm(0.1, element("block"), four)


@pytest.mark.parametrize("rotation_deg", [45.0, 0.0, 20.0])
def test_feet_and_cells_of_elements_are_as_far_apart_as_asked(rotation_deg: float) -> None:
    placing, displacement_mm, gap_mm = Placing(rotation_deg=rotation_deg, displacement_mm=0.2, directions=4), 0.2, 0.4
    block, dome = element("block"), element("dome")
    foot = box(*block.body_mm[:2], rotation_deg)
    assert brute_gap_mm(foot, foot, element_pitch_mm(gap_mm, block, placing), displacement_mm) == pytest.approx(gap_mm, abs=1e-6)
    middle = shapely.Point(0.0, 0.0)
    between_mm = brute_gap_mm(middle, middle, element_pitch_mm(gap_mm, dome, placing), displacement_mm)
    assert between_mm - dome.body_mm[0] == pytest.approx(gap_mm)
    low_x, low_y, high_x, high_y = foot.bounds
    reach_mm = max(-low_x, -low_y, high_x, high_y)
    assert cell_pitch_mm(block, placing) / 2 - displacement_mm - reach_mm == pytest.approx(0.002)


# The search


def remedy(*pitches: Pitch, spec: TapeSpec = SPEC, **least_size: tuple[float, float]) -> Remedy:
    return Remedy(spec=spec, pitches=pitches, size_mm=lambda other: least_size.get("size_mm", other.size_mm))


def at_least(pitch_mm: float | None) -> Pitch:
    return lambda _: pitch_mm


def test_w_is_the_least_that_meets_every_rule() -> None:
    assert remedy(at_least(1.7), at_least(2.0502), at_least(0.3)).options() == "--w 2.051 --delta 0.25"
    assert remedy(at_least(20.0)).options() == "--w 20 --delta 0.25"
    assert remedy(at_least(20.0001)).options() is None
    assert remedy(at_least(1.7), at_least(None)).options() is None
    assert remedy().options() == ""


@pytest.mark.parametrize(("pitch_mm", "options"), [(1.5, ""), (1.5005, ""), (1.50051, "--w 1.501 --delta 0.25")])
def test_a_rule_is_met_down_to_half_a_micrometre_below_it(pitch_mm: float, options: str) -> None:
    assert remedy(at_least(pitch_mm)).options() == options


def test_an_outline_is_named_where_a_window_no_longer_fits() -> None:
    assert remedy(at_least(2.0), size_mm=(33.0, 21.5)).options() == "--w 2 --delta 0.25 --size 33x21.5"
    assert remedy(at_least(1.0), size_mm=(33.0, 21.5)).options() == "--size 33x21.5"


def test_delta_is_named_in_micrometres_and_w_does_not_shrink_with_it() -> None:
    spec = TapeSpec(sector=7, size_mm=(30.0, 20.0), tag="none", pitch_mm=1.5, displacement_mm=0.2504)
    assert remedy(lambda placing: 1.0 if placing.displacement_mm <= 0.25 else 3.0, spec=spec).options() == "--w 1.5 --delta 0.25"
    small = spec.with_values(displacement_mm=0.0201)
    assert remedy(at_least(2.0), spec=small.with_values(displacement_mm=0.0194)).options() == "--w 2 --delta 0.02"
    assert remedy(at_least(2.0), spec=small).options() == "--w 2 --delta 0.02"


def test_rules_see_rotation_directions_and_delta() -> None:
    seen: list[Placing] = []

    def noted(placing: Placing) -> float:
        seen.append(placing)
        return 1.0

    remedy(noted, spec=SPEC.with_values(rotation_deg=30.0, directions=8)).options()
    assert seen[0] == Placing(rotation_deg=30.0, displacement_mm=SPEC.displacement_mm, directions=8)


def least_of_delta(factor: float, more_mm: float = 0.0) -> Pitch:
    return lambda placing: factor * placing.displacement_mm + more_mm


@pytest.mark.parametrize(
    ("factor", "more_mm", "largest"),
    [
        (6.1, 0.0, 0.245),  # 1.5 / 6.1 = 0.2459
        (5.0, 0.3, 0.24),
        (6.0, 0.0, None),  # met as it is
        (7.1, 0.0, 0.211),  # 1.5 / 7.1 = 0.21127; 14 % of W are 0.21
        (7.2, 0.0, None),
    ],
)
def test_a_smaller_delta_is_the_largest_that_does(factor: float, more_mm: float, largest: float | None) -> None:
    found = remedy(least_of_delta(factor, more_mm)).smaller()
    assert found == largest
    if found is not None:
        assert factor * found + more_mm <= 1.5005 < factor * (found + 0.001) + more_mm


@pytest.mark.parametrize(("placed", "largest"), [(False, 0.3), (True, None)])
def test_of_eight_directions_placed_parts_need_a_delta_that_their_scatter_leaves(placed: bool, largest: float | None) -> None:
    spec = SPEC.with_values(pitch_mm=2.0, displacement_mm=0.4, code="touch-1", directions=8)
    assert least_displacement_mm() == 0.34
    assert replace(remedy(least_of_delta(6.65), spec=spec), placed=placed).smaller() == largest
    assert replace(remedy(least_of_delta(5.5), spec=spec), placed=placed).smaller() == 0.363


def test_no_delta_below_the_least_share_of_w_is_named() -> None:
    assert remedy(least_of_delta(7.2), spec=SPEC.with_values(displacement_mm=0.209)).smaller() is None
    assert remedy(at_least(None)).smaller() is None


@pytest.mark.parametrize(
    ("pitches", "words"),
    [
        ((least_of_delta(6.1),), "use --w 1.525 --delta 0.25, or --delta 0.245"),
        ((least_of_delta(7.2),), "use --w 1.8 --delta 0.25"),
        ((lambda placing: None if placing.displacement_mm > 0.24 else 1.0,), "use --delta 0.24"),
        ((at_least(None),), ""),
        ((at_least(1.0),), ""),
    ],
)
def test_the_words_of_a_remedy(pitches: Sequence[Pitch], words: str) -> None:
    assert remedy(*pitches).words() == words


# Films and textures


def typed(spec: TapeSpec, options: str) -> TapeSpec:
    words = options.split()
    said = dict(zip(words[::2], words[1::2], strict=True))
    width, height = map(float, said.get("--size", f"{spec.size_mm[0]}x{spec.size_mm[1]}").split("x"))
    pitch_mm, displacement_mm = float(said.get("--w", spec.pitch_mm)), float(said.get("--delta", spec.displacement_mm))
    return spec.with_values(pitch_mm=pitch_mm, displacement_mm=displacement_mm, size_mm=(width, height))


def blocking(findings: Sequence[Finding]) -> set[str]:
    return {finding.rule for finding in findings if finding.blocks}


DESIGNS: list[dict[str, Any]] = [
    {"rotation_deg": 0.0, "coverlay": "per-part"},
    {"rotation_deg": 0.0},
    {"fab": "jlcpcb-fpc", "coverlay": "per-part"},
    {"fab": "generic-lpi", "rotation_deg": 20.0, "displacement_mm": 0.3},
    {"fab": "generic-fr4", "pitch_mm": 1.0, "displacement_mm": 0.25},
    {"anchor": "spur", "rotation_deg": 0.0, "coverlay": "per-part"},
    {"anchor": "mesh", "pitch_mm": 1.2, "displacement_mm": 0.2, "coverlay": "per-part"},
    {"process": "sla", "rotation_deg": 0.0, "pitch_mm": 1.2, "displacement_mm": 0.2},
]


@pytest.mark.parametrize("values", DESIGNS, ids=str)
def test_a_film_keeps_every_rule_that_blocks_from_the_named_w_on(values: dict[str, Any]) -> None:
    spec = TapeSpec(sector=7, size_mm=(30.0, 20.0), tag="none", **values)
    examined = examine(spec)
    options = film_remedy(examined.spec, examined.fab, PART).options()
    assert options
    again = typed(spec, options)
    assert blocking(examine(again).findings) == set()
    less = replace_pitch(again, -0.003)
    assert blocking(examine(less).findings) or examine(less).fab.coverlay_mode != examine(again).fab.coverlay_mode or spec.form


def replace_pitch(spec: TapeSpec, by_mm: float) -> TapeSpec:
    return spec.with_values(pitch_mm=round(spec.pitch_mm + by_mm, 3))


def test_rules_that_are_named_hold_without_a_warning() -> None:
    spec = SPEC.with_values(pitch_mm=1.0, displacement_mm=0.2)
    for rule, warn_mm in (("pad-pad", 0.15), ("body-body", 0.25)):
        options = film_remedy(spec, FAB.in_mode("gang"), PART, [rule]).options()
        assert options
        at_w = typed(spec, options)
        gap_mm = next(f.value for f in examine(at_w.with_values(coverlay="gang")).findings if f.rule == rule)
        assert gap_mm is not None and warn_mm - 0.0005 <= gap_mm
        plain = film_remedy(spec, FAB.in_mode("gang"), PART).options()
        assert plain is not None and (plain == "" or typed(spec, plain).pitch_mm <= at_w.pitch_mm)


def test_more_rules_count_as_well() -> None:
    assert film_remedy(SPEC, FAB.in_mode("gang"), PART, more=[at_least(3.21)]).options() == "--w 3.21 --delta 0.25"


def test_models_keep_bodies_in_their_cells() -> None:
    bare = TapeSpec(sector=7, size_mm=(30.0, 20.0), tag="none", models=False).with_values(
        rotation_deg=0.0, coverlay="gang", pitch_mm=1.0
    )
    solid = TapeSpec(sector=7, size_mm=(30.0, 20.0), tag="none").with_values(rotation_deg=0.0, coverlay="gang", pitch_mm=1.0)
    assert bare.form is None and solid.form is not None
    limits = {**FAB.limits, **{rule: replace(FAB.limits[rule], level="warn") for rule in GAPS}}
    fab = replace(FAB.in_mode("gang"), limits=limits)  # nothing else blocks
    cell_mm = cell_pitch_mm(PART, Placing(rotation_deg=0.0, displacement_mm=0.25, directions=4))
    assert film_remedy(bare, fab, PART).options() == "" and cell_mm > 1.0
    assert typed(solid, film_remedy(solid, fab, PART).options() or "").pitch_mm == pytest.approx(cell_mm, abs=0.001)


def test_an_anchor_is_held_by_a_coverlay_opened_by_part() -> None:
    spec = SPEC.with_values(rotation_deg=0.0, anchor="spur")
    gang, by_part = (typed(spec, film_remedy(spec, FAB.in_mode(mode), PART).options() or "") for mode in ("gang", "per-part"))
    assert gang == by_part
    unanchored = film_remedy(SPEC.with_values(rotation_deg=0.0), FAB.in_mode("gang"), PART).options()
    assert unanchored is not None and typed(spec, unanchored).pitch_mm < gang.pitch_mm


def test_feet_of_a_texture_are_apart_and_within_their_cells() -> None:
    process, dome = load_process("fdm"), element("dome")
    spec = TapeSpec(sector=7, size_mm=(30.0, 20.0), part="dome", process="fdm", pitch_mm=1.0, displacement_mm=0.2)
    for gap_mm, pitch_mm in ((0.6, 0.6 + 0.6 + 0.4), (0.0, 0.6 + 0.4 + 0.004)):
        options = texture_remedy(spec, process, dome, gap_mm).options()
        assert options is not None and options.startswith(f"--w {pitch_mm:g} --delta 0.2")


# Words


def test_parts_come_by_size_and_as_they_fit() -> None:
    shipped = [part for part in map(read_part, profile_names("parts")) if isinstance(part, PartProfile)]
    found = list(film_parts(lambda part: part.body_mm[0] > 0.5))
    assert found == sorted((part for part in shipped if part.body_mm[0] > 0.5), key=lambda part: part.body_mm)
    assert [part.name for part in found[:2]] == ["r0201", "c0201"]


def with_limit(rule: str, value_mm: float, fab: FabProfile = FAB) -> FabProfile:
    return replace(fab, limits={**fab.limits, rule: replace(fab.limits[rule], value_mm=value_mm)})


def test_parts_may_be_turned_where_that_is_enough() -> None:
    flat = SPEC.with_values(rotation_deg=0.0)
    said = wider_words(flat, FAB, PART, "opening-bridge")
    assert said.startswith("use --w ") and said.endswith(", or --rotation 45")
    unturned = wider_words(flat, FAB, PART, "opening-bridge", may_turn=False)
    assert unturned == said.removesuffix(", or --rotation 45")
    assert "--rotation" not in wider_words(SPEC.with_values(pitch_mm=1.0), FAB, PART, "opening-bridge")
    assert "--rotation" not in wider_words(flat.with_values(pitch_mm=1.0), FAB, PART, "opening-bridge")
    nothing = wider_words(flat, with_limit("opening-bridge", 30.0), PART, "opening-bridge")
    assert nothing == "no W up to 20 mm does; use another --part"


def test_one_opening_for_all_parts_is_a_way_out_of_small_ones() -> None:
    small = SPEC.with_values(part="r01005")
    assert opening_words(small, FAB, 0.5) == "use --coverlay gang, or --part r0201"
    assert opening_words(small.with_values(anchor="spur"), FAB, 0.5).startswith("use --part r0201")
    rigid = replace(FAB, coverlay_modes=("per-part",))
    assert opening_words(small, rigid, 0.5) == "use --part r0201"
    assert opening_words(small, rigid, 0.51).startswith("use --part r0402 --w ")
    assert opening_words(small, rigid, 9.0) == "ask the fab, or write a profile of a part with wider pads"


def test_another_part_is_one_that_fits_at_a_w_that_it_needs() -> None:
    def larger(part: PartProfile) -> bool:
        return part.body_mm[0] > 0.5

    small = SPEC.with_values(part="r01005", rotation_deg=0.0)
    options = film_remedy(small, FAB, PART, ["opening-bridge"]).options()
    (smallest, *_) = film_parts(larger)
    assert part_words(small, FAB, larger, "that fits") == f"use --part {smallest.name} {options}"
    assert part_words(small, FAB.in_mode("gang"), larger, "that fits") != f"use --part {smallest.name} {options}"
    assert part_words(SPEC, FAB, larger, "that fits") == "use --part c0201"
    assert part_words(SPEC, FAB, lambda part: part.body_mm[0] > 9.0, "that fits").startswith("ask the fab, or write a profile")
