"""Two copies of a tape in one survey: told by what is left over of parts, and not where a gel or lens moves neighbours alike."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from tactape_fab import SpecError
from tactape_fab.sense.survey.copies import (
    LEAST_CONTACTS,
    LEAST_PARTS,
    LEAST_RATIO,
    MOST_ALIKE,
    _squares,
    refuse_copies,
    refuse_other_start,
    split_of,
)
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


@pytest.mark.parametrize("second", [15, 6, 24])
def test_contacts_of_either_copy_are_told_apart(second: int) -> None:
    contact, part, left_mm = dots(apart_mm := placed(0.07), second)
    found = split_of(contact, part, left_mm, PLACES_MM, CONTACTS)
    assert found is not None
    assert found.second.sum() == min(second, CONTACTS - second)
    told = found.second if found.second[-1] else ~found.second
    assert np.flatnonzero(told).tolist() == list(range(CONTACTS - second, CONTACTS))
    # by the errors that were drawn: of n contacts a part's mean has the variance DOT_MM^2 / n
    late = contact >= CONTACTS - second
    n = [np.bincount(part[which], minlength=len(PLACES_MM)) for which in (~late, late)]
    both = (n[0] >= 2) & (n[1] >= 2)
    of_errors = 2.0 * DOT_MM**2 * (1.0 / n[0][both] + 1.0 / n[1][both])
    assert found.ratio == pytest.approx(np.median((apart_mm[both] ** 2).sum(axis=1) / of_errors) / np.log(2.0), rel=0.1)
    assert found.parts == both.sum() and abs(found.alike) < 0.3
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


def test_frames_of_the_fewer_contacts_are_named() -> None:
    contact, part, left_mm = dots(placed(0.07), 12)
    frames = range(100, 100 + CONTACTS)
    first = ", ".join(str(frame) for frame in range(118, 128))
    with pytest.raises(
        SpecError, match=rf"in 12 of 30 frames \({first}, \.\.\.\) parts are 0\.0[0-9]* mm from .* survey each copy"
    ):
        refuse_copies(frames, contact, part, left_mm, PLACES_MM)
    with pytest.raises(SpecError, match=r"in 6 of 30 frames \(24, 25, 26, 27, 28, 29\) parts"):
        refuse_copies(range(CONTACTS), *dots(placed(0.07), 6), PLACES_MM)
    refuse_copies(frames, contact, part, left_mm / 10.0, PLACES_MM)  # as surely apart, by less than placement is


def test_few_contacts_are_no_copy() -> None:
    refuse_copies(range(CONTACTS), *dots(placed(0.07), 2), PLACES_MM)


@pytest.mark.parametrize(
    ("first", "second", "parts", "told"),
    [
        (LEAST_CONTACTS, LEAST_CONTACTS, LEAST_PARTS, True),
        (LEAST_CONTACTS + 1, LEAST_CONTACTS - 1, LEAST_PARTS, False),
        (LEAST_CONTACTS, LEAST_CONTACTS - 1, LEAST_PARTS, False),
        (LEAST_CONTACTS, LEAST_CONTACTS, LEAST_PARTS - 1, False),
    ],
)
def test_the_fewest_contacts_and_parts_by_which_copies_are_told(first: int, second: int, parts: int, told: bool) -> None:
    """Each contact shows all of the parts."""
    contact, part = np.divmod(np.arange((first + second) * parts), parts)
    apart_mm = placed(0.07)[part] * (contact >= first)[:, None] + np.random.default_rng(1).normal(0.0, DOT_MM, (len(part), 2))
    mean = np.stack([np.bincount(part, apart_mm[:, axis]) for axis in range(2)], axis=1) / (first + second)
    found = split_of(contact, part, apart_mm - mean[part], PLACES_MM, first + second)
    assert (found is not None) == told
    if found is not None:
        assert found.parts == parts and found.ratio > LEAST_RATIO
        assert found.second[:first].all() != found.second[first:].all() and found.second.sum() == second


def test_a_dot_is_compared_with_the_others_of_a_group_and_never_with_itself() -> None:
    """The mean of n others has an error, too: squares are over 1 + 1 / n. Where there is no other, nothing is told."""
    rng = np.random.default_rng(5)
    contact, part = np.nonzero(rng.random((6, 40)) < 0.5)
    left_mm = rng.normal(0.0, 0.05, (len(part), 2))
    group = np.array([True, True, False, True, False, False])
    shape = (6, 40)
    seen = csr_matrix((np.ones(len(part)), (contact, part)), shape=shape)
    by = [csr_matrix((left_mm[:, axis], (contact, part)), shape=shape) for axis in range(2)]
    told = []
    for k, j, left in zip(contact, part, left_mm, strict=True):
        others = left_mm[(part == j) & (contact != k) & group[contact]]
        told.append(((left - others.mean(axis=0)) ** 2).sum() / (1.0 + 1.0 / len(others)) if len(others) else np.nan)
    assert 0 < np.isnan(told).sum() < len(told) / 2
    assert _squares(seen, by, contact, part, left_mm, group) == pytest.approx(told, nan_ok=True)


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
            off_mm, design_mm = (np.median(np.hypot(*at[np.hypot(*other.T) > 0.01].T)) for at in (own - other, own))
            says = rf"parts are {off_mm:.2g} mm off those and {design_mm:.2g} mm off the design \(median\).* leave out --from"
            with pytest.raises(SpecError, match=says):
                refuse_other_start(part, left, before, before, sigma)
            # what placement is at its best is no other copy
            refuse_other_start(part, left / 10.0, before / 10.0, before / 10.0, sigma / 10.0)
    # a part tells from twice its standard deviation off the design: here all are 0.05 mm off, the same way as of another copy
    before = 0.05 * other / np.hypot(*other.T)[:, None]
    refuse_other_start(part, (own - before)[part], before, before, np.full(len(own), 0.026))
    with pytest.raises(SpecError, match="leave out --from"):
        refuse_other_start(part, (own - before)[part], before, before, np.full(len(own), 0.02))
    # parts that nobody measured are where the design has them
    refuse_other_start(part, own[part], np.zeros_like(own), np.zeros_like(own), np.full(len(own), np.inf))
    # nor do they speak for those that were, however far off
    told = np.arange(len(own)) < 20
    left = np.where(told[:, None], own - other, 100.0 * own)[part]
    before = np.where(told[:, None], other, 0.0)
    with pytest.raises(SpecError, match="leave out --from"):
        refuse_other_start(part, left, before, before, np.where(told, 0.005, np.inf))
