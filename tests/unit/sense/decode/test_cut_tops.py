"""Tops that are cut off: no such frame has a depth, a tilt or a small covariance that it does not show."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import ElasticContact, Scene, simulate
from tactape_fab.sense.decode.cut_tops import CUT_VARIANCE, as_cut, cut_share
from tests.contacts import POSE, TAPE, is_near

Image = npt.NDArray[np.float32]


@pytest.fixture(scope="module")
def localizer() -> Localizer:
    return Localizer([TAPE], "gelsight-mini")


def cut(frame: Image, quantile: float) -> Image:
    return np.minimum(frame, np.quantile(frame, quantile)).astype(np.float32)


def test_where_they_hide_the_place_the_reason_says_so(localizer: Localizer) -> None:
    """As of an image of 8 bits with too small a step; the same frame with its tops is located."""
    frame = simulate(TAPE, *POSE, contact_mm=(7.0, 7.0))
    fix = localizer.locate(cut(frame, 0.9))
    assert not fix.located and re.search(r"; 10 % of the pixels have the largest depth: if tops", str(fix.reason)), fix.reason
    assert "largest depth" not in str(localizer.locate(cut(frame, 0.9) + 1e-6 * frame).reason)
    assert localizer.locate(frame).located
    assert "largest depth" not in str(localizer.locate(cut(frame, 0.5)).reason)


def test_a_located_frame_is_less_sure_and_shows_no_depth(localizer: Localizer) -> None:
    """Its tops show less than half of a tilt of 4 degrees, and half of the depth: neither is stated."""
    scene = Scene(elastic=ElasticContact(force_n=1.0, tilt_deg=(4.0, 0.0)))
    frame = simulate(TAPE, *POSE, scene=scene)
    whole, fix = localizer.locate(frame), localizer.locate(cut(frame, 0.93))
    assert whole.tilt_deg is not None and whole.tilt_deg[0] == pytest.approx(4.0, abs=0.5)
    assert whole.indentation_mm is not None and whole.force_n is not None
    assert fix.located and is_near(fix, *POSE, mm=0.1, deg=0.5)
    assert all(said is None for said in (fix.contact, fix.tilt_deg, fix.indentation_mm, fix.force_n))


@pytest.mark.parametrize(("count", "share"), [(2, 0.0), (3, 0.003), (300, 0.3), (301, 0.0)])
def test_a_share_of_3_to_300_of_1000_pixels_is_cut_off(count: int, share: float) -> None:
    image = np.linspace(0.0, 1.0, 1000, dtype=np.float32).reshape(25, 40)
    image.flat[1000 - count :] = 1.0
    assert cut_share(image) == share


def test_the_reason_has_the_share(localizer: Localizer) -> None:
    image = np.zeros((25, 40), dtype=np.float32)
    image.flat[:244] = 1.0
    refused = localizer.locate(np.zeros((240, 320), dtype=np.float32))
    assert f"{refused.reason}; 24 % of the pixels have" in str(as_cut(refused, image).reason)


def test_the_paper_s_method_says_so_as_well() -> None:
    """It states no covariance."""
    frame, by_paper = simulate(TAPE, *POSE), Localizer([TAPE], method="paper")
    whole = by_paper.locate(frame)
    assert whole.located and as_cut(whole, frame) is whole
    assert "15 % of the pixels have the largest depth" in str(by_paper.locate(cut(frame, 0.85)).reason)


def test_covariances_grow_by_the_factor_and_positions_stay(localizer: Localizer) -> None:
    """Depths that fall by next to nothing from a cut on have the same dots, and the largest depth once."""
    frame = simulate(TAPE, *POSE)
    low = cut(frame, 0.97)
    slight = (low + 1e-4 * (frame - low)).astype(np.float32)
    fix, same = localizer.locate(low), localizer.locate(slight)
    assert fix.covariance is not None and same.covariance is not None and fix.strain_sigma and same.strain_sigma
    assert fix.position_mm == pytest.approx(same.position_mm, abs=1e-4)
    assert fix.covariance[:2, :2] == pytest.approx(CUT_VARIANCE * same.covariance[:2, :2], rel=0.05)
    assert fix.strain_sigma[0] == pytest.approx(np.sqrt(CUT_VARIANCE) * (same.strain_sigma[0] or 0.0), rel=0.05)


@pytest.mark.parametrize("levels", [20, 60, 255])
def test_tops_in_coarse_steps_are_whole(levels: int) -> None:
    frame = simulate(TAPE, *POSE)
    low, high = float(frame.min()), float(frame.max())
    steps = np.floor((frame - low) / (high - low) * levels).astype(np.float32)
    assert cut_share(steps) == 0.0 < cut_share(cut(frame, 0.99))


def test_a_flat_frame_is_not_cut_off() -> None:
    assert cut_share(np.zeros((4, 5), dtype=np.float32)) == 0.0
