"""Dots before the grid is known: noise beside a contact, peaks between parts, tops drawn inwards at the rim."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import Tape
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.dots.detect import Dots, detect
from tactape_fab.sense.decode.dots.rim import COMPANY, CROWDED, LONELY, SUPPORT, SUPPORT_STEP, settled
from tactape_fab.texture.frames import FloatArray

PITCH_PX, SHIFT = 24.0, 1 / 6


def block(columns: int = 5, rows: int = 5) -> FloatArray:
    """Dots of a grid whose first lies at (100, 80)."""
    return np.array([(100.0 + PITCH_PX * c, 80.0 + PITCH_PX * r) for r in range(rows) for c in range(columns)])


def dots_at(xy: FloatArray, weights: FloatArray, trust: float = 0.7) -> Dots:
    return Dots(xy_px=xy, weights=weights, trust=np.where(weights < 0.5, trust, 0.999), elongation=np.zeros_like(xy))


def test_whole_dots_stay_where_they_are() -> None:
    xy = block()
    out = settled(dots_at(xy, np.ones(len(xy))), PITCH_PX, SHIFT)
    assert (out.xy_px == xy).all()
    assert (out.weights == 1.0).all()
    assert out.trust.min() > 0.99


@pytest.mark.parametrize("whole", [0.8, 1.0, 1.4])
@pytest.mark.parametrize("count", [4, 25])
def test_weights_are_over_those_of_fully_imprinted_dots(whole: float, count: int) -> None:
    """Lower dots, and tops that are probably none, do not move that level; it is at most an ordinary good dot's."""
    level = min(whole, 1.0)
    weights = np.concatenate([np.full(count, whole), np.full(count + 3, 0.6 * level)])
    xy = np.concatenate([block(), np.add(block(6), (0.0, 5 * PITCH_PX))])[: len(weights)]
    dots = dots_at(np.concatenate([xy, [(900.0, 900.0)]]), np.append(weights, 0.95))
    dots.trust[-1] = 0.45
    out = settled(dots, PITCH_PX, SHIFT)
    assert out.seen_px is not None
    which = [int(np.flatnonzero((dots.xy_px == at).all(axis=1))[0]) for at in out.seen_px]
    assert set(range(count)) < set(which) and len(which) > 1.2 * count
    assert out.weights == pytest.approx(np.minimum(dots.weights[which] / level, 1.0))


@pytest.mark.parametrize(
    ("apart", "weights", "trust", "support", "crowded"),
    [
        (1.0, (0.9, 0.8), (0.99, 0.99), (0.8 * 0.99 / 4.0, 0.9 * 0.99 / 4.0), (False, False)),
        (2.0, (0.9, 0.8), (0.99, 0.99), (0.8 * 0.99 / 25.0, 0.9 * 0.99 / 25.0), (False, False)),
        # nearer than two parts can be: the lower one is none, however little the higher one is trusted
        (0.5, (0.9, 0.8), (0.6, 0.999), (0.8 * 0.999 / 1.25**2, 0.9 * 0.6 / 1.25**2), (False, True)),
        (0.7, (0.9, 0.8), (0.99, 0.99), (0.8 * 0.99 / 1.49**2, 0.9 * 0.99 / 1.49**2), (False, False)),
    ],
)
def test_trust_follows_from_the_neighbours_by_bayes_rule(
    apart: float,
    weights: tuple[float, float],
    trust: tuple[float, float],
    support: tuple[float, float],
    crowded: tuple[bool, bool],
) -> None:
    xy = np.array([(50.0, 40.0), (50.0, 40.0 + apart * PITCH_PX)])
    out = settled(Dots(xy_px=xy, weights=np.array(weights), trust=np.array(trust)), PITCH_PX, SHIFT)
    company = 1.0 / (1.0 + np.exp((SUPPORT - np.array(support)) / SUPPORT_STEP))
    gain = LONELY + (COMPANY - LONELY) * company + CROWDED * np.array(crowded)
    odds = np.array(trust) / (1.0 - np.array(trust)) * np.exp(gain)
    assert out.trust == pytest.approx(odds / (1.0 + odds), rel=1e-5)


def test_a_lonely_bump_is_noise_and_one_with_neighbours_is_not() -> None:
    xy = np.concatenate([block(), [(100.0 - PITCH_PX, 80.0 + 2 * PITCH_PX), (290.0, 220.0)]])
    weights = np.ones(len(xy))
    weights[-2:] = 0.4
    out = settled(dots_at(xy, weights), PITCH_PX, SHIFT)
    assert len(out.weights) == len(xy) - 1
    assert out.trust[-1] > 0.7
    assert out.elongation is not None and len(out.elongation) == len(xy) - 1


def test_bumps_too_near_a_part_or_in_the_place_of_a_missing_one_are_distrusted() -> None:
    xy = np.concatenate([np.delete(block(), 12, axis=0), [block()[12] + (2.0, -3.0), block()[6] + (0.5 * PITCH_PX, 0.0)]])
    weights = np.ones(len(xy))
    weights[-2:] = 0.4
    out = settled(dots_at(xy, weights), PITCH_PX, SHIFT)
    distrusted = out.trust[out.weights < 0.5]
    assert len(distrusted) == 0 or distrusted.max() < 0.1


@pytest.mark.parametrize("turn_deg", [0.0, 37.0, 110.0])
def test_low_dots_at_the_rim_move_outwards(turn_deg: float) -> None:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    xy = block() @ np.array([[c, s], [-s, c]])
    weights = np.ones(len(xy))
    weights[0:25:5] = 0.5  # the first column
    moved = settled(dots_at(xy, weights), PITCH_PX, SHIFT).xy_px - xy
    outwards = moved[0:25:5] @ np.array([-c, -s])
    assert (outwards[1:4] > 0.8).all() and (outwards[1:4] < 3.0).all()
    assert np.abs(moved[10] @ np.array([-s, c])) < outwards[2] / 4
    assert (moved[weights == 1.0] == 0.0).all()


@pytest.mark.parametrize(
    ("scene", "below", "better"),
    [
        (Scene(contact_mm=(6.0, 6.0)), 0.75, 0.7),
        (Scene(contact="strip", strip_width_mm=4.5, cylinder_radius_mm=8.4), 0.75, 0.7),
        (Scene(contact_mm=(7.0, 7.0), roll_off_mm=0.4), 0.75, 0.8),
        (Scene(contact_mm=(7.0, 7.0), roll_off_mm=1.4), 0.75, 0.95),
        (Scene(contact="pad"), 2.0, 1.02),
        (Scene(noise=2.0), 2.0, 1.02),
        (Scene(elastomer_mm=0.25), 2.0, 1.02),
    ],
)
def test_low_dots_at_rims_are_nearer_the_truth_and_none_farther_elsewhere(
    tape: Tape, scene: Scene, below: float, better: float
) -> None:
    """Median error of the dots below some weight, against that of the detector's own centres."""
    before: list[FloatArray] = []
    after: list[FloatArray] = []
    for frame in iterate_frames(tape, 30, 11, scene=scene):
        raw = detect(frame.depth, 16.0)
        out = settled(raw, PITCH_PX, SHIFT)
        kept = np.hypot(*(out.xy_px[:, None] - raw.xy_px[None]).transpose(2, 0, 1)).argmin(axis=1)
        low = (out.weights < below) & (out.trust > 0.5)
        for centres, errors in ((raw.xy_px[kept], before), (out.xy_px, after)):
            apart = np.hypot(*(centres[low][:, None] - frame.dots_px[None]).transpose(2, 0, 1)).min(axis=1)
            errors.append(apart[apart < 6.0])
    assert np.median(np.concatenate(after)) <= better * np.median(np.concatenate(before))


def test_no_dots_are_no_dots() -> None:
    none = Dots(xy_px=np.empty((0, 2)), weights=np.empty(0), trust=np.empty(0))
    assert len(settled(none, PITCH_PX, SHIFT).weights) == 0
