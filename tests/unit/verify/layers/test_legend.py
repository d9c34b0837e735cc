"""The printed tag is found whatever its size, beside any label."""

from __future__ import annotations

from typing import Any

import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.read.gerber_file import read_gerber
from tactape_fab.kit.render.gerber import render_legend
from tactape_fab.verify.layers.legend import check_tag


@pytest.mark.parametrize("cell_mm", [0.3, 0.5, 0.63, 0.7, 0.783, 0.876, 0.95, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("more", [{}, {"sector": 44, "name": "nD.-r-oZ"}])
def test_a_tag_of_any_size_is_found_beside_its_label(more: dict[str, Any], cell_mm: float) -> None:
    made = examine(TapeSpec(**{"sector": 7, "size_mm": (120.0, 80.0), "tag_cell_mm": cell_mm, "models": False, **more}))
    (legend,) = render_legend(made.drawing, made.fab)
    (check,) = check_tag(read_gerber(legend.data), made.tape, legend_is_light=True, with_pupil=False)
    assert check.passed, check.message
