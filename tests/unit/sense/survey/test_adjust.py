"""Adjustment of a survey: drawn contacts with their true places."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.sense.survey.adjust import Prior, adjust
from tests.surveyed import DOT_MM, NOMINAL_MM, SENSOR, by_robot, drawn


@pytest.mark.parametrize("count", [40, 200])
def test_many_contacts_of_a_small_tape_do_not_stretch_it(count: int) -> None:
    """Dots err by 6 um along each axis, and nothing else does: places are off as far as is said, however often touched."""
    squares, scales = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        shift_mm = rng.normal(0.0, 0.05, NOMINAL_MM.shape)
        contacts, _ = drawn(rng, shift_mm, count)
        found = adjust(contacts, NOMINAL_MM, SENSOR, Prior(shift_mm=0.0 * NOMINAL_MM, sigma_mm=np.full(len(NOMINAL_MM), np.nan)))
        off = (found.shift_mm - shift_mm[found.part]) / found.sigma_mm[:, None]
        squares.append(float((off**2).mean()))
        scales.append(float(found.common[0] / found.common_sigma[0]))
        assert found.scatter_mm == pytest.approx(0.05, rel=0.15)
    assert np.mean(squares) < 2.0
    assert np.abs(scales).max() < 3.0


def test_an_inspection_tells_the_dots_errors_from_the_parts() -> None:
    """Two thirds of a part's place come from an inspection; a dot that is 0.4 mm off is left out, and counted."""
    rng = np.random.default_rng(4)
    shift_mm = rng.normal(0.0, 0.05, NOMINAL_MM.shape)
    contacts, _ = drawn(rng, shift_mm, 14)
    contacts[3].seen_px[5] += 0.4 * 16.0
    prior = Prior(shift_mm=shift_mm + rng.normal(0.0, 0.003, shift_mm.shape), sigma_mm=np.full(len(shift_mm), 0.003))
    found = adjust(contacts, NOMINAL_MM, SENSOR, prior)
    assert found.scatter_mm is None and found.left == 1.0 / sum(len(c.part) for c in contacts)
    assert found.dot_mm == pytest.approx(DOT_MM, rel=0.04)


def test_dots_far_off_do_not_make_the_others_less_exact() -> None:
    """Parts that an inspection holds are settled at once; what a dot errs by has to settle as well, without those left out."""
    rng = np.random.default_rng(5)
    shift_mm = rng.normal(0.0, 0.05, NOMINAL_MM.shape)
    contacts, _ = drawn(rng, shift_mm, 14)
    amiss = 0
    for contact in contacts:
        off = rng.random(len(contact.part)) < 0.1
        contact.seen_px[off] += rng.normal(0.0, 0.4, (off.sum(), 2)) * SENSOR.px_per_mm
        amiss += int(off.sum())
    found = adjust(contacts, NOMINAL_MM, SENSOR, Prior(shift_mm=shift_mm, sigma_mm=np.full(len(shift_mm), 0.0003)))
    assert found.dot_mm == pytest.approx(DOT_MM, rel=0.05)
    assert found.left == pytest.approx(amiss / sum(len(c.part) for c in contacts), rel=0.1)


def test_a_robot_shows_how_the_whole_tape_is_stretched() -> None:
    """By 0.5 % along x: 50 um at the ends, of which contacts alone know nothing."""
    rng = np.random.default_rng(0)
    middle_mm = NOMINAL_MM.mean(axis=0)
    shift_mm = (NOMINAL_MM - middle_mm) * (0.005, 0.0) + rng.normal(0.0, 0.01, NOMINAL_MM.shape)
    contacts, poses = drawn(rng, shift_mm, 24)
    prior = Prior(shift_mm=0.0 * NOMINAL_MM, sigma_mm=np.full(len(NOMINAL_MM), np.nan))
    found = adjust(contacts, NOMINAL_MM, SENSOR, prior, by_robot(poses, np.array([300.0, -50.0, 3.0])))
    off = found.shift_mm - shift_mm[found.part]
    slope = np.polyfit(NOMINAL_MM[found.part, 0] - middle_mm[0], found.shift_mm[:, 0], 1)[0]
    assert slope == pytest.approx(0.005, abs=5e-4)
    assert (off - off.mean(axis=0)).std() < 0.005
    assert found.scatter_mm == pytest.approx(0.01, rel=0.15)


def test_contacts_of_another_copy_are_refused() -> None:
    """Amid those of the first, and all of them, where a survey of the first is where it starts."""
    rng = np.random.default_rng(0)
    first_mm, second_mm = rng.normal(0.0, 0.05, (2, *NOMINAL_MM.shape))
    own, other = (drawn(rng, shift_mm, 12)[0] for shift_mm in (first_mm, second_mm))
    unknown = Prior(shift_mm=0.0 * NOMINAL_MM, sigma_mm=np.full(len(NOMINAL_MM), np.nan))
    with pytest.raises(SpecError, match="two copies of the tape: in 12 of 24 frames"):
        adjust([*own, *other], NOMINAL_MM, SENSOR, unknown)
    with pytest.raises(SpecError, match="leave out --from"):
        adjust(other, NOMINAL_MM, SENSOR, Prior(shift_mm=first_mm, sigma_mm=np.full(len(NOMINAL_MM), 0.003)))
