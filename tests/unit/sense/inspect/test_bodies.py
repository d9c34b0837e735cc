"""Where bodies are in a scan, and which turn a part has that looks like no other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from tactape_fab.sense.inspect import bodies
from tactape_fab.sense.inspect.align import Template
from tactape_fab.sense.inspect.bodies import _State, fit_bodies
from tactape_fab.sense.inspect.colours import Palette, _axis
from tactape_fab.sense.inspect.patches import PatchGrid, patch_grid
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


@pytest.mark.parametrize(
    ("now_deg", "better_deg", "taken"),
    [(0.5, 15.0, True), (-0.5, -15.0, True), (-0.5, 15.0, False), (0.5, -15.0, False), (85.0, -90.0, True), (70.0, -90.0, False)],
)
def test_in_its_own_turn_any_better_fit_serves(
    now_deg: float, better_deg: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another turn is more than 15 degrees off, half turns apart: a misfit of 2.7 in place of 3 is not clearly better there."""

    def moved(_scene: Any, _sites: Any, state: _State, _template: Any, _ends: Any, *, robust: bool) -> tuple[_State, None]:
        assert robust
        return replace(state, misfit=np.where(state.turn_deg == better_deg, 2.7, 9.0)), None

    monkeypatch.setattr(bodies, "_moved", moved)
    one = _State(shift_mm=np.zeros((1, 2)), turn_deg=np.array([now_deg]), sigma_mm=np.ones((1, 2)), misfit=np.array([3.0]))
    best = bodies._all_turns(None, np.zeros((1, 2)), one, one, np.array([0]), None, None, 1.0)  # type: ignore[arg-type]
    assert best.turn_deg[0] == (better_deg if taken else now_deg)


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


# Its steps


def test_a_blurred_step_is_half_way_up_at_its_edge() -> None:
    """A tanh of the width 0.025 mm, from 0 to 1."""
    said = bodies._rise(np.array([-1.0, -0.025, 0.0, 0.025, 1.0]))
    assert said == pytest.approx([0.0, (1 - np.tanh(1)) / 2, 0.5, (1 + np.tanh(1)) / 2, 1.0])


def test_ends_differ_where_their_metal_and_the_solder_beyond_is() -> None:
    """Of a part of 0.6 x 0.3 mm: metal from 0.168 to 0.3 mm off its middle, its inner edge between 0.048 and 0.252 mm."""
    grid = patch_grid(0.5, 0.25, 60.0)
    slope = np.stack([grid.a_mm, 2.0 * grid.a_mm])
    template = Template(value=slope, sigma=np.ones_like(slope), used=np.ones(grid.count, dtype=bool), tail=np.ones_like(slope))
    modes = bodies._ends(template, grid, TAPE)
    assert modes.shape == (10, 2, grid.count)
    # at places along the axis, some of them an edge: (body-ness, brightness) of the second end's metal and solder
    along = ((-0.4, 0.0, 0.0), (0.0, 0.0, 0.0), (0.168, 0.5, 0.0), (0.234, 1.0, 0.0), (0.3, 0.5, 0.5), (0.4, 0.0, 1.0))
    for a_mm, metal, solder in along:
        at = int(np.argmin(np.hypot(grid.a_mm - a_mm, grid.b_mm)))
        # the grid's step is 17 um: as far as that moves a flank of 25 um
        expected = [[0.0, metal], [0.0, solder], [solder, 0.0], [metal, 0.0]]
        assert modes[6:, :, at] == pytest.approx(np.array(expected), abs=0.2 if metal == 0.5 else 0.02)
    # the inner edge is where the template is steep, on the body's width
    inner = (grid.a_mm > 0.048) & (grid.a_mm < 0.252) & (np.abs(grid.b_mm) < 0.17)
    assert np.abs(modes[5]) == pytest.approx(np.stack([1.0 * inner, 2.0 * inner]))
    # the first end is the second one's mirror image
    mirrored = modes.reshape(10, 2, *grid.shape)[..., ::-1].reshape(modes.shape)
    assert modes[:5] == pytest.approx(mirrored[5:], abs=1e-9)


def test_samples_are_body_ness_and_brightness() -> None:
    palette = Palette(body=BODY, metal=METAL, film=FILM, body_axis=_axis(BODY, METAL, FILM))
    dark = replace(palette, metal=FILM)
    colours = np.array([[BODY, FILM, METAL, np.full(3, 255.0)]], dtype=np.float32)
    channels = bodies._channels(colours, palette)
    assert channels.shape == (1, 2, 4) and channels[0, 0, :2] == pytest.approx([1.0, 0.0], abs=1e-4)
    # in units of 0.7 of the metal's where film is darker than that, and of the film's; no more than 2.2
    assert channels[0, 1] == pytest.approx(np.array([31.0, 200 / 3, 195.0, 255.0]) / (0.7 * 195.0), rel=1e-4)
    assert bodies._channels(colours, dark)[0, 1] == pytest.approx([31.0 / (200 / 3), 1.0, 2.2, 2.2], rel=1e-4)


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A box of body colour, mm: its middle from the nearest nominal place, and its sides."""

    at: int
    x: float = 0.0
    y: float = 0.0
    wide: float = 0.4
    high: float = 0.3


def scanned(sites: FloatArray, spots: Sequence[Spot]) -> tuple[Any, Warp]:
    """Boxes of body colour on film, and the warp; axes of the board, 40 px/mm."""
    width, height = sites.max(axis=0) + 2.0
    rows, columns = np.mgrid[: round(height * PX_PER_MM), : round(width * PX_PER_MM)]
    x, y = columns / PX_PER_MM, height - rows / PX_PER_MM
    share = np.zeros((*x.shape, 1))
    for spot in spots:
        u, v = x - sites[spot.at, 0] - spot.x, y - sites[spot.at, 1] - spot.y
        share = np.maximum(share, edge(spot.wide / 2 - np.abs(u)) * edge(spot.high / 2 - np.abs(v)))
    warp = affine_warp([(PX_PER_MM, 0.0), (0.0, -PX_PER_MM)], (0.0, height * PX_PER_MM), (0.0, 0.0), 10.0)
    return np.rint(share * BODY + (1 - share) * FILM).astype(np.uint8), warp


PALETTE = Palette(body=BODY, metal=METAL, film=FILM, body_axis=_axis(BODY, METAL, FILM))


@pytest.mark.parametrize(
    ("length_mm", "pitch_mm", "reach_mm"), [(0.6, 1.5, 0.45), (0.4, 1.5, 0.3), (1.2, 2.0, 0.675), (1.2, 1.5, 0.45)]
)
def test_body_colour_near_each_place_tells_where_parts_are(length_mm: float, pitch_mm: float, reach_mm: float) -> None:
    """Within 0.75 of the length, and 0.45 of what lies between neighbours that are displaced towards each other by 0.25 mm."""
    tape: Any = SimpleNamespace(part=SimpleNamespace(body_mm=(length_mm, 0.3, 0.23)), pitch_mm=pitch_mm, displacement_mm=0.25)
    sites = pitch_mm * np.stack(np.meshgrid(np.arange(1.0, 5.0), np.arange(1.0, 4.0)), axis=-1).reshape(-1, 2)
    usual = list(range(4, 12))
    moved = [Spot(at=k, x=0.03, y=-0.02, wide=0.3) for k in usual]
    beyond = (
        Spot(at=0, x=reach_mm + 0.09, wide=0.14, high=0.14),
        Spot(at=1, x=0.86 * reach_mm, y=0.86 * reach_mm, wide=0.08, high=0.08),
    )
    within = Spot(at=2, x=reach_mm - 0.09, wide=0.14, high=0.14)
    picture, warp = scanned(sites, [*moved, *beyond, within, Spot(at=3, wide=0.15)])
    shift, area = bodies._centroids(picture, warp, tape, PALETTE, sites)
    assert shift[usual] == pytest.approx(np.tile([0.03, -0.02], (8, 1)), abs=0.003)
    assert area[usual] == pytest.approx(1.0, abs=0.02)
    # nothing, nothing, a speck that has more than a tenth of a body's area, whose blurred corners do not count, and half a body
    assert (area[:2] == 0.0).all() and 0.1 < area[2] < 0.14**2 / 0.3**2 and area[3] == pytest.approx(0.5, abs=0.05)
    assert shift[:4] == pytest.approx(np.array([[0.0, 0.0], [0.0, 0.0], [reach_mm - 0.09, 0.0], [0.0, 0.0]]), abs=0.006)


def test_a_place_with_little_body_colour_keeps_its_place() -> None:
    """Less than a tenth of the usual area, which many such places do not lower; where no place has any, none is moved either."""
    tape: Any = SimpleNamespace(part=SimpleNamespace(body_mm=(0.6, 0.3, 0.23)), pitch_mm=1.5, displacement_mm=0.25)
    sites = 1.5 * np.stack(np.meshgrid(np.arange(1.0, 5.0), np.arange(1.0, 4.0)), axis=-1).reshape(-1, 2)
    specks = [Spot(at=k, x=0.3, wide=0.07, high=0.07) for k in range(7)]
    picture, warp = scanned(sites, [*(Spot(at=k) for k in range(7, 12)), *specks])
    shift, area = bodies._centroids(picture, warp, tape, PALETTE, sites)
    assert (area[:7] > 0.0).all() and (area[:7] < 0.1).all() and (shift[:7] == 0.0).all()
    assert area[7:] == pytest.approx(1.0, abs=0.02)
    picture, warp = scanned(sites, [])
    shift, area = bodies._centroids(picture, warp, tape, PALETTE, sites)
    assert (shift == 0.0).all() and (area == 0.0).all()


def centre_of(value: FloatArray, grid: PatchGrid, spots: Sequence[Spot], palette: Palette = PALETTE) -> tuple[float, float]:
    """The centre of a body of 0.6 x 0.3 mm in a template, of parts along the board's x axis at four places."""
    tape: Any = SimpleNamespace(part=SimpleNamespace(body_mm=(0.6, 0.3, 0.23), rotation_deg=30.0))
    sites = np.array([[1.0, 1.0], [3.0, 1.0], [1.0, 3.0], [3.0, 3.0]])
    each = [replace(spot, at=k) for spot in spots for k in range(4)]
    picture, warp = scanned(sites, each)
    scene = bodies._Scene(picture=picture, warp=warp, tape=tape, palette=palette, grid=grid)
    still = _State(shift_mm=np.zeros((4, 2)), turn_deg=np.full(4, -30.0), sigma_mm=np.ones((4, 2)), misfit=np.ones(4))
    one = np.ones((2, grid.count))
    template = Template(value=np.stack([value, one[0]]), sigma=one, used=np.ones(grid.count, dtype=bool), tail=one)
    (a, b), _ = bodies._centre(scene, sites, still, np.ones(4, dtype=bool), template)
    return float(a), float(b)


def template_of(grid: PatchGrid, a_mm: float, b_mm: float) -> FloatArray:
    """Body-ness of a body of 0.6 x 0.3 mm about a centre."""
    along, across = bodies._rise(0.3 - np.abs(grid.a_mm - a_mm)), bodies._rise(0.15 - np.abs(grid.b_mm - b_mm))
    return np.asarray(along * across)


def test_the_centre_of_a_template_is_that_of_its_body() -> None:
    """Bodies are the film's colour but darker, which tells nothing across; edges 80 um off the body, about another centre, do not
    count.
    """
    grid, grey = patch_grid(0.5, 0.35, 60.0), replace(PALETTE, body=0.3 * FILM)
    value = template_of(grid, 0.013, -0.008)
    assert centre_of(value, grid, (), grey) == pytest.approx((0.013, -0.008), abs=0.001)
    for beside in (np.abs(grid.a_mm - 0.02) > 0.4, np.abs(grid.b_mm - 0.02) > 0.25):
        assert centre_of(value + 3.0 * beside, grid, (), grey) == pytest.approx((0.013, -0.008), abs=0.002)


def test_across_the_middle_of_bodies_of_their_own_colour_is_their_centre() -> None:
    """Where metal would be, farther than 0.15 of the length along, bodies lie 8 um beside."""
    grid = patch_grid(0.5, 0.35, 60.0)
    value = template_of(grid, 0.01, 0.012)
    ends = [Spot(at=0, x=x, wide=0.16) for x in (-0.2, 0.2)]
    assert centre_of(value, grid, [Spot(at=0, y=0.008, wide=0.24), *ends]) == pytest.approx((0.01, 0.008), abs=0.0015)
    # up to 6 um are a shadow's; what is farther off has another cause
    for other in (0.02, -0.012):
        assert centre_of(value, grid, [Spot(at=0, y=other, wide=0.24), *ends]) == pytest.approx((0.01, 0.012), abs=0.0015)
