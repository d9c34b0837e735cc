"""Outline, edges, holes and the component layer: what is right passes, and one statement changed at a time is named."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Tape, TapeSpec
from tactape_fab.base.errors import Check
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.profiles import LandPattern
from tactape_fab.kit.read.gerber_file import GerberContent, read_gerber
from tactape_fab.kit.writer import render_all
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import rotate
from tactape_fab.verify.layers.board import (
    check_components,
    check_drill,
    check_edges,
    check_legend_clear,
    check_outline,
    check_part_data,
)
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly
from tactape_fab.verify.layers.lands import Recorded
from tests.tapes import tape_at

PART = "R5"
_BLOCK = re.compile(rf"%TO\.C,{PART}\*%.*?%TD\.P\*%\n", re.DOTALL)
_CORNERS = re.compile(r"(X\d+Y\d+)D02\*\n(X\d+Y\d+)D01\*\n(X\d+Y\d+)D01\*\n(X\d+Y\d+)D01\*\n(X\d+Y\d+)D01\*\n")
BODY, CENTRE_OR_PIN = "the body of a part ", "a centre or pin is flashed with another aperture"


def outline(order: str) -> str:
    """The corners of a body in another order, as a template of `re.sub`."""
    return rf"\{order[0]}D02*\n" + "".join(rf"\{k}D01*\n" for k in order[1:])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda block: block, ""),
        (lambda block: _CORNERS.sub(outline("23412"), block), ""),
        (lambda block: _CORNERS.sub(outline("13241"), block), BODY),
        (lambda block: _CORNERS.sub(outline("12221"), block), BODY),
        (lambda block: _CORNERS.sub(outline("12343"), block), BODY),
        (lambda block: block.replace("D11*\n", ""), BODY),
        (lambda block: _CORNERS.sub("", block), "it does not draw one body for each part"),
        (lambda block: block.replace("D12*\n", ""), CENTRE_OR_PIN),
        (lambda block: block.replace("D13*\n", ""), CENTRE_OR_PIN),
        (lambda block: block.replace("D10*\n", "D12*\n"), CENTRE_OR_PIN),
        (lambda block: block.replace("R5,1", "R5,2"), "its pins are not 1 and 2 of each part"),
        (lambda block: block.replace("P,R5,", "P,R6,"), "its pins are not 1 and 2 of each part"),
        (lambda block: block.replace("X15573726Y", "X15577726Y"), "a pin does not stand on its pad"),
    ],
)
def test_a_part_s_body_and_pins_are_drawn_as_the_standard_has_them(change: Callable[[str], str], says: str) -> None:
    check = part_data(lambda text: _BLOCK.sub(lambda found: change(found[0]), text))
    assert check.passed != bool(says) and says in check.message


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("ADD10C,0.300000", "ADD10C,0.302000", CENTRE_OR_PIN),
        ("ADD12P,0.360000", "ADD12P,0.364000", CENTRE_OR_PIN),
        ("ADD11C,0.100000", "ADD11C,0.102000", "the body of a part is drawn with another aperture"),
        ("CRot,45", "CRot,135", "it says .CRot '135', which the manifest does not"),
        ("%TO.CHgt,0.23*%\n", "", "a value twice, or not at all, which the manifest does not"),
    ],
)
def test_what_all_parts_share_is_as_the_standard_and_the_manifest_have_it(old: str, new: str, says: str) -> None:
    check = part_data(lambda text: text.replace(old, new))
    assert not check.passed and says in check.message


def part_data(change: Callable[[str], str]) -> Check:
    """What is said of a component layer of which something is changed."""
    made = examine(TapeSpec(sector=7, size_mm=(26.0, 20.0), pitch_mm=2.2, displacement_mm=0.3, models=False))
    part = made.drawing.part
    (layer,) = (a for a in render_all(made.drawing, made.fab) if isinstance(a, Artifact) and a.role == "components-top")
    text = layer.data.decode("ascii")
    data = change(text).encode("ascii")
    names = {"value": part.value, "footprint": part.footprint, "description": part.description}
    recorded = RecordedAssembly(format="generic", part_number="", **names)
    return check_part_data(read_gerber(data), data, made.tape, recorded, part.pads)


TAPE = tape_at(7, (6, 5))  # 15 x 13.5 mm
SIZE_MM = TAPE.board.size_mm
ROUND = replace(TAPE, board=replace(TAPE.board, corner_radius_mm=2.0))
LAND = LandPattern(size_mm=(0.46, 0.40), corner_radius_mm=0.1, offset_mm=0.32)
RECORDED = Recorded(pads=LAND, paste=LAND, expansion_mm=0.05, pad_edge_mm=0.3, body_edge_mm=1.0, opening_legend_mm=0.15)
PLACES = TAPE.part_xy_mm()
SQUARE = 0.2 * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
ONE = np.zeros((0, 2))


def drawn(
    *strokes: FloatArray,
    width_mm: float = 0.1,
    flashes: FloatArray = ONE,
    areas: tuple[FloatArray, ...] = (),
    clear: bool = False,
) -> GerberContent:
    """A layer: lines of one width, flashes of a square of 0.4 mm that are the centres of parts, areas."""
    return GerberContent(
        flash_xy_mm=flashes,
        flash_aperture=np.zeros(len(flashes), dtype=np.int64),
        aperture_outlines_mm=(SQUARE,) if len(flashes) else (),
        areas_mm=areas,
        strokes_mm=strokes,
        stroke_width_mm=np.full(len(strokes), width_mm),
        aperture_functions=("ComponentMain,x",) if len(flashes) else (),
        flash_component=tuple(TAPE.designators()[: len(flashes)]),
        flash_pin=("",) * len(flashes),
        clear=clear,
        file_attributes={},
    )


def rounded(radius_mm: float, steps: int = 200) -> FloatArray:
    """Closed outline of the board by sines and cosines."""
    width, height = SIZE_MM
    angle = np.linspace(0.0, np.pi / 2, steps)
    arc = np.column_stack([np.cos(angle), np.sin(angle)])
    corners = [(width, height), (0.0, height), (0.0, 0.0), (width, 0.0)]
    line = [
        np.clip(corner, radius_mm, np.subtract(SIZE_MM, radius_mm)) + radius_mm * rotate(arc, 90.0 * k)
        for k, corner in enumerate(corners)
    ]
    return np.concatenate([*line, line[0][:1]])


RIGHT = np.array([(0.0, 0.0), (15.0, 0.0), (15.0, 13.5), (0.0, 13.5), (0.0, 0.0)])


def with_point(x: float, y: float) -> FloatArray:
    return np.insert(RIGHT, 1, (x, y), axis=0)


@pytest.mark.parametrize(
    ("content", "tape", "says"),
    [
        (drawn(RIGHT), TAPE, ""),
        (drawn(RIGHT * (1.0, 1.00007)), TAPE, ""),  # 0.95 um, of 1 um
        (drawn(rounded(2.0)), ROUND, ""),
        (drawn(RIGHT * (1.0, 1.00008)), TAPE, "closed, 15 x 13.5011 mm, 0.001 mm from the manifest's outline"),
        (drawn(RIGHT), ROUND, "closed, 15 x 13.5 mm, 0.828 mm"),  # 2 (sqrt 2 - 1)
        (drawn(rounded(2.0)), TAPE, "0.828 mm from"),
        (drawn(rounded(2.0, 9)), ROUND, "0.010 mm from"),  # 2 (1 - cos of a sixteenth of 90 deg)
        (drawn(with_point(7.0, 0.3)), TAPE, "0.300 mm from"),
        (drawn(with_point(7.0, -0.2)), TAPE, "0.200 mm from"),
        (drawn(RIGHT[:-1]), TAPE, "not closed"),
        (drawn(RIGHT[[0, 1, 0]]), TAPE, "not closed"),
        (drawn(RIGHT + (np.arange(5) == 4)[:, None] * 1e-6), TAPE, "not closed"),
        (drawn(RIGHT[[0, 2, 1, 3, 0]]), TAPE, "crosses itself"),
        (drawn(), TAPE, "0 contours instead of one"),
        (drawn(RIGHT, RIGHT), TAPE, "2 contours"),
        (drawn(RIGHT, flashes=PLACES), TAPE, "contours instead of one"),
        (drawn(RIGHT, areas=(RIGHT,)), TAPE, "contours instead of one"),
        (drawn(RIGHT, clear=True), TAPE, "clear polarity"),
        (drawn(RIGHT, width_mm=0.15), TAPE, "its line is 0.050 mm wider or narrower than 0.1 mm"),
    ],
)
def test_an_outline_is_one_closed_line_of_the_tape_s_size(content: GerberContent, tape: Tape, says: str) -> None:
    check = check_outline(content, tape)
    assert check.passed != bool(says) and says in check.message


def cpl(places: FloatArray = PLACES, angle: float = 45.0) -> Any:
    return SimpleNamespace(
        xy_mm=places, rotation_deg=np.full(len(places), angle), designators=tuple(TAPE.designators()[: len(places)])
    )


def moved(index: int, x: float, y: float) -> FloatArray:
    places = PLACES.copy()
    places[index] = x, y
    return places


@pytest.mark.parametrize(
    ("role", "content", "figure", "passed"),
    [
        ("copper-top", drawn(flashes=moved(3, 7.0, 0.7)), 0.5, True),
        ("copper-top", drawn(flashes=moved(3, 14.5, 7.0)), 0.3, True),
        ("copper-top", drawn(flashes=moved(3, 14.5004, 7.0)), 0.2996, True),
        ("copper-top", drawn(flashes=moved(3, 14.501, 7.0)), 0.299, False),
        ("coverlay-top", drawn(areas=(RIGHT,)), 0.0, True),
        ("coverlay-top", drawn(areas=(RIGHT - (0.1, 0.0),)), -0.1, False),
        ("paste-top", drawn(RIGHT[:2] + 0.25), -0.25, False),
        ("legend-top", drawn(RIGHT[:2] * 0.5 + 1.0), 1.0, True),
    ],
)
def test_layers_keep_their_distance_from_the_outline(role: str, content: GerberContent, figure: float, passed: bool) -> None:
    layers = {"copper-top": drawn(flashes=PLACES), role: content}
    checks = {check.name: check for check in check_edges(layers, RECORDED, TAPE, cpl())}
    assert list(checks) == [*dict.fromkeys(["copper-top to edge", f"{role} to edge", "bodies to edge"])]
    found = checks[f"{role} to edge"]
    assert found.figure == pytest.approx(figure, abs=1e-9) and found.passed is passed
    assert passed or ", less than 0" in found.message


@pytest.mark.parametrize(("angle", "reach_mm"), [(0.0, 0.15), (90.0, 0.3), (45.0, 0.45 / 2**0.5)])
def test_bodies_keep_their_distance_from_the_outline(angle: float, reach_mm: float) -> None:
    """Half of 0.6 x 0.3 mm, turned, below a part that is 1.4 mm from the lower edge; of 1 mm."""
    for y, passed in ((1.0 + reach_mm, True), (0.999 + reach_mm, False)):
        check = check_edges({"copper-top": drawn()}, RECORDED, TAPE, cpl(moved(2, 7.0, y), angle))[-1]
        assert check.figure == pytest.approx(y - reach_mm) and check.passed is passed


@pytest.mark.parametrize("x", [5.3, 5.35, 5.3496, 5.349, 4.9])
@pytest.mark.parametrize("turn", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("area", [False, True])
def test_ink_keeps_its_distance_from_openings(x: float, turn: float, area: bool) -> None:
    """An opening from -0.2 to 0.2 mm about 5, 5; ink beside it is a line of 0.1 mm or an area."""
    line = np.array([(x - 5.0 + 0.05, -1.0), (x - 5.0 + 0.05, 1.0)])
    around = np.concatenate([np.subtract(line, (0.05, 0.0)), np.add(line[::-1], (3.0, 0.0))])
    at = np.array([5.0, 5.0])
    ink = drawn(areas=(rotate(around, turn) + at,)) if area else drawn(rotate(line, turn) + at)
    coverlay = drawn(flashes=np.array([(5.0, 5.0), (40.0, 5.0), (-40.0, 5.0)]))
    check = check_legend_clear(ink, coverlay, RECORDED)
    assert check.figure == pytest.approx(max(x - 5.2, 0.0), abs=1e-9)
    assert check.passed is (x > 5.3495)
    far = check_legend_clear(ink, drawn(flashes=np.array([(40.0, 5.0)])), RECORDED)
    assert far.passed and "far from every opening" in far.message


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (drawn(flashes=PLACES), "30 parts within 0.000 um of the CPL"),
        (drawn(flashes=PLACES + 0.0003), "30 parts within 0.424 um of the CPL"),
        (drawn(flashes=moved(4, *(PLACES[4] + (0.3, 0.4)))), "1 parts are off the CPL: R5 by 500.0 um"),
        (drawn(flashes=PLACES[:-1]), "its designators differ from the CPL's: R30"),
        (replace(drawn(flashes=PLACES), flash_component=("R2", "R1", *TAPE.designators()[2:])), "the CPL's: their order"),
        (drawn(), "its designators differ"),
    ],
)
def test_parts_of_the_component_layer_are_those_of_the_list(content: GerberContent, says: str) -> None:
    check = check_components(content, cpl())
    assert check.passed == ("within" in says) and says in check.message


HOLES = ((3.0, 4.0, 2.0), (8.0, 4.0, 1.5))


@pytest.mark.parametrize(
    ("found", "says"),
    [
        (HOLES, "2 holes as in the manifest"),
        (HOLES[::-1], "2 holes as in the manifest"),
        (HOLES[:1], "(8, 4) d 1.5 mm is missing"),
        ((*HOLES, (8.0, 9.0, 1.5)), "(8, 9) d 1.5 mm is not in the manifest"),
        ((HOLES[0], (8.0, 4.0, 1.6)), "(8, 4) d 1.5 mm is missing, (8, 4) d 1.6 mm is not in the manifest"),
        ((HOLES[0], *HOLES), "3 holes where the manifest has 2"),
    ],
)
def test_holes_are_those_of_the_manifest(found: tuple[tuple[float, float, float], ...], says: str) -> None:
    check = check_drill(np.array(found), replace(TAPE, board=replace(TAPE.board, holes=HOLES)))
    assert check.passed == ("as in" in says) and says in check.message and check.figure == len(found)
