"""Colours of bodies, metal and film, learned from a drawn scan, and the mixtures that tell them apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.inspect.colours import LIKE_BODY, Palette, _axis, learn_palette
from tactape_fab.texture.frames import FloatArray
from tests.unit.sense.inspect.test_bodies import BODY, FILM, METAL, TAPE, drawn

COUNT = TAPE.part_count
STILL, ALL = np.zeros((COUNT, 2)), np.ones(COUNT, dtype=bool)
GOLD = np.array([60.0, 170.0, 200.0])


def palette(body: FloatArray = BODY, metal: FloatArray = METAL, film: FloatArray = FILM, *beside: FloatArray) -> Palette:
    return Palette(body=body, metal=metal, film=film, body_axis=_axis(body, metal, film, *beside))


def test_colours_are_learned_although_some_parts_are_gone_or_covered() -> None:
    picture, warp, _ = drawn(STILL, np.zeros(COUNT), METAL, gone=[0, 1, 2, 3], hidden=[10, 11, 12], end_mm=0.4)
    found = learn_palette(picture, warp, TAPE, ALL)
    assert found.body == pytest.approx(BODY, abs=2.0) and found.film == pytest.approx(FILM, abs=2.0)
    assert found.metal == pytest.approx(METAL, abs=8.0)
    few = learn_palette(picture, warp, TAPE, np.arange(COUNT) >= 20)
    assert few.body == pytest.approx(BODY, abs=2.0)


def test_a_scan_that_is_too_bright_or_shows_no_bodies_is_refused() -> None:
    bright, warp, _ = drawn(STILL, np.zeros(COUNT), np.full(3, 270.0), end_mm=0.4)
    with pytest.raises(SpecError, match=r"it is over-exposed: 6\d% of the parts' metal is white, more than 50%"):
        learn_palette(bright, warp, TAPE, ALL)
    dark = np.where(np.abs(bright.astype(float) - FILM).max(axis=2, keepdims=True) > 20, FILM + 20, bright).astype(np.uint8)
    with pytest.raises(SpecError, match=r"bodies do not stand out from the film: RGB 70, 130, 60 against RGB 50, 110, 40"):
        learn_palette(dark, warp, TAPE, ALL)


def test_body_ness_is_1_on_bodies_and_0_on_all_else() -> None:
    colours = np.stack([BODY, FILM, 0.65 * FILM, METAL]).astype(np.float32)
    assert (palette().body_share(colours) > LIKE_BODY).tolist() == [True, False, False, False]
    assert palette().body_share(colours[:2]) == pytest.approx([1.0, 0.0], abs=1e-5)
    assert palette().body_share(np.array([[255, 0, 255], [0, 0, 0]], dtype=np.float32)).max() <= np.float32(1.2)
    # gold in an opening of blue film
    blue, white = np.array([150.0, 70.0, 30.0]), np.full(3, 200.0)
    beside = palette(BODY, white, blue, GOLD)
    assert abs(float(beside.body_share(GOLD.astype(np.float32)))) < 0.3


def test_a_mixture_that_no_shadow_changes() -> None:
    axis = palette().unshaded_axis()
    assert axis is not None
    assert [float(axis @ colour) for colour in (BODY, FILM, 0.3 * FILM)] == pytest.approx([1.0, 0.0, 0.0], abs=1e-5)
    grey = np.full(3, 120.0)
    assert palette(0.3 * grey, 1.5 * grey, grey).unshaded_axis() is None


@pytest.mark.parametrize(("film", "unit"), [(2 * FILM + 20, 460 / 3), (FILM, 0.7 * 195.0)])
def test_brightness_is_in_units_of_the_film_s_or_of_metal_s_beside_dark_film(film: FloatArray, unit: float) -> None:
    assert palette(film=film).grey(np.full((1, 3), 100.0, dtype=np.float32)) == pytest.approx([100.0 / unit], rel=1e-5)


def test_bodies_that_a_mixture_of_film_and_metal_may_be_are_told_by_their_colour() -> None:
    amber, grey, tan, base = (np.array(colour, float) for colour in ((38, 142, 205), (157,) * 3, (90, 120, 150), (20, 92, 140)))
    found = replace(palette(tan, grey, amber), beside=base)
    assert found.like_lands and not palette(np.full(3, 36.0), grey, amber).like_lands
    # on blue film no mixture is tan
    assert not palette(tan, grey, np.array([130.0, 60.0, 30.0])).like_lands
    seen = np.array([tan, 0.9 * tan, base, grey, amber, 0.65 * amber], dtype=np.float32)
    assert found.are_bodies(seen).tolist() == [True, True, False, False, False, False]


def test_bodies_of_the_colour_of_shaded_film_are_refused() -> None:
    """As of a grey scan of chip capacitors."""
    film = np.full(3, 190.0)
    picture, warp, _ = drawn(STILL, np.zeros(COUNT), METAL, end_mm=0.4)
    bodies, open_film = np.abs(picture - BODY).max(axis=2) < 20, np.abs(picture - FILM).max(axis=2) < 20
    picture[bodies], picture[open_film] = 0.65 * film + 3.0, film
    with pytest.raises(SpecError, match="bodies do not stand out from film and lands: RGB 126, 126, 126 against"):
        learn_palette(picture, warp, TAPE, ALL)
