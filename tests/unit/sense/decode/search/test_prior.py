"""A prior is refused where it says nothing, and else names the places within its radius and its angle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Prior, SpecError
from tactape_fab.sense.decode.rule import PRIOR_SHARE
from tactape_fab.sense.decode.search.evidence import Tables, tables_of
from tactape_fab.sense.decode.search.prior import Near, near_prior, raised_by
from tactape_fab.texture.frames import FloatArray
from tests.tapes import tape_at


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("position_mm", (np.nan, 3.0)),
        ("position_mm", (1.0,)),
        ("theta_deg", np.nan),
        ("radius_mm", -1.0),
        ("angle_deg", np.nan),
        ("radius_mm", 50.1),
        ("angle_deg", 360.1),
        ("tape", 7),
    ],
)
def test_a_prior_that_says_nothing_is_refused(key: str, value: object) -> None:
    good = {"position_mm": (1.0, 2.0), "theta_deg": 0.0}
    with pytest.raises(SpecError, match=key):
        Prior(**{**good, key: value})  # type: ignore[arg-type]
    Prior(position_mm=(1.0, 2.0), theta_deg=0.0, radius_mm=0.0, angle_deg=360.0)


TAPES = [tape_at(7, (30, 20)), tape_at(9, (30, 20))]
FAMILY: Any = SimpleNamespace(tapes=(1, 0))
PITCH_PX, CENTRE_PX = 24.0, np.array([160.0, 120.0])
# E, S, W, N in the order of `Tape.symbols`
CLOCKWISE = {2: 0, 3: 1, 1: 2, 0: 3}


@dataclass(frozen=True)
class Seen:
    """Dots of a contact as the search has them, with the place of their corner on the tape."""

    tables: Tables
    grid: FloatArray
    corner: tuple[int, int]


def seen(s_cells: tuple[float, float], theta_deg: float, turn: int, first: tuple[int, int] = (8, 6)) -> Seen:
    """5 x 4 dots of the first tape from a column and row on, on a grid whose axes are turned back by so many quarters."""
    theta = np.radians(theta_deg)
    e1, e2 = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    cells = np.array([(first[0] + x, first[1] + y) for y in range(4) for x in range(5)])
    px = CENTRE_PX + PITCH_PX * ((cells - s_cells) @ np.stack([e1, e2]))
    axis = theta - turn * np.pi / 2
    g1, g2 = np.array([np.cos(axis), np.sin(axis)]), np.array([-np.sin(axis), np.cos(axis)])
    # the grid begins at some dot
    nodes = np.rint((px - px[7]) @ np.stack([g1, g2]).T / PITCH_PX).astype(np.int64)
    q = np.full((len(cells), 4), 0.01)
    for i, (x, y) in enumerate(cells):
        inside = 0 <= x < 30 and 0 <= y < 20
        q[i, (CLOCKWISE[int(TAPES[0].symbols[y, x])] + turn) % 4 if inside else 0] = 0.97
    tables = tables_of(nodes, q, np.empty(0, dtype=np.float32), 99)
    return Seen(tables=tables, grid=np.array([*(PITCH_PX * g1), *px[7]]), corner=first)


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("theta_deg", [0.0, 33.0, -178.0])
def test_places_near_a_prior_are_those_within_its_radius(theta_deg: float, turn: int) -> None:
    s_cells = (10.3, 7.6)
    view = seen(s_cells, theta_deg, turn)
    # 1.2 mm right and 0.6 mm above the true place; the angle is off by 9 degrees, across 180
    prior = Prior(
        position_mm=(s_cells[0] * 1.5 + 1.2, s_cells[1] * 1.5 - 0.6), theta_deg=(theta_deg - 9.0 + 180.0) % 360.0 - 180.0
    )
    near = near_prior(TAPES, [FAMILY], [view.tables], view.grid, CENTRE_PX, prior)
    assert near is not None
    around = [(x, y) for y in range(-3, 4) for x in range(-3, 4) if np.hypot(1.5 * x - 1.2, 1.5 * y + 0.6) <= 2.0]
    want = sorted((0, turn, site, view.corner[0] + x, view.corner[1] + y) for site in (0, 1) for x, y in around)
    assert sorted(map(tuple, near.places.tolist())) == want and not near.over.any()
    # the second site is the tape that is touched
    assert near.places[near.evidence.argmax()].tolist() == [0, turn, 1, *view.corner]
    assert near.evidence.max() == pytest.approx(40 * np.log(2 * 0.98), abs=1e-6)  # two bits of each dot
    named = near_prior(TAPES, [FAMILY], [view.tables], view.grid, CENTRE_PX, replace(prior, tape="tape-9"))
    assert named is not None and set(named.places[:, 2].tolist()) == {0} and len(named.places) == len(around)
    for other in (replace(prior, tape="none"), replace(prior, angle_deg=8.9), replace(prior, position_mm=(-60.0, 0.0))):
        assert near_prior(TAPES, [FAMILY], [view.tables], view.grid, CENTRE_PX, other) is None
    # all angles: each quarter turn is tried
    every = near_prior(TAPES, [FAMILY], [view.tables], view.grid, CENTRE_PX, replace(prior, angle_deg=180.0))
    assert every is not None and set(every.places[:, 1].tolist()) == {0, 1, 2, 3}


@pytest.mark.parametrize(
    ("first", "over"), [((0, 0), False), ((25, 16), False), ((26, 16), True), ((25, 17), True), ((-1, 3), True), ((3, -1), True)]
)
def test_places_whose_dots_hang_over_the_edge_are_said(first: tuple[int, int], over: bool) -> None:
    s_cells = (first[0] + 2.0, first[1] + 2.0)
    view = seen(s_cells, 20.0, 1, first)
    prior = Prior(position_mm=(s_cells[0] * 1.5, s_cells[1] * 1.5), theta_deg=20.0, radius_mm=0.1)
    near = near_prior(TAPES[:1], [SimpleNamespace(tapes=(0,))], [view.tables], view.grid, CENTRE_PX, prior)  # type: ignore[list-item]
    assert near is not None and near.places.tolist() == [[0, 1, 0, *first]] and near.over.tolist() == [int(over)]


def test_evidence_is_raised_by_the_prior_s_share_of_its_turn() -> None:
    near = Near(
        places=np.array([[0, 1, 0, 5, 5], [0, 3, 0, 5, 6], [0, 1, 1, 2, 2]]),
        evidence=np.array([3.0, -1.0, 0.5]),
        over=np.array([0, 1, 1]),
    )
    weights, base = np.array([0.1, 0.3, 0.2, 0.4]), np.log(np.arange(1.0, 9.0).reshape(4, 2) / 100.0)
    without, raised = raised_by(near, weights, base)
    # by turn and whether dots hang over
    shares = [(0.03, 0.3), (0.08, 0.4), (0.04, 0.3)]
    assert without == pytest.approx([e + np.log(all_of) for e, (all_of, _) in zip(near.evidence, shares, strict=True)])
    assert raised == pytest.approx(
        [e + np.log(all_of + PRIOR_SHARE * of) for e, (all_of, of) in zip(near.evidence, shares, strict=True)]
    )
