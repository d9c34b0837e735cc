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
    assert 0.5 < row.nees < 1.5


@only_thorough
@pytest.mark.parametrize(("dpi", "most_um", "most_s"), [(1200.0, 3.5, 10.0), (2400.0, 3.0, 20.0)])
def test_places_of_2000_parts_are_exact_and_every_missing_one_is_found(dpi: float, most_um: float, most_s: float) -> None:
    row = measured(FULL_MM, dpi, 0.05, missing=20, seed=1)
    assert row.pooled_um < most_um
    assert (row.found, row.invented) == (20, 0)
    assert 0.5 < row.nees < 2.0
    assert row.seconds < most_s
