"""Drawings of several tapes joined to that of a panel: nothing of any tape is lost, whichever comes first."""

from __future__ import annotations

import pytest

from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.drawing import joined, tape_drawing
from tactape_fab.kit.spec.tape_spec import TapeSpec


@pytest.mark.parametrize("tags", [("none", "strip"), ("strip", "none")])
def test_a_label_keeps_its_width_beside_a_tape_without_one(tags: tuple[str, str]) -> None:
    specs = [TapeSpec(sector=k, size_mm=(25, 20), tag=tag, name=f"t{k}") for k, tag in enumerate(tags)]
    drawings = [tape_drawing(examine(spec).layout) for spec in specs]
    (labelled,) = (drawing.legend for drawing in drawings if drawing.legend.strokes_mm)
    whole = joined(drawings, [((7.0, 7.0), False), ((40.0, 7.0), True)]).legend
    assert whole.line_mm == labelled.line_mm > 0.0
    assert len(whole.strokes_mm) == len(labelled.strokes_mm)
