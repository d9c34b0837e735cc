"""Tapes that may be touched besides those registered: every other sector, and where their dots may hang over an edge."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.decode.search.families import _least_size, families
from tactape_fab.sense.decode.search.plane_sites import ORIGIN, OVERHANG, SECTOR, Sites
from tests.tapes import tape_at


def test_dots_of_strangers_hang_over_edges_only_where_sectors_share_an_origin() -> None:
    tapes = [tape_at(7, (12, 10)), tape_at(9, (14, 9), origin=(100, 200)), tape_at(11, (12, 10), origin=(100, 200))]
    (family,) = families(tapes, open_world=True)
    sites, beyond = family.unregistered, family.beyond
    assert sites is not None and beyond is not None
    everyone = sites.table[:, SECTOR, 0] < 0
    assert everyone.sum() == 2 and len(everyone) == 255 + 2  # sector 7 is at its default origin, 9 and 11 are not
    assert all(bool(row[OVERHANG]) == everyone[row[0]] for row in sites.classes)
    assert (beyond.classes[:, OVERHANG] == 1).all()
    barred = {(int(u), int(v)) for site, u, v in sites.barred if everyone[site]}
    length = 63
    assert barred == {divmod(sector, length) for sector in (7, 9, 11)} and len(sites.barred) == 3


def test_a_tape_that_shows_a_part_of_a_registered_one_is_no_stranger_at_anothers_origin() -> None:
    """Contacts on it would fit both: of a tape over whose middle another one begins half were never located."""
    beside = [tape_at(9, (12, 10), origin=(84 + x, 1428 + y)) for x, y in ((19, -9), (20, 0), (0, 10), (-11, 9), (-12, 0))]
    (family,) = families([tape_at(7, (20, 10)), *beside], open_world=True)
    sites = family.unregistered
    assert sites is not None and (np.diff(sites.barred[:, 0]) >= 0).all()
    site_of = {tuple(at.tolist()): k for k, at in enumerate(sites.table[:, ORIGIN]) if sites.table[k, SECTOR, 0] < 0}
    at_sector_7 = {site for site, u, v in sites.barred.tolist() if (u, v) == (0, 7)}
    assert at_sector_7 == {site_of[x % 16, y % 16] for x, y in ((84, 1428), (103, 1419), (73, 1437))}


def test_a_closed_world_has_no_strangers() -> None:
    tape = tape_at(7, (12, 10))
    (family,) = families([tape], open_world=False)
    assert family.unregistered is None and family.beyond is None and family.tapes == (0,)
    assert isinstance(family.registered, Sites) and len(family.registered.table) == 1


@pytest.mark.parametrize(
    ("grids", "least"),
    [([(12, 10)], (12, 10)), ([(12, 10), (14, 9)], (14, 10)), ([(20, 12)], (20, 20)), ([(5, 9)], (12, 10)), ([(8, 11)], (8, 30))],
)
def test_strangers_are_as_large_as_the_smallest_size_that_holds_all(grids: list[tuple[int, int]], least: tuple[int, int]) -> None:
    sizes = [(8, 30), (12, 10), (14, 9), (14, 10), (20, 20)]
    assert sizes[_least_size(sizes, [tape_at(7, grid) for grid in grids])] == least
