"""The accuracy of `inspect` that the page on measuring promises, on scans that other code draws."""

from __future__ import annotations

import pytest

from tests.bench.inspect_scans import FULL_MM, SMALL_MM, measured
from tests.thorough import only_thorough


@pytest.mark.parametrize(("dpi", "most_um"), [(600.0, 4.0), (1200.0, 3.0)])
def test_places_of_a_small_tape_are_exact_and_no_fault_is_invented(dpi: float, most_um: float) -> None:
    row = measured(SMALL_MM, dpi, 0.05, missing=5, seed=3)
    assert row.pooled_um < most_um
    assert (row.found, row.invented) == (5, 0)
    assert 0.35 < row.nees < 1.5


@only_thorough
@pytest.mark.parametrize(
    ("size_mm", "dpi", "missing", "most_um", "most_s"), [(FULL_MM, 1200.0, 20, 3.5, 10.0), (SMALL_MM, 2400.0, 5, 3.0, 5.0)]
)
def test_places_of_2000_parts_and_of_large_ones_are_exact_and_every_missing_one_is_found(
    size_mm: tuple[float, float], dpi: float, missing: int, most_um: float, most_s: float
) -> None:
    """Of 2,000 parts, and of parts of as many pixels as 2400 dpi have."""
    row = measured(size_mm, dpi, 0.05, missing=missing, seed=1)
    assert row.pooled_um < most_um
    assert (row.found, row.invented) == (missing, 0)
    assert 0.35 < row.nees < 2.0
    assert row.seconds < most_s
