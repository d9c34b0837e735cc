"""Where bodies are in a scan, and which turn a part has that looks like no other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from tactape_fab.sense.inspect import bodies
from tactape_fab.sense.inspect.bodies import _State, fit_bodies
from tactape_fab.sense.inspect.colours import Palette, _axis
from tactape_fab.sense.inspect.warp import Warp, affine_warp
from tactape_fab.texture.frames import FloatArray
from tests.tapes import tape_at


@pytest.mark.parametrize(("across", "turned"), [(0.6, True), (1.5, True), (1.8, False), (2.6, False), (4.0, False)])
def test_a_part_that_fits_a_little_better_across_is_not_turned(
    across: float, turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A good part under glare was listed as turned by 86 degrees, 28 um off at a sigma of 9 um."""

    def moved(_scene: Any, _sites: Any, state: _State, _template: Any, _ends: Any, *, robust: bool) -> tuple[_State, None]:
        assert robust
        misfit = np.where(np.abs(state.turn_deg) > 80.0, across, 9.0)
        return _State(shift_mm=state.shift_mm, turn_deg=state.turn_deg, sigma_mm=state.sigma_mm, misfit=misfit), None

    monkeypatch.setattr(bodies, "_moved", moved)
    state = _State(shift_mm=np.zeros((1, 2)), turn_deg=np.zeros(1), sigma_mm=np.ones((1, 2)), misfit=np.array([2.9]))
    best = bodies._all_turns(None, np.zeros((1, 2)), state, state, np.array([0]), None, None, 1.0)  # type: ignore[arg-type]
    assert (abs(best.turn_deg[0]) > 80.0) == turned


TAPE = tape_at(7, (7, 6))
PX_PER_MM = 40.0
FILM, METAL, BODY = np.array([40.0, 110.0, 50.0]), np.array([190.0, 195.0, 200.0]), np.array([30.0, 28.0, 35.0])


def edge(distance_mm: FloatArray) -> FloatArray:
    return np.asarray(ndtr(distance_mm / 0.025)[..., None], dtype=np.float64)


def drawn(
    shift_mm: FloatArray,
    turn_deg: FloatArray,
    metal: FloatArray,
    gone: Sequence[int] = (),
    hidden: Sequence[int] = (),
    end_mm: float = 0.3,
) -> tuple[Any, Warp, FloatArray]:
    """A scan of parts with metal ends on film, its warp, and the parts' nominal places; a light sticker lies on some; metal
    ends `end_mm` from their middles, beyond 0.3 mm as solder."""
    sites, (width, height) = TAPE.part_xy_mm(), TAPE.board.size_mm
    picture = np.tile(FILM, (round(height * PX_PER_MM), round(width * PX_PER_MM), 1))
    half, rng = round(0.7 * PX_PER_MM), np.random.default_rng(1)
    for k in range(len(sites)):
        at = sites[k] + shift_mm[k]
        u, v = np.rint((at[0] * PX_PER_MM, (height - at[1]) * PX_PER_MM)).astype(int)
        rows, columns = np.mgrid[v - half : v + half, u - half : u + half]
        x, y = columns / PX_PER_MM - at[0], height - rows / PX_PER_MM - at[1]
        turn = np.radians(TAPE.part.rotation_deg + turn_deg[k])
        along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
        inside = edge(end_mm - np.abs(along)) * edge(0.15 - np.abs(across))
        low, high = rng.normal(0.18, 0.01, 2)
        middle = edge(high - along) * edge(low + along)
        part = middle * BODY + (1 - middle) * metal * rng.normal(1.0, 0.05)
        if k in hidden:
            part = part * 0.4 + 0.6 * metal * (along[..., None] > 0)
        if k in gone:  # but for a speck of solder mask beside its place
            inside, part = edge(0.05 - np.hypot(along - 0.2, across - 0.1)), BODY
        picture[rows, columns] = inside * part + (1 - inside) * picture[rows, columns]
    picture = picture + rng.normal(0.0, 2.0, picture.shape)
    warp = affine_warp([(PX_PER_MM, 0.0), (0.0, -PX_PER_MM)], (0.0, height * PX_PER_MM), (0.0, 0.0), 10.0)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), warp, sites


def test_bodies_are_found_to_a_micrometre_whatever_their_metal_ends() -> None:
    """Inner edges of the metal scatter by 10 um, and its brightness by 5 %; a part is gone, one across, one under a sticker."""
    rng = np.random.default_rng(0)
    n, gone, across, hidden = TAPE.part_count, 5, 11, 20
    shift, turn = rng.normal(0.0, 0.03, (n, 2)), rng.normal(0.0, 3.0, n)
    turn[across] = 75.0
    picture, warp, sites = drawn(shift, turn, METAL, [gone], [hidden])
    palette = Palette(body=BODY, metal=METAL, film=FILM, body_axis=_axis(BODY, METAL, FILM))
    found = fit_bodies(picture, warp, TAPE, palette, sites)
    good = np.setdiff1d(np.arange(n), [gone, hidden, across])
    off = found.shift_mm - shift
    assert np.abs(off[good]).max() < 0.003 and np.abs(np.median(off[good], axis=0)).max() < 6e-4
    assert 0.2 < (off[good] ** 2 / found.sigma_mm[good, None] ** 2).mean() < 1.2
    assert found.turn_deg[good] == pytest.approx(turn[good] - np.median(turn[good]), abs=0.25)
    assert found.area[good] == pytest.approx(1.0, abs=0.15) and (found.misfit[good] < 1.0).all()
    assert np.abs(off[across]).max() < 0.01 and found.turn_deg[across] == pytest.approx(turn[across] - np.median(turn), abs=0.3)
    # a speck is no part
    assert found.area[gone] < 0.1 and found.misfit[gone] == np.inf and np.abs(found.shift_mm[gone]).max() < 0.003
    # as far as the colour says
    assert np.flatnonzero(found.covered).tolist() == [gone, hidden]
    assert found.sigma_mm[hidden] == 0.1 and found.turn_deg[hidden] == 0.0
    assert np.abs(off[hidden]).max() < 0.02
    # too few to learn from what a part looks like
    few = fit_bodies(picture, warp, TAPE, palette, sites[:19])
    assert (few.misfit == 1.0).all() and (few.sigma_mm == 0.1).all() and (few.turn_deg == 0.0).all()
    assert np.abs((few.shift_mm - shift[:19])[np.arange(19) != gone]).max() < 0.02


def test_parts_beside_those_that_are_learned_from_are_found_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of many parts evenly chosen ones make the template, and the others are fitted to it."""
    monkeypatch.setattr(bodies, "_MOST_LEARNED", 21)
    rng = np.random.default_rng(0)
    shift, turn = rng.normal(0.0, 0.03, (TAPE.part_count, 2)), rng.normal(0.0, 3.0, TAPE.part_count)
    picture, warp, sites = drawn(shift, turn, METAL)
    palette = Palette(body=BODY, metal=METAL, film=FILM, body_axis=_axis(BODY, METAL, FILM))
    found = fit_bodies(picture, warp, TAPE, palette, sites)
    others = np.arange(TAPE.part_count) % 2 == 1
    off = found.shift_mm - shift
    assert np.abs(off).max() < 0.003 and np.abs(np.median(off[others], axis=0)).max() < 6e-4
    assert found.turn_deg == pytest.approx(turn - np.median(turn), abs=0.3) and (found.misfit < 1.2).all()


def test_where_metal_looks_like_film_bodies_are_less_sure_along_them() -> None:
    """Nothing but the inner edges of the metal is left there, both of which scatter by 10 um: 7 um along, 1 um across."""
    rng = np.random.default_rng(0)
    shift, turn = rng.normal(0.0, 0.03, (TAPE.part_count, 2)), rng.normal(0.0, 3.0, TAPE.part_count)
    picture, warp, sites = drawn(shift, turn, FILM)
    found = fit_bodies(picture, warp, TAPE, Palette(body=BODY, metal=FILM, film=FILM, body_axis=_axis(BODY, FILM, FILM)), sites)
    off = found.shift_mm - shift
    assert 0.003 < np.median(found.sigma_mm) < 0.006
    assert 0.5 < (off**2 / found.sigma_mm[:, None] ** 2).mean() < 1.5 and np.abs(np.median(off, axis=0)).max() < 1e-3
