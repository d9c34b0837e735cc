"""The weights of the two laws of a tilted contact."""

from __future__ import annotations

from math import inf, nan

import pytest

from tactape_fab.sense.decode.contact.tilted import AS_DRAWN, _share_not_drawn


@pytest.mark.parametrize(
    ("drawn_mm", "undrawn_mm", "dots", "share"),
    [
        (0.01, 0.01, 12.0, 1.0 / (1.0 + AS_DRAWN)),
        (0.02, 0.01, 2.0, 1.0 / (1.0 + AS_DRAWN / 4.0)),
        (0.01, 1.0, 1000.0, 0.0),
        (1.0, 0.01, 1000.0, 1.0),
        (1e-300, 1e300, 1e6, 0.0),
        (1e300, 1e-300, 1e6, 1.0),
    ],
)
def test_the_law_that_fits_better_counts_more(drawn_mm: float, undrawn_mm: float, dots: float, share: float) -> None:
    assert _share_not_drawn(drawn_mm, undrawn_mm, dots) == pytest.approx(share, abs=1e-12)


@pytest.mark.parametrize("bad", [0.0, inf, nan])
def test_a_law_that_leaves_no_error_to_compare_by_is_taken_as_drawn(bad: float) -> None:
    assert _share_not_drawn(bad, 0.01, 12.0) == 0.0
    assert _share_not_drawn(0.01, bad, 12.0) == 0.0
