"""The preview of a film or a panel, drawn from its written files."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.base.image_file import png_size
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.render.preview import MARGIN_MM, MOST_PX, picture_px_per_mm
from tactape_fab.kit.writer import render_all


@pytest.mark.usefixtures("kits_as_elsewhere")
@pytest.mark.parametrize("size_mm", [(297.1, 12.0), (610.0, 12.0), (12.0, 299.1), (300.0, 12.0)])
def test_a_long_board_s_picture_is_no_larger_than_verify_opens(size_mm: tuple[float, float]) -> None:
    scale = picture_px_per_mm(max(size_mm) + 2 * MARGIN_MM)
    made = examine({"sector": 7, "size_mm": size_mm, "tag": "none", "pitch_mm": 2.0, "displacement_mm": 0.3, "models": False})
    (png,) = (a.data for a in render_all(made.drawing, made.fab) if a.role == "preview-png")
    height, width = png_size(png)
    assert max(width, height) == MOST_PX
    wanted = (np.array(size_mm) + 2 * MARGIN_MM) * scale
    assert np.abs(np.array([width, height]) - wanted).max() <= 1.0
