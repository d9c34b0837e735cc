"""What the component layer says of its parts, one statement of it changed at a time."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.read.gerber_file import read_gerber
from tactape_fab.kit.writer import render_all
from tactape_fab.verify.layers.board import check_part_data
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly

PART = "R5"
_BLOCK = re.compile(rf"%TO\.C,{PART}\*%.*?%TD\.P\*%\n", re.DOTALL)
_CORNERS = re.compile(r"(X\d+Y\d+)D02\*\n(X\d+Y\d+)D01\*\n(X\d+Y\d+)D01\*\n(X\d+Y\d+)D01\*\n(X\d+Y\d+)D01\*\n")
BODY, CENTRE_OR_PIN = "the body of a part ", "a centre or pin is flashed with another aperture"


def outline(order: str) -> str:
    """The corners of a body in another order, as a template of `re.sub`."""
    return rf"\{order[0]}D02*\n" + "".join(rf"\{k}D01*\n" for k in order[1:])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda block: block, ""),
        (lambda block: _CORNERS.sub(outline("23412"), block), ""),
        (lambda block: _CORNERS.sub(outline("13241"), block), BODY),
        (lambda block: _CORNERS.sub(outline("12221"), block), BODY),
        (lambda block: _CORNERS.sub(outline("12343"), block), BODY),
        (lambda block: block.replace("D11*\n", ""), BODY),
        (lambda block: block.replace("D12*\n", ""), CENTRE_OR_PIN),
        (lambda block: block.replace("D13*\n", ""), CENTRE_OR_PIN),
        (lambda block: block.replace("D10*\n", "D12*\n"), CENTRE_OR_PIN),
    ],
)
def test_a_part_s_body_and_pins_are_drawn_as_the_standard_has_them(change: Callable[[str], str], says: str) -> None:
    made = examine(TapeSpec(sector=7, size_mm=(26.0, 20.0), pitch_mm=2.2, displacement_mm=0.3, models=False))
    part = made.drawing.part
    (layer,) = (a for a in render_all(made.drawing, made.fab) if isinstance(a, Artifact) and a.role == "components-top")
    text = layer.data.decode("ascii")
    data = _BLOCK.sub(lambda found: change(found[0]), text).encode("ascii")
    names = {"value": part.value, "footprint": part.footprint, "description": part.description}
    recorded = RecordedAssembly(format="generic", part_number="", **names)
    check = check_part_data(read_gerber(data), data, made.tape, recorded, part.pads)
    assert check.passed != bool(says) and says in check.message
