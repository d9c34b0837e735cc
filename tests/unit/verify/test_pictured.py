"""Where a picture shows a board's points: its scale, to a fraction of a pixel at the far end of a panel."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.kit.render import preview
from tactape_fab.verify.pictured import Pictured, px_per_mm


@pytest.fixture(autouse=True)
def as_released(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other tests draw coarser pictures."""
    monkeypatch.setattr(preview, "PX_PER_MM", 20.0)


def scale_of(side_px: int, side_mm: float) -> float:
    """The scale that a square picture of a square board is taken to have."""
    shown = Pictured(size_mm=(side_mm, side_mm), xy_mm=np.zeros((1, 2)), rotation_deg=np.zeros(1), body_mm=(0.6, 0.3))
    return px_per_mm(np.zeros((side_px, side_px, 3), dtype=np.uint8), shown)


@pytest.mark.parametrize(
    ("side_px", "side_mm", "expected"), [(3880, 190.0, 20.0), (2083, 100.11, 20.0), (6000, 600.0, 6000 / 604)]
)
def test_a_picture_of_this_version_has_its_scale(side_px: int, side_mm: float, expected: float) -> None:
    """With half a pixel less, the far end of a panel of 190 mm was half a pixel off: two good parts of 6,100 failed."""
    assert scale_of(side_px, side_mm) == expected


def test_a_picture_of_another_scale_is_known_to_half_a_pixel() -> None:
    """One of 30 px/mm has 5,820 pixels."""
    assert abs(scale_of(5820, 190.0) - 30.0) * 194.0 <= 0.5 + 1e-9
