"""Lands, openings and their names as layers have them: a right layer passes each line, and one change fails one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shapely import Polygon, box

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.kit.profiles import LandPattern
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import placed_outline, rotate
from tactape_fab.verify.layers.lands import (
    Recorded,
    _outline_axis_deg,
    _turn_deg,
    apart_mm,
    check_lands,
    check_openings,
    opening_outline,
    outlines_apart_mm,
    pair_lands,
    point_tree,
    read_recorded,
)
from tests.tapes import tape_at

TAPE = tape_at(7, (6, 5))
LAND = LandPattern(size_mm=(0.46, 0.40), corner_radius_mm=0.1, offset_mm=0.32)
RECORDED = Recorded(pads=LAND, paste=LAND, expansion_mm=0.05, pad_edge_mm=0.3, body_edge_mm=1.0, opening_legend_mm=0.15)
PLACES = TAPE.part_xy_mm()
STEP = rotate((LAND.offset_mm, 0.0), TAPE.part.rotation_deg)


def cpl(places: FloatArray = PLACES) -> Any:
    rotation = np.full(len(places), TAPE.part.rotation_deg)
    return SimpleNamespace(xy_mm=places, rotation_deg=rotation, designators=tuple(f"R{i + 1}" for i in range(len(places))))


def layer(places: FloatArray, outline: FloatArray, names: bool = True) -> GerberContent:
    count = len(places)
    return GerberContent(
        flash_xy_mm=places,
        flash_aperture=np.zeros(count, dtype=np.int64),
        aperture_outlines_mm=(outline,),
        areas_mm=(),
        strokes_mm=(),
        stroke_width_mm=np.empty(0),
        aperture_functions=("",),
        flash_component=tuple(f"R{i // 2 + 1}" if names else "" for i in range(count)),
        flash_pin=tuple("12"[i % 2] if names else "" for i in range(count)),
        clear=False,
        file_attributes={},
    )


def copper(places: FloatArray = PLACES) -> GerberContent:
    flashes = np.stack([places - STEP, places + STEP], axis=1).reshape(-1, 2)
    return layer(flashes, placed_outline(LAND.size_mm, LAND.corner_radius_mm, TAPE.part.rotation_deg))


def lands_of(content: GerberContent, *, places: FloatArray = PLACES, lines: bool = False) -> dict[str, Check]:
    pairs = pair_lands(content.flash_xy_mm, LAND.offset_mm, TAPE.part.rotation_deg)
    of_cpl = cpl(places)
    checks = check_lands("copper", content, pairs, LAND, TAPE, of_cpl, point_tree(of_cpl.xy_mm), lines=lines)
    return {check.name: check for check in checks}


LINES = {f"copper {what}" for what in ("pairs", "places", "rotation", "area", "shape", "names")}


@pytest.mark.parametrize("along", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize(("by_mm", "passed"), [(0.0009, True), (0.0011, False), (0.04, False)])
def test_lands_that_move_to_either_side_of_their_place_are_off(along: tuple[float, float], by_mm: float, passed: bool) -> None:
    content = copper()
    moved = content.flash_xy_mm.copy()
    away = by_mm * rotate(along, TAPE.part.rotation_deg)
    moved[8:10] += np.stack([-away, away])
    found = lands_of(replace(content, flash_xy_mm=moved))["copper places"]
    assert found.passed is passed
    if not passed:
        assert found.message == f"lands of 1 parts are off, worst by {by_mm * 1000:.1f} um at R5"


def test_a_right_layer_passes_every_line_with_its_figure() -> None:
    found = lands_of(copper())
    assert set(found) == LINES and all(check.passed for check in found.values())
    assert found["copper pairs"].figure == 30.0 and found["copper pairs"].message == "30 pairs for 30 parts"
    assert found["copper area"].figure == pytest.approx(0.0, abs=1.0)
    assert found["copper places"].figure == pytest.approx(0.0, abs=1e-6)
    unnamed = replace(copper(), flash_component=("",) * 60, flash_pin=("",) * 60)
    assert set(lands_of(unnamed)) == LINES - {"copper names"}


def moved(index: int, by_mm: tuple[float, float]) -> Callable[[GerberContent], GerberContent]:
    def change(content: GerberContent) -> GerberContent:
        flashes = content.flash_xy_mm.copy()
        flashes[index] += by_mm
        return replace(content, flash_xy_mm=flashes)

    return change


def scaled(factor: float) -> Callable[[GerberContent], GerberContent]:
    return lambda content: replace(content, aperture_outlines_mm=(content.aperture_outlines_mm[0] * factor,))


def turned(content: GerberContent) -> GerberContent:
    return replace(content, aperture_outlines_mm=(placed_outline(LAND.size_mm, LAND.corner_radius_mm, 46.0),))


LINE = (np.array([(0.0, 0.0), (1.0, 1.0)]),)


@pytest.mark.parametrize(
    ("change", "failed"),
    [
        (moved(4, (0.0009, 0.0)), set()),
        (moved(4, (0.0042, 0.0)), {"places", "rotation"}),
        (moved(4, (0.05, 0.0)), {"places", "rotation"}),
        (moved(4, (0.3, 0.0)), {"pairs", "places"}),
        (scaled(1.002), set()),
        (scaled(1.02), {"area", "shape"}),
        (turned, {"rotation", "shape"}),
        (lambda c: replace(c, clear=True), {"pairs"}),
        (lambda c: replace(c, areas_mm=(np.eye(3, 2),)), {"pairs"}),
        (lambda c: replace(c, strokes_mm=LINE), {"pairs"}),
        (lambda c: replace(c, aperture_outlines_mm=c.aperture_outlines_mm * 2), {"pairs"}),
        (lambda c: replace(c, flash_component=("R2", *c.flash_component[1:])), {"names"}),
        (lambda c: replace(c, flash_pin=("2", *c.flash_pin[1:])), {"names"}),
        (lambda c: replace(c, flash_pin=(c.flash_pin[0], "1", *c.flash_pin[2:])), {"names"}),
    ],
)
def test_one_change_fails_the_lines_that_it_concerns(change: Callable[[GerberContent], GerberContent], failed: set[str]) -> None:
    found = lands_of(change(copper()))
    assert {name.removeprefix("copper ") for name, check in found.items() if not check.passed} == failed


def test_lines_are_no_pads_unless_anchors_are_drawn() -> None:
    drawn = replace(copper(), strokes_mm=LINE)
    assert lands_of(drawn, lines=True)["copper pairs"].passed
    said = lands_of(drawn)["copper pairs"].message
    assert said == "objects that are not pads"


def test_missing_and_doubled_pairs_are_named() -> None:
    fewer = lands_of(copper(PLACES[1:]))
    assert fewer["copper pairs"].message == "58 flashes where 30 parts need 60"
    assert fewer["copper places"].message == "no pair stands at R1" and not fewer["copper area"].passed
    double = np.concatenate([PLACES, PLACES[:1] + 0.2])
    assert "two pairs stand at R1" in lands_of(copper(double))["copper places"].message
    alone = lands_of(replace(copper(), flash_xy_mm=copper().flash_xy_mm[:-1], flash_aperture=np.zeros(59, dtype=np.int64)))
    assert "1 flashes have no partner, first at (" in alone["copper pairs"].message
    one = lands_of(copper(PLACES[:1]), places=PLACES[:1])
    assert set(one) == LINES and one["copper places"].passed
    assert set(lands_of(copper(), places=PLACES[:1])) == LINES
    assert set(lands_of(copper(), places=PLACES[:0])) == {"copper pairs"} == set(lands_of(copper(PLACES[:0])))
    flat = lands_of(scaled(0.0)(copper()))
    assert set(flat) == {"copper pairs"} and flat["copper pairs"].message == "an aperture without area"


def test_the_worst_pair_is_named_with_its_place() -> None:
    content = moved(9, (0.004, 0.0))(moved(4, (0.0042, 0.0))(copper()))
    x, y = PLACES[2] + np.array([0.0021, 0.0])
    said = lands_of(content)["copper places"]
    assert said.message == f"2 pairs are off the CPL, worst by 2.1 um at R3 ({x:.3f}, {y:.3f}) mm"
    assert said.figure == pytest.approx(2.1)


def test_outlines_and_areas_that_differ_say_by_how_much() -> None:
    off = copper().aperture_outlines_mm[0] + rotate((0.0, 0.0421), TAPE.part.rotation_deg)
    shape = lands_of(replace(copper(), aperture_outlines_mm=(off,)))["copper shape"]
    assert shape.figure == pytest.approx(42.1, abs=0.01) and shape.message == "outline off by 42.1 um of the manifest's"
    assert lands_of(copper())["copper shape"].message == "outline within 0.0 um of the manifest's"
    area = lands_of(scaled(1.05)(copper()))["copper area"]
    right = lands_of(copper())["copper area"].figure
    assert right is not None and area.figure == pytest.approx(1.05**2 * (100.0 + right) - 100.0)
    assert area.message.endswith(f"specified ({area.figure:+.2f} %)")


def test_outlines_whose_corners_alone_lie_on_the_right_one_are_off() -> None:
    right = box(-2.0, -1.0, 2.0, 1.0)
    slit = [(-2, -1), (2, -1), (2, 1), (0.001, 1), (0.001, -0.9995), (-0.001, -0.9995), (-0.001, 1), (-2, 1)]
    assert outlines_apart_mm(Polygon(slit), right) == pytest.approx(1.0, abs=0.01)
    sliver = [(-2, -1), (2, -1), (2, 1), (-2, 1), (-2, -0.999), (-1.9995, -0.999), (-1.9995, 0.9995), (1.9995, 0.9995)]
    assert outlines_apart_mm(Polygon([*sliver, (1.9995, -0.9995), (-1.9999, -0.9995)]), right) > 0.5
    swapped = copper().aperture_outlines_mm[0].copy()
    swapped[[1, 2]] = swapped[[2, 1]]
    assert lands_of(replace(copper(), aperture_outlines_mm=(swapped,)))["copper shape"].message.endswith("; it crosses itself")


def test_one_aperture_of_two_without_area_is_enough() -> None:
    for outlines in ((np.zeros((4, 2)), copper().aperture_outlines_mm[0]), (copper().aperture_outlines_mm[0], np.zeros((4, 2)))):
        found = lands_of(replace(copper(), aperture_outlines_mm=outlines))
        assert set(found) == {"copper pairs"} and "an aperture without area" in found["copper pairs"].message


def openings_of(content: GerberContent, places: FloatArray = PLACES) -> dict[str, Check]:
    of_cpl = cpl(places)
    found = check_openings(content, RECORDED, TAPE, of_cpl, point_tree(of_cpl.xy_mm) if len(places) else point_tree(PLACES))
    return {check.name.removeprefix("coverlay-top "): check for check in found}


def test_openings_are_round_both_pads_of_each_part() -> None:
    content = layer(PLACES, opening_outline(RECORDED, TAPE), names=False)
    right = openings_of(content)
    assert set(right) == {"openings", "places", "shape"} and all(check.passed for check in right.values())
    corners = rotate(opening_outline(RECORDED, TAPE), -TAPE.part.rotation_deg)
    assert np.abs(corners).max(axis=0) == pytest.approx([0.32 + 0.23 + 0.05, 0.20 + 0.05], abs=2e-6)
    for change, failed in (
        (moved(3, (0.002, 0.0)), {"places"}),
        (scaled(1.01), {"shape"}),
        (lambda c: replace(c, clear=True), {"openings"}),
        (lambda c: replace(c, areas_mm=(np.eye(3, 2),)), {"openings"}),
        (lambda c: replace(c, strokes_mm=LINE), {"openings"}),
        (lambda c: replace(c, aperture_outlines_mm=c.aperture_outlines_mm * 2), {"openings"}),
    ):
        assert {name for name, check in openings_of(change(content)).items() if not check.passed} == failed
    fewer = layer(PLACES[1:], opening_outline(RECORDED, TAPE), names=False)
    assert openings_of(fewer)["openings"].message == "29 openings for 30 parts"
    assert set(openings_of(layer(PLACES[:1], opening_outline(RECORDED, TAPE)), PLACES[:1])) == {"openings", "places", "shape"}
    assert set(openings_of(scaled(0.0)(content))) == {"openings"} == set(openings_of(content, PLACES[:0]))


# Places and pairs


def test_a_pair_may_come_in_either_order_and_chains_are_split_from_their_starts() -> None:
    pairs = pair_lands(np.array([(0.64, 0.0), (0.0, 0.0)]), 0.32, 0.0)
    assert (pairs.first.tolist(), pairs.second.tolist(), pairs.alone.tolist()) == ([1], [0], [])
    chain = pair_lands(np.array([(0.64 * k, 0.0) for k in (3, 0, 2, 1, 4)]), 0.32, 0.0)
    assert sorted(zip(chain.first.tolist(), chain.second.tolist(), strict=True)) == [(1, 3), (2, 0)] and chain.alone.tolist() == [
        4
    ]
    for count in (0, 1):
        assert pair_lands(np.zeros((count, 2)), 0.32, 0.0).alone.tolist() == list(range(count))


def test_the_farthest_of_all_points_from_the_other_s_counts() -> None:
    points = np.array([(0.0, 0.0, 1.0), (5.0, 0.0, 1.0)])
    assert apart_mm(points, points[::-1]) == 0.0
    assert apart_mm(points, points[:1]) == apart_mm(points[:1], points) == 5.0
    assert apart_mm(points, points + np.array([0.0, 0.3, 0.0])) == pytest.approx(0.3)
    assert apart_mm(points, points + np.array([0.0, 0.0, 0.7])) == pytest.approx(0.7)
    assert (apart_mm(points[:0], points[:0]), apart_mm(points, points[:0]), apart_mm(points[:0], points)) == (0.0, np.inf, np.inf)


def manifest(expansion_mm: float = 0.05, edge_mm: float = 0.3) -> dict[str, Any]:
    land = {"size_mm": [0.46, 0.4], "corner_radius_mm": 0.1, "offset_mm": 0.32}
    limits = {"pad-edge": edge_mm, "body-edge": edge_mm, "opening-legend": edge_mm}
    return {
        "land_pattern": {"pads": land, "paste": land, "opening_expansion_mm": expansion_mm},
        "fab": {"limits_mm": limits},
    }


def test_records_are_read_with_their_bounds() -> None:
    found = read_recorded(table := Fields(manifest()))
    assert not table.problems and replace(found, body_edge_mm=1.0, opening_legend_mm=0.15) == RECORDED
    for content, wrong in (
        (manifest(expansion_mm=0.0, edge_mm=0.0), 0),
        (manifest(expansion_mm=1.0, edge_mm=100.0), 0),
        (manifest(expansion_mm=1.01), 1),
        (manifest(expansion_mm=-0.01), 1),
        (manifest(edge_mm=100.5), 3),
        (manifest(edge_mm=-0.01), 3),
    ):
        read_recorded(table := Fields(content))
        assert len(table.problems) == wrong


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 89.0, 120.0, 179.0, -30.0, -135.0, 225.0, 350.0])
def test_the_angle_of_two_lines_is_that_of_the_lines_and_not_of_their_ends(turn_deg: float) -> None:
    for b in (-170.0, 0.0, 45.0, 200.0):
        angle = np.degrees(np.arccos(min(abs(np.cos(np.radians(turn_deg))), 1.0)))
        assert float(_turn_deg(np.array(b + turn_deg), np.array(b))) == pytest.approx(angle, abs=1e-5)


@pytest.mark.parametrize(
    ("size_mm", "angle_deg"), [((0.46, 0.40), 30.0), ((0.40, 0.46), 30.0), ((0.40, 0.409), None), ((0.409, 0.40), None)]
)
def test_a_land_shows_its_direction_unless_it_is_square(size_mm: tuple[float, float], angle_deg: float | None) -> None:
    land = LandPattern(size_mm=size_mm, corner_radius_mm=0.05, offset_mm=0.32)
    found = _outline_axis_deg(placed_outline(size_mm, 0.05, 30.0), land)
    assert found is None if angle_deg is None else found is not None and found % 180.0 == pytest.approx(angle_deg, abs=0.01)
