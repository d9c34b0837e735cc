"""Words of the fab drawing: those of a kit pass, and one word, figure or line that differs is named."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec, make_kit
from tactape_fab.base.fields import Fields
from tactape_fab.verify.film import read_film_manifest
from tactape_fab.verify.layers.drawing_words import in_ascii, lean, word_problems
from tactape_fab.verify.layers.drawings import _read_pdf
from tactape_fab.verify.layers.kicad import Shown, shown_tape
from tactape_fab.verify.layers.kicad_drawn import Made

HOLES = [(2.0, 3.0 + 2.5 * k, 1.0) for k in range(10)]
SPECS: dict[str, dict[str, Any]] = {
    "plain": {},
    "backed": {"size_mm": (60.0, 30.0), "tag": "none", "holes_mm": HOLES, "stiffener": "FR4 0.2", "adhesive": "3M468 0.13"},
    "one window": {"fab": "jlcpcb-fpc", "adhesive": "3M9077 0.05", "size_mm": (60.0, 30.0)},
    "anchored": {"anchor": "spur"},
}


@cache
def written(name: str) -> tuple[str, Shown, Made]:
    """Words of a kit's drawing, and what is expected of them."""
    with TemporaryDirectory() as folder:
        spec = TapeSpec(sector=7, models=False, **{"size_mm": (40.0, 30.0), **SPECS[name]})
        kit = make_kit(spec, Path(folder) / "k", verify=False)
        manifest = json.loads((kit.path / "manifest.json").read_text())
        (file,) = (row for row in manifest["files"] if row["role"] == "fab-drawing")
        words = _read_pdf((kit.path / file["path"]).read_bytes())
    record = read_film_manifest(Fields(manifest))
    made = Made(name=kit.tape.name, tape=kit.tape, record=record, gerbers={}, radius_mm=kit.tape.board.corner_radius_mm)
    return words, shown_tape(kit.tape, np.empty((0, 2, 2)), 0.0), made


@pytest.mark.parametrize("name", SPECS)
def test_words_of_a_kit_are_its_manifest_s(name: str) -> None:
    assert word_problems(*written(name)) == []


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("side 60 30 ", "side 60 31 ", 'where "OUTLINE, seen from the parts\' side 60 30" should stand and go on'),
        ("radius 1 (4x) ", "", "where 'radius 1 (4x)' should stand"),
        (" field 5", " field 4", "does not hold all parts"),
        (" A radius", " field A radius", "it says '"),
        ("W 1.5 R1", "W 1.6 R1", "where 'A: the first parts,' should"),
        ("N, S, E or W", "in one of 8 directions", "where 'Circle: land 1. Each part stands 0.25 N, S, E or W of it"),
        ("stands 0.25", "stands 0.2", "where 'Circle: land 1"),
        ("one part 45? 1 0.6", "one part 90? 1 0.6", "where 'B: one part 45"),
        (
            "0.46 x 0.4, centres at ?0.32",
            "0.46 x 0.4, centres at ?0.33",
            'where "lands 0.46 x 0.4, centres at ?0.32 from the part\'s." should',
        ),
        ("All parts turned 45?", "Parts, tape by tape, turned 45?", "where 'All parts turned 45' should"),
        ("R_0201_0603Metric, height", "R_0402_1005Metric, height", "where 'LAYERS, from the top parts"),
        (
            "661 openings of 1.2 x 0.5, never merged",
            "one opening for all parts",
            "where 'coverlay amber; 661 openings of 1.2 x 0.5, never merged' should",
        ),
        (
            "coverlay opening 1.2 x 0.5",
            "one window in the coverlay for all parts",
            "where 'Body 0.6 x 0.3 x 0.23; coverlay opening 1.2 x 0.5;' should",
        ),
        (
            "Openings of the coverlay are not merged. Ask before",
            "The coverlay has one opening for all parts, on purpose. Ask before",
            "where '5. Op",
        ),
        ("copper 18 ?m", "copper 35 ?m", "where 'copper 18 ?m, one layer, ENIG; least spacing' should"),
        ("ENIG", "HASL", "where 'copper 18 ?m, one layer, ENIG; least spacing' should"),
        ("least spacing 0.18", "least spacing 0.181", ""),
        ("least spacing 0.18", "least spacing 0.182", "its least spacing of 0.182 mm is more than between the lands of a part"),
        ("base polyimide", "base FR4", "where 'base polyimide; film 0.11 thick in all' should"),
        ("stiffener FR4 0.2 mm, whole", "stiffener none, whole", "where 'stiffener FR4 0.2 mm, whole underside' should"),
        (
            "adhesive 3M468 0.13 mm under the stiffener",
            "adhesive 3M468 0.13 mm, whole underside",
            "where 'adhesive 3M468 0.13 mm",
        ),
        ("adhesive 3M468 0.13 mm under the stiffener ", "", "where 'adhesive 3M468 0.13 mm under the stiffener' should"),
        ("stiffener adhesive part coverlay base", "part coverlay base", "where 'stiffener adhesive part coverlay base' should"),
        ("and 2 more in the drill file", "and 3 more in the drill file", "should stand and go on"),
        ("x 2.000 y 3.000", "x 2.001 y 3.000", "its holes are not the kit's"),
        ("x 2.000 y 3.000", "x 2.0005 y 3.000", ""),
        ("x 2.000 y 3.000", "x 2.000 y 28.000", "its holes are not the kit's"),
        ("x 2.000 y 5.500", "x 2.000 y 3.000", "its holes are not the kit's"),
        ("leans like this: /", "leans like this: |", "where 'Seen from above, every part leans like this: /' should"),
        ("file are counter-clockwise", "file are clockwise", "where '2"),
        (
            "Pads stand alone on purpose.",
            "Copper runs on from the pads under the coverlay to hold them: it is no track.",
            "where '3. The",
        ),
        ("Pads stand alone on purpose. ", "", "where '3"),
        (
            "date codes: none on the tape.",
            "date codes: only within the short dashes, better none.",
            "where 'Either land may be land 1",
        ),
        ("Ask before a bridge", "Widen a bridge", "where '5"),
        ("Title tactape-s007", "Title tactape-s008", "where 'Title tactape-s007' should"),
        ("sector 7 of microdots-4x4", "sector 8 of microdots-4x4", "where 'Texture sector 7 of microdots-4x4"),
        ("; all dimensions in mm", "; all dimensions in inches", "where 'Scale outline' should"),
        ("sheet 1 of 1, A4", "sheet 1 of 2, A4", "where 'Date, tool' should"),
        ("sheet 1 of 1, A4 ", "sheet 1 of 1, A4 use FR4 ", "it says more than it should"),
    ],
)
def test_a_word_that_differs_is_named(old: str, new: str, says: str) -> None:
    words, expected, made = written("backed")
    assert old in words
    said = "; ".join(word_problems(words.replace(old, new, 1), expected, made))
    assert bool(said) == bool(says) and says in said, said


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("one window", "one window in the coverlay for all parts", "coverlay opening 1.2 x 0.5"),
        ("one window", "; one opening for all parts copper", "; 561 openings of 1.2 x 0.5, never merged copper"),
        (
            "one window",
            "The coverlay has one opening for all parts, on purpose.",
            "Openings of the coverlay are not merged. Ask before a bridge between two of them is changed.",
        ),
        (
            "anchored",
            "Copper runs on from the pads under the coverlay to hold them: it is no track.",
            "Pads stand alone on purpose.",
        ),
        ("anchored", "Copper runs on from the pads", "Copper runs on from some pads"),
    ],
)
def test_words_of_another_film_are_refused(name: str, old: str, new: str) -> None:
    """They ask the fab to merge openings, or to keep them apart, or to remove copper, against the layers."""
    words, expected, made = written(name)
    assert old in words
    (said,) = word_problems(words.replace(old, new), expected, made)
    assert "should stand and go on" in said


def test_words_that_are_of_one_kind_of_kit_are_asked_of_it() -> None:
    words, expected, made = written("plain")
    # a board with square corners, and parts along x, do not say so
    square, along = replace(made, radius_mm=0.0), replace(expected, rotation_deg=np.zeros_like(expected.rotation_deg))
    assert word_problems(words.replace("radius 1 (4x) ", ""), expected, square) == []
    flat = words.replace("part 45? 1", "part 1").replace("turned 45?", "turned 0?").replace("like this: /", "like this: -")
    assert word_problems(flat, along, made) == [] and word_problems(flat, expected, made) != []
    # parts that are as wide as long lean nowhere
    part = replace(made.tape.part, body_mm=(0.5, 0.5, 0.23))
    even = words.replace(" Seen from above, every part leans like this: /", "").replace(
        "1 0.6 Body 0.6 x 0.3", "1 0.5 Body 0.5 x 0.5"
    )
    assert word_problems(even, expected, replace(made, tape=replace(made.tape, part=part))) == []
    # a kit whose fab is not known leaves the fab's words open
    unknown = replace(made, record=replace(made.record, order=None, legend=None))
    other = words.replace("base polyimide", "base FR4").replace("legend white, lines of 0.15", "legend black, lines of 0.3")
    assert word_problems(other, expected, unknown) == [] and word_problems(other, expected, made) != []
    # turned tapes of a panel
    turned = replace(expected, rotation_deg=np.where(np.arange(len(expected.parts_xy_mm)) % 2, 45.0, 135.0))
    tapes = words.replace("All parts turned 45?", "Parts, tape by tape, turned 45? or 135?").replace("part 45? 1", "part 135? 1")
    tapes = tapes.replace("like this: /", "like this: / or, on turned tapes, \\")
    assert word_problems(tapes, turned, made) == []
    # without ink there is none, and nobody knows without the layer
    bare = words.replace("legend white, lines of 0.15 or more", "legend none")
    inked, empty = SimpleNamespace(areas_mm=[np.zeros((3, 2))], strokes_mm=()), SimpleNamespace(areas_mm=(), strokes_mm=())
    layers: list[dict[str, Any]] = [{}, {"legend-top": inked}, {"legend-top": empty}]
    for gerbers, says_none, says_white in zip(layers, (True, False, True), (True, True, False), strict=True):
        known = replace(made, gerbers=gerbers)
        assert [not word_problems(each, expected, known) for each in (bare, words)] == [says_none, says_white]


@pytest.mark.parametrize(
    ("left_mm", "right_mm", "holds"), [(-0.001, 0.001, True), (0.001, 0.001, False), (-0.001, -0.001, False)]
)
def test_a_field_holds_the_bodies_of_all_parts(left_mm: float, right_mm: float, holds: bool) -> None:
    words, expected, made = written("plain")
    # a body of 0.6 x 0.3 mm at 45 degrees reaches so far
    x_mm, reach_mm = expected.parts_xy_mm[:, 0], 0.45 / 2**0.5
    low, high = x_mm.min() - reach_mm + left_mm, x_mm.max() + reach_mm + right_mm
    assert " 6 field 33.3 A" in words
    said = word_problems(words.replace(" 6 field 33.3 A", f" {low:.6f} field {high - low:.6f} A"), expected, made)
    assert [bool("does not hold all parts" in each) for each in said] == ([] if holds else [True])


@pytest.mark.parametrize(
    ("rotation_deg", "sign"),
    [(0.0, "-"), (22.0, "-"), (23.0, "/"), (45.0, "/"), (90.0, "|"), (135.0, "\\"), (170.0, "-"), (-45.0, "\\")],
)
def test_a_part_leans_as_it_is_turned(rotation_deg: float, sign: str) -> None:
    assert lean(rotation_deg) == sign


def test_what_the_page_s_font_has_not_is_a_question_mark() -> None:
    assert in_ascii("18 µm ~ \t") == "18 ?m ~ ?"
