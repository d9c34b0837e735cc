"""Two copies of a tape in one survey: told by what is left over of parts, and not where a gel or lens moves neighbours alike."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.sense.survey.copies import LEAST_RATIO, MOST_ALIKE, refuse_copies, refuse_other_start, split_of
from tactape_fab.texture.frames import FloatArray, IntArray

CONTACTS, SIDE, DOT_MM = 30, 12, 0.005
PLACES_MM: FloatArray = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2) * np.float64(1.5)


def dots(apart_mm: FloatArray, second: int, seed: int = 0) -> tuple[IntArray, IntArray, FloatArray]:
    """Contacts on 5 x 5 parts each, the last `second` of a copy whose parts are apart by (n, 2); about the common mean."""
    rng = np.random.default_rng(seed)
    contact, part, left = [], [], []
    for k in range(CONTACTS):
        corner = rng.integers(0, SIDE - 4, 2)
        of = ((corner[1] + np.arange(5))[:, None] * SIDE + corner[0] + np.arange(5)).ravel()
        contact += [k] * len(of)
        part += of.tolist()
        left.append(apart_mm[of] * (k >= CONTACTS - second) + rng.normal(0.0, DOT_MM, (len(of), 2)))
    at, left_mm = np.array(part), np.concatenate(left)
    mean = np.stack([np.bincount(at, left_mm[:, axis], len(PLACES_MM)) for axis in range(2)], axis=1)
    return np.array(contact), at, left_mm - (mean / np.maximum(np.bincount(at, minlength=len(PLACES_MM)), 1)[:, None])[at]


def placed(mm: float) -> FloatArray:
    return np.random.default_rng(7).normal(0.0, mm, PLACES_MM.shape)


@pytest.mark.parametrize("second", [15, 6])
def test_contacts_of_either_copy_are_told_apart(second: int) -> None:
    found = split_of(*dots(placed(0.07), second), PLACES_MM, CONTACTS)
    assert found is not None
    # halves are alike: either may be the second
    told = found.second if second < 15 or found.second[-1] else ~found.second
    assert np.flatnonzero(told).tolist() == list(range(CONTACTS - second, CONTACTS))
    assert found.ratio > 4 * LEAST_RATIO and found.apart_mm == pytest.approx(0.07 * np.sqrt(2 * np.log(2)), rel=0.25)


def test_contacts_of_one_copy_do_not_fall_apart() -> None:
    ratios = [
        found.ratio for seed in range(20) if (found := split_of(*dots(placed(0.0), 0, seed), PLACES_MM, CONTACTS)) is not None
    ]
    assert len(ratios) > 10 and max(ratios) < LEAST_RATIO / 2


def test_what_moves_neighbours_alike_is_no_other_copy() -> None:
    wave = 0.07 * np.stack([np.sin(PLACES_MM[:, 0] / 4.0), np.cos(PLACES_MM[:, 1] / 4.0)], axis=1)
    seen = dots(wave, 12)
    found = split_of(*seen, PLACES_MM, CONTACTS)
    assert found is not None and found.ratio > LEAST_RATIO and found.alike > MOST_ALIKE
    refuse_copies(range(CONTACTS), *seen, PLACES_MM)


def test_few_contacts_are_no_copy() -> None:
    refuse_copies(range(CONTACTS), *dots(placed(0.07), 2), PLACES_MM)


def test_contacts_that_share_no_part_say_nothing() -> None:
    contact = np.repeat(np.arange(8), 10)
    assert split_of(contact, np.arange(80), np.ones((80, 2)), PLACES_MM, 8) is None
    assert split_of(np.zeros(10, dtype=np.int64), np.arange(10), np.ones((10, 2)), PLACES_MM, 1) is None


def test_a_start_is_refused_where_the_design_fits_better() -> None:
    other, own = placed(0.05), np.random.default_rng(8).normal(0.0, 0.05, PLACES_MM.shape)
    part, sigma = np.repeat(np.arange(len(PLACES_MM)), 3), np.full(len(PLACES_MM), 0.005)
    for before, fits in ((own + placed(0.005), True), (other, False)):
        # held at what was measured before: all else is left over
        left = (own - before)[part]
        if fits:
            refuse_other_start(part, left, before, before, sigma)
        else:
            with pytest.raises(SpecError, match="leave out --from"):
                refuse_other_start(part, left, before, before, sigma)
    # parts that nobody measured are where the design has them
    refuse_other_start(part, own[part], np.zeros_like(own), np.zeros_like(own), np.full(len(own), np.inf))
