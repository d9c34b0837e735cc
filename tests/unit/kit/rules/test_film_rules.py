"""Rules of a film other than gaps: each figure recounted here, met down to half a micrometre, with the remedy that it names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import hypot, sqrt
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.base.errors import Finding, SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.profiles import FabProfile, load_fab, load_part
from tactape_fab.kit.rules.film_rules import assembly_findings, film_findings, film_problems
from tests.unit.kit.test_plan import FAB, PART

HALF_UM = 0.0005


def spec_of(**values: Any) -> TapeSpec:
    return TapeSpec(**{"sector": 7, "size_mm": (30.0, 20.0), "tag": "none", "models": False, **values})


def found(values: dict[str, Any], fab: FabProfile | None = None) -> dict[str, Finding]:
    """Findings of this module by rule, measured by a changed profile where one is given."""
    examined = examine(spec_of(**values))
    return {f.rule: f for f in film_findings(examined.layout, examined.spec, fab or examined.fab)}


# Options that contradict the fab


def problems(fab: FabProfile = FAB, **values: Any) -> dict[str, str]:
    spec = spec_of().with_values(**values)
    return {problem.key: problem.message for problem in film_problems(spec, fab, PART)}


def test_what_a_fab_does_not_do_is_refused_with_what_does() -> None:
    assert problems() == {}
    said = problems(coverlay="lpi")["coverlay"]
    assert said == "coverlay = 'lpi' is not what generic-fpc does; leave out --coverlay, or --fab generic-lpi"
    narrow = problems(coverlay="lpi", pitch_mm=1.0, displacement_mm=0.25)["coverlay"]
    assert narrow.endswith("or --fab generic-lpi --w 1.349 --delta 0.25")
    assert problems(load_fab("generic-lpi"), coverlay="per-part")["coverlay"].endswith(
        "; leave out --coverlay, or --fab generic-fpc"
    )
    assert problems(replace(FAB, coverlay_modes=("per-part",)), coverlay="gang")["coverlay"].endswith(
        "does; leave out --coverlay"
    )
    assert "coverlay" not in problems(coverlay="gang") and "coverlay" not in problems(coverlay="per-part")


def test_backings_are_those_of_the_fab() -> None:
    assert problems(stiffener="PI 0.1", adhesive="3M468 0.13") == {}
    assert problems(adhesive="tape 1")["adhesive"] == (
        "adhesive = 'tape:1' is not available; generic-fpc has: 3M9077:0.05, tesa8854:0.1, 3M468:0.13; give one of them"
    )
    rigid = problems(load_fab("generic-fr4"), stiffener="PI 0.1")["stiffener"]
    assert rigid.endswith("generic-fr4 has none; leave out --stiffener")


def test_a_rigid_board_is_not_bent() -> None:
    assert "bend_radius_mm" not in problems(bend_radius_mm=20.0, bend_axis="x")
    said = problems(load_fab("generic-fr4"), bend_radius_mm=20.0, bend_axis="x")["bend_radius_mm"]
    assert said.startswith("bend_radius_mm = 20 mm contradicts fab = 'generic-fr4'")
    assert said.endswith(", or use --fab generic-fpc")
    by_coverlay = {"lpi": ", or use --fab generic-lpi", "gang": ", or use --fab generic-fpc"}
    for coverlay, ways in by_coverlay.items():
        asked = problems(load_fab("generic-fr4"), bend_radius_mm=20.0, bend_axis="x", coverlay=coverlay)
        assert asked["bend_radius_mm"].endswith(ways)


def test_a_mesh_needs_parts_along_the_diagonals() -> None:
    for rotation_deg in (45.0, 135.0, 225.0):
        assert problems(anchor="mesh", rotation_deg=rotation_deg) == {}
    assert problems(anchor="spur", rotation_deg=30.0) == {}
    said = problems(anchor="mesh", rotation_deg=30.0)["anchor"]
    ways = said.partition("; use ")[2].split(", or ")
    assert [way.split(" --w")[0] for way in ways] == ["--rotation 45", "--anchor spur", "--anchor none"]
    assert said.startswith("anchor = 'mesh' contradicts rotation_deg = 30 deg")
    wide = replace(FAB, limits={**FAB.limits, "pad-pad": replace(FAB.limits["pad-pad"], value_mm=30.0)})
    assert problems(wide, anchor="mesh", rotation_deg=30.0)["anchor"].endswith("the parts; use --anchor none")


@pytest.mark.parametrize(
    ("refused", "says", "typed"),
    [
        ({"coverlay": "per-part"}, "; use --size 15.5x10 without --coverlay, or --fab generic-fpc", {}),
        ({"anchor": "mesh"}, ", or --anchor none --size 15.5x10", {"anchor": "none"}),
    ],
)
def test_a_way_out_has_the_outline_that_it_needs(refused: dict[str, Any], says: str, typed: dict[str, Any]) -> None:
    """What is wrong with the size depends on the refused option, and is not told beside it."""
    values: dict[str, Any] = {"tag": "strip", "fab": "generic-fr4", "pitch_mm": 2.2, "rotation_deg": 30.0}
    with pytest.raises(SpecError) as caught:
        examine(spec_of(**values, size_mm=(12.0, 10.0), **refused))
    (problem,) = caught.value.problems
    assert says in problem.message
    assert examine(spec_of(**values, size_mm=(15.5, 10.0), **typed)).tape.part_count
    with pytest.raises(SpecError, match="too small"):
        examine(spec_of(**values, size_mm=(12.0, 10.0), **typed))


def test_no_anchor_is_told_where_openings_are_too_small_to_hold_one() -> None:
    with pytest.raises(SpecError, match=r"the parts; use --anchor none$"):
        examine(spec_of(fab="jlcpcb-fpc", part="r01005", anchor="mesh", rotation_deg=30.0, pitch_mm=2.2))


# Coverlay and anchors


def test_each_way_of_opening_says_whether_it_is_legal_and_from_which_w_on() -> None:
    rules = found({"pitch_mm": 1.45, "displacement_mm": 0.25})
    by_part, gang, mask = (rules[f"coverlay-{mode}"] for mode in ("per-part", "gang", "lpi"))
    assert (by_part.passed, by_part.value, by_part.limit, by_part.level) == (False, 1.45, 1.49, "info")
    assert by_part.message.startswith("not legal at W 1.45 mm: ") and by_part.message.endswith("; use --w 1.49 --delta 0.25")
    assert (gang.passed, gang.value, gang.limit) == (True, None, None)
    assert gang.message == "legal at W 1.45 mm: no coverlay holds a pad down"
    assert (mask.passed, mask.value) == (False, None) and mask.message.endswith("; use --fab generic-lpi")
    chosen = rules["coverlay"]
    assert (chosen.level, chosen.passed) == ("warn", False)
    assert chosen.message.startswith("the first legal way to open the coverlay is gang, which holds no pad down; per-part: ")
    assert chosen.message.endswith("; use --w 1.49 --delta 0.25")


def test_a_way_that_was_asked_for_is_said_so() -> None:
    assert found({"coverlay": "gang"})["coverlay"].message == "coverlay gang, as asked for"
    usual = found({})["coverlay"]
    assert (usual.message, usual.level, usual.passed) == ("coverlay per-part, the first legal way of generic-fpc", "info", True)
    other = found({"coverlay": "gang", "pitch_mm": 1.45, "displacement_mm": 0.25})["coverlay-per-part"]
    assert other.message.endswith("; use --coverlay per-part --w 1.49 --delta 0.25")


def test_a_part_with_small_openings_names_one_with_wider_pads() -> None:
    rules = found({"part": "r01005"})
    by_part = rules["coverlay-per-part"]
    assert by_part.value is None and by_part.message.endswith("; use --part r0201")
    assert "; use" not in rules["coverlay-lpi"].message  # its openings are too small for that fab, too


def test_ways_of_anchoring_say_what_they_need() -> None:
    rules = found({})
    assert rules["anchor"].value == 0.0 and rules["anchor"].message.startswith("0% of ")
    assert rules["anchor-spur"].passed is True and "anchor-opening" not in rules
    mesh = rules["anchor-mesh"]
    assert not mesh.passed and mesh.message.partition("; use ")[2].startswith("--anchor mesh --w ")
    turned = found({"rotation_deg": 0.0, "pitch_mm": 2.2, "displacement_mm": 0.25})["anchor-mesh"]
    assert turned.message.partition("; use ")[2].startswith("--anchor mesh --rotation 45")
    diagonal = found({"rotation_deg": 135.0})["anchor-mesh"]
    assert not diagonal.passed and diagonal.message.partition("; use ")[2].startswith("--anchor mesh --w ")
    gang = found({"coverlay": "gang"})
    assert "; use" not in gang["anchor-spur"].message


@pytest.mark.parametrize("anchor", ["spur", "mesh"])
def test_anchors_hold_every_pad_and_keep_clear_of_openings(anchor: str) -> None:
    values = {"anchor": anchor, "pitch_mm": 2.2, "displacement_mm": 0.25}
    rules = found(values)
    assert rules["anchor"].value == 1.0 and rules["anchor"].message.startswith("100% of ")
    gap = rules["anchor-opening"]
    assert gap.passed and gap.value is not None and gap.limit == 0.15 and gap.value >= 0.15
    assert ("anchor-copper" in rules) == (anchor == "spur")
    for above_mm, passed in ((0.0, True), (0.0004, True), (0.0006, False)):
        fab = replace(FAB, anchor=replace(FAB.anchor, opening_mm=gap.value + above_mm))
        finding = found(values, fab)["anchor-opening"]
        assert finding.passed is passed and finding.limit == pytest.approx(gap.value + above_mm)
        assert finding.message.endswith("--anchor none") is not passed
    if anchor == "spur":
        copper = rules["anchor-copper"]
        assert copper.value is not None and copper.passed
        for above_mm, passed in ((0.0004, True), (0.0006, False)):
            limits = {**FAB.limits, "pad-pad": replace(FAB.limits["pad-pad"], value_mm=copper.value + above_mm, warn_mm=None)}
            finding = found(values, replace(FAB, limits=limits))["anchor-copper"]
            assert finding.passed is passed and finding.message.endswith(", or --anchor none") is not passed


def test_one_opening_for_all_holds_no_anchor() -> None:
    rules = found({"anchor": "spur", "pitch_mm": 1.3, "displacement_mm": 0.25})
    refused = rules["anchor-opening"]
    assert (refused.passed, refused.level) == (False, "block")
    assert refused.message.startswith(
        "anchor spur: coverlay gang leaves nothing to hold it, per-part with it is legal further apart"
    )
    assert refused.message.partition("; use ")[2].startswith("--w ") and refused.message.endswith(", or --anchor none")


# Legend, stencil, chips


@pytest.mark.parametrize(("above_mm", "passed"), [(0.0, True), (0.00049, True), (0.00051, False), (0.05, False)])
def test_ink_of_the_tag_is_as_wide_as_a_line(above_mm: float, passed: bool) -> None:
    values = {"tag": "strip", "size_mm": (40.0, 20.0)}
    examined = examine(spec_of(**values))
    assert examined.tape.tag is not None
    ink_mm = examined.tape.tag.cell_mm - 2 * FAB.legend.bleed_mm
    fab = replace(FAB, legend=replace(FAB.legend, line_mm=ink_mm + above_mm))
    finding = found(values, fab)["legend-line"]
    assert (finding.value, finding.passed, finding.level) == (ink_mm, passed, "block")
    if not passed:
        cell_mm = float(finding.message.partition("--tag-cell ")[2].split()[0])
        assert cell_mm - 2 * FAB.legend.bleed_mm == pytest.approx(ink_mm + above_mm, abs=0.0011)
        assert cell_mm - 2 * FAB.legend.bleed_mm >= ink_mm + above_mm - 1e-9
        assert "--size" not in finding.message


@pytest.mark.parametrize(("above_mm", "passed"), [(-0.001, True), (0.0, False), (10.0, False)])
def test_a_gap_of_the_legend_leaves_ink_in_every_cell(above_mm: float, passed: bool) -> None:
    """Without a rule, `make` wrote a kit whose tag nobody reads, or none, and `verify` did not name the key."""
    values = {"tag": "strip", "size_mm": (40.0, 20.0)}
    tag = examine(spec_of(**values)).tape.tag
    assert tag is not None
    gap_mm = tag.cell_mm * sqrt(2.0) - 2 * FAB.legend.bleed_mm + above_mm
    fab = replace(FAB, legend=replace(FAB.legend, gap_mm=gap_mm))
    assert ("legend-gap" not in found(values, fab)) is passed
    if not passed:
        finding = found(values, fab)["legend-gap"]
        assert (finding.level, finding.value, finding.passed) == ("block", gap_mm, False)
        assert f"legend.gap_mm = {gap_mm:g} mm of {FAB.name}" in finding.message
        assert finding.message.endswith("use --tag none, or a profile with gap_mm + 2 bleed_mm below 0.707 mm")
        assert "legend-gap" not in found({"tag": "none"}, fab)


def test_a_wider_tag_may_need_a_larger_outline() -> None:
    values = {"tag": "strip", "size_mm": (20.0, 12.0)}
    fab = replace(FAB, legend=replace(FAB.legend, line_mm=1.5))
    assert "--tag-cell 1.6 --size " in found(values, fab)["legend-line"].message


@pytest.mark.parametrize(("above", "passed"), [(0.0, True), (1e-9, False)])
def test_paste_leaves_an_aperture_of_enough_area(above: float, passed: bool) -> None:
    outline = examine(spec_of()).layout.outlines.paste
    closed = np.concatenate([outline, outline[:1]])
    area = abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in pairwise(closed))) / 2
    walls = sum(hypot(*(b - a)) for a, b in pairwise(closed)) * FAB.stencil.thickness_mm
    rules = replace(FAB.stencil, least_ratio=found({})["paste-ratio"].value + above)  # type: ignore[operator]
    finding = found({}, replace(FAB, stencil=rules))["paste-ratio"]
    assert finding.value == pytest.approx(area / walls) and finding.passed is passed
    assert ("with 0.1 mm foil; " in finding.message) is not passed
    assert passed or finding.message.endswith("; use --part r0402 --w 1.83 --delta 0.25")


def test_a_part_with_more_paste_is_named() -> None:
    finding = found({"part": "r01005"})["paste-ratio"]
    assert not finding.passed and finding.message.endswith("; use --part r0201")


@pytest.mark.parametrize(("least_mm", "passed"), [(0.6, True), (0.6004, True), (0.6006, False)])
def test_a_chip_is_no_smaller_than_the_line_places(least_mm: float, passed: bool) -> None:
    fab = replace(FAB, parts=replace(FAB.parts, smallest_mm=least_mm))
    finding = found({}, fab)["chip-size"]
    assert (finding.value, finding.limit, finding.passed, finding.level) == (0.6, least_mm, passed, "warn")
    small = found({"part": "r01005"})["chip-size"]
    assert small.message.endswith("; ask generic-fpc whether they place it, or use --part r0201")


@pytest.mark.parametrize(("name", "word"), [("Palm_Outline", "Outline"), ("thumb_cup", "b_cu"), ("pin2.cu", "in2.cu")])
def test_a_name_by_which_viewers_tell_layers_is_warned_of(name: str, word: str) -> None:
    finding = found({"name": name})["file-name"]
    assert (finding.level, finding.passed) == ("warn", False)
    assert finding.message.startswith(f"name = '{name}' has '{word}', ") and finding.message.endswith("; use another --name")
    assert "file-name" not in found({"name": "palm_top"})


# Assembly


def assembled(board_mm: tuple[float, float], count: int = 10, fab: FabProfile = FAB) -> tuple[Finding, Finding]:
    few, size = assembly_findings(board_mm, count, fab)
    assert (few.rule, size.rule) == ("part-count", "assembly-size")
    return few, size


@pytest.mark.parametrize(
    ("board_mm", "value", "limit"),
    [
        ((60.0, 55.0), 60.0, 70.0),
        ((55.0, 60.0), 60.0, 70.0),
        ((80.0, 40.0), 40.0, 50.0),
        ((60.0, 40.0), 40.0, 50.0),
        ((200.0, 120.0), 120.0, 100.0),
        ((300.0, 80.0), 300.0, 250.0),
        ((300.0, 120.0), 300.0, 250.0),
        ((300.0, 40.0), 300.0, 250.0),
    ],
)
def test_the_size_is_that_of_a_side_that_is_out_of_range(board_mm: tuple[float, float], value: float, limit: float) -> None:
    panel = replace(FAB.panel, smallest_mm=(70.0, 50.0), largest_mm=(250.0, 100.0))
    _, size = assembled(board_mm, fab=replace(FAB, panel=panel))
    assert (size.value, size.limit, size.passed) == (value, limit, False)


def test_so_many_parts_are_asked_for() -> None:
    for count, passed in ((299, True), (300, True), (301, False)):
        few, _ = assembled((100.0, 100.0), count)
        assert (few.passed, few.value, few.limit) == (passed, count, 300)
        assert few.message == f"{count} parts" + ("" if passed else ", more than 300: ask generic-fpc whether they take so many")


@pytest.mark.parametrize(
    ("board_mm", "value", "limit", "remedy"),
    [
        ((100.0, 80.0), 80.0, 70.0, None),
        ((70.0, 70.0), 70.0, 70.0, None),
        ((70.0, 69.9996), 69.9996, 70.0, None),
        ((250.0, 250.0), 250.0, 70.0, None),
        ((250.0004, 80.0), 80.0, 70.0, None),
        ((70.0, 69.9), 69.9, 70.0, "order it in a panel"),
        ((50.0, 236.0), 50.0, 70.0, "order it in a panel"),
        ((50.0, 236.1), 50.0, 70.0, "ask the line, or use --size 50x236 --panel auto"),
        ((240.0, 50.0), 50.0, 70.0, "ask the line, or use --size 236x50 --panel auto"),
        ((251.0, 80.0), 251.0, 250.0, "ask the line, or use --size 250x80"),
        ((80.0, 251.0), 251.0, 250.0, "ask the line, or use --size 80x250"),
        ((300.0, 50.0), 300.0, 250.0, "ask the line, or use --size 236x50 --panel auto"),
        ((260.0, 255.0), 260.0, 250.0, "ask the line, or use --size 250x250"),
    ],
)
def test_what_assembly_takes(board_mm: tuple[float, float], value: float, limit: float, remedy: str | None) -> None:
    _, size = assembled(board_mm)
    assert (size.value, size.limit, size.passed) == (value, limit, remedy is None)
    assert size.message.partition("; the tape is ")[2].partition("; ")[2] == (remedy or "")


@pytest.mark.parametrize("board_mm", [(40.0, 30.0), (300.0, 50.0)])
def test_no_size_is_proposed_where_the_fab_makes_no_panel_that_assembly_takes(board_mm: tuple[float, float]) -> None:
    small = replace(FAB, size=replace(FAB.size, largest_mm=(100.0, 60.0)))  # assembly takes 70 x 70 mm and more
    _, size = assembled(board_mm, fab=small)
    assert not size.passed and size.message.endswith(" mm; ask the line")


def test_what_is_ordered_is_named() -> None:
    _, size = assembly_findings((100.0, 80.0), 1, FAB, "panel")
    assert size.message == "assembly takes 70 x 70 to 250 x 250 mm; the panel is 100 x 80 mm"
    _, size = assembly_findings((80.0, 100.0), 1, FAB, "panel")  # width and height, as the order notes have them
    assert size.message == "assembly takes 70 x 70 to 250 x 250 mm; the panel is 80 x 100 mm"


# Bending


@pytest.mark.parametrize(
    ("radius_mm", "passed"), [(1.1, True), (1.0996, True), (1.0994, False), (0.5, False)]
)  # ten times 0.11 mm of film
def test_a_film_is_bent_no_tighter_than_ten_thicknesses(radius_mm: float, passed: bool) -> None:
    finding = found({"bend_radius_mm": radius_mm, "bend_axis": "x"})["bend-radius"]
    assert (finding.value, finding.passed, finding.level) == (radius_mm, passed, "warn")
    assert finding.limit == pytest.approx(1.1)
    assert finding.message.endswith("; bend it less, --bend-radius 1.1") is not passed


def test_what_is_laminated_counts() -> None:
    values = {"bend_radius_mm": 2.0, "bend_axis": "y", "stiffener": "PI 0.1", "adhesive": "3M468 0.13"}
    finding = found(values)["bend-radius"]
    assert finding.limit == pytest.approx(10 * (0.11 + 0.1 + 0.13)) and finding.message.endswith("--bend-radius 3.4")
    assert "bend-radius" not in found({})


def test_the_bow_under_a_body_is_that_of_a_circle() -> None:
    for axis, along_mm in (("x", 0.6), ("y", 0.3)):
        rules = found({"bend_radius_mm": 5.0, "bend_axis": axis, "rotation_deg": 0.0, "pitch_mm": 2.2, "displacement_mm": 0.25})
        sag_mm = 5.0 - (25.0 - (along_mm / 2) ** 2) ** 0.5
        assert rules["bend-part"].value == pytest.approx(sag_mm, rel=1e-3)
        assert f"under a body, {along_mm:.2f} mm along {axis}" in rules["bend-part"].message and rules["bend-part"].passed
    tight = found({"bend_radius_mm": 0.45, "bend_axis": "x", "rotation_deg": 0.0, "pitch_mm": 2.2, "displacement_mm": 0.25})
    assert tight["bend-part"].message.endswith("the film would bow by 100.0 um")


def test_problems_come_together() -> None:
    with pytest.raises(SpecError) as caught:
        examine(spec_of(coverlay="lpi", stiffener="PI:9", anchor="mesh", rotation_deg=0.0))
    keys: Sequence[str | None] = [problem.key for problem in caught.value.problems]
    assert {"coverlay", "anchor"} <= set(keys)
    assert load_part("r0201") == PART
