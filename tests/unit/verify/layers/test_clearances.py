"""Clearances by the few shapes that can decide them equal those by brute force over all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from tactape_fab.kit.film.gaps import gaps_mm, pen_strokes, polygons
from tactape_fab.kit.film.label import stroke_text
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import inset_mm, rounded_rectangle
from tactape_fab.verify.layers.board import outermost
from tactape_fab.verify.layers.lands import pair_lands
from tests.tapes import tape_at


@pytest.mark.parametrize("seed", range(20))
def test_outermost_stamps_hold_the_one_nearest_to_the_outline(seed: int) -> None:
    random = np.random.default_rng(seed)
    tape = tape_at(3, (8, 6))
    board = replace(tape.board, corner_radius_mm=float(random.choice([0.0, 1.0, 3.0])))
    tape = replace(tape, board=board)
    places = random.uniform(-2.0 if seed % 2 else 1.0, np.array(board.size_mm) - 1.0, (200, 2))
    outline = rounded_rectangle((0.9, 0.3), 0.1) + random.uniform(-0.5, 0.5, 2)

    def inset(points_mm: FloatArray) -> float:
        return float(inset_mm(points_mm, board.size_mm, board.corner_radius_mm).min())

    found = outermost(places, outline, tape)
    assert inset(found) == inset((places[:, None] + outline).reshape(-1, 2))
    assert 0 < len(found) < 200 * len(outline)


def test_nothing_stamped_is_nowhere() -> None:
    assert outermost(np.empty((0, 2)), rounded_rectangle((1.0, 1.0)), tape_at(3, (8, 6))).shape == (0, 2)


@pytest.mark.parametrize("seed", range(10))
def test_gaps_are_those_from_all_ink_joined(seed: int) -> None:
    random = np.random.default_rng(seed)
    areas = [rounded_rectangle((1.0, 0.5)) + xy for xy in random.uniform(0.0, 10.0, (12, 2))]
    lines = [np.cumsum(random.normal(size=(n, 2)), axis=0) for n in random.integers(2, 9, 7)]
    widths = random.uniform(0.1, 0.4, 7)
    ink = np.concatenate([polygons(areas), pen_strokes(lines, widths)])
    drawn = [shapely.Polygon(area) for area in areas]
    drawn += [shapely.LineString(line).buffer(width / 2) for line, width in zip(lines, widths, strict=True)]
    shapes = polygons([rounded_rectangle((0.8, 0.6), 0.1) + xy for xy in random.uniform(-5.0, 20.0, (40, 2))])
    expected = shapely.distance(shapely.union_all(drawn), shapes)
    assert np.abs(gaps_mm(shapes, ink) - expected).max() < 1e-12
    assert expected.max() > 0.0


def test_gaps_without_ink_are_infinite() -> None:
    assert gaps_mm(polygons([rounded_rectangle((1.0, 1.0))]), polygons([])).tolist() == [np.inf]
    assert len(pen_strokes([], np.empty(0))) == 0


def test_a_land_has_one_partner_and_the_nearest() -> None:
    step = 0.64
    pads = np.array([(0.0, 0.0), (step, 0.0), (5.0, 0.0), (5.0 + step, 0.0), (5.02, 0.0), (9.0, 0.0), (9.0 + step + 0.11, 0.0)])
    pairs = pair_lands(pads, step / 2, 0.0)
    assert sorted(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)) == [(0, 1), (2, 3)]
    assert pairs.alone.tolist() == [4, 5, 6]


def test_delta_is_the_hershey_font_s() -> None:
    from HersheyFonts import HersheyFonts

    font = HersheyFonts()
    font.load_default_font("greeks")
    glyph = font.all_glyphs["D"]
    text = stroke_text("Δ", 21.0)
    assert text.width_mm == glyph.char_width
    expected = [[[x - glyph.left_offset, 9 - y] for x, y in stroke] for stroke in glyph.strokes]
    assert [stroke.tolist() for stroke in text.strokes_mm] == expected
