"""The one reader of pick-and-place lists: what it passes over, what it refuses, and that it says all at once."""

from __future__ import annotations

import pytest

from tactape_fab.base.errors import Problem
from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.kit.read.readback import read_cpl as read_exactly
from tactape_fab.texture import cpl
from tactape_fab.texture.cpl import CplContent, read_cpl

HEADER = b"Designator,Mid X,Mid Y,Layer,Rotation\n"
KICAD = b"### Footprint positions ###\n## Unit = mm, Angle = deg.\n# Ref Val Package PosX PosY Rot Side\n%s## End\n"
TABBED = b"#" + "\t".join(cpl.PLACEMENTS["macrofab"].headers).encode() + b"\n"


def read(data: bytes) -> tuple[CplContent, list[str]]:
    problems: list[Problem] = []
    content = read_cpl(data, problems)
    assert content is not None
    return content, [problem.message for problem in problems]


def refused(data: bytes) -> str:
    problems: list[Problem] = []
    assert read_cpl(data, problems) is None
    return "\n".join(problem.message for problem in problems)


def test_columns_may_stand_in_any_order_with_others_between() -> None:
    data = b"Note,Rotation,Designator,Layer,Mid Y,Mid X\n,45,R1,Top,2mm,1mm\n\nx,0,R2,Bottom,4,3\n"
    content, problems = read(data)
    assert not problems
    assert content.xy_mm.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert (content.designators, content.sides, content.lines) == (("R1", "R2"), ("Top", "Bottom"), (2, 4))
    with pytest.raises(ReadbackError, match="its columns are Note,Rotation"):
        read_exactly(data)


def test_every_problem_is_said_with_its_line_and_the_file_s_own_word() -> None:
    rows = (b"R1\t1\t2\t45\t1\t1\t9\t9\tv\tf\t1\tn\n", b"R2\t1\n", b"R3\tx\tinf\t361\t2\t1\t9\t9\tv\tf\t1\tn\n")
    content, problems = read(TABBED + b"".join(rows))
    assert content.designators == ("R1", "R3")
    assert content.xy_mm[0] == pytest.approx((0.0254, 0.0508))
    assert content.rotation_deg[0] == -45.0
    assert content.sides == ("Top", "2")
    assert [message.split(" is ")[0] for message in problems] == [
        "cpl line 3: it has 2 cells where the header has 12; correct it",
        "cpl line 4: Rotation = '361'",
        "cpl line 4: X-Loc = 'x'",
        "cpl line 4: Y-Loc = 'inf'",
    ]
    assert "from -393701 to 393701 mil" in problems[2]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "is empty"),
        (b"\n\n", "is empty"),
        (HEADER.replace(b"Mid Y", b"Y"), "no column Mid Y; write it with the columns Designator, Mid X"),
        (KICAD.replace(b"mm", b"inches") % b"", "not in millimetres"),
        (KICAD.removesuffix(b"## End\n") % b"", "no last line"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (HEADER + b'"R1,1,2,Top,45\n', "no CSV"),
    ],
)
def test_what_is_no_list_is_refused_in_words(data: bytes, says: str) -> None:
    assert says in refused(data)


def test_its_size_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cpl, "MOST_CPL_BYTES", len(HEADER))
    assert read(HEADER)[1] == []
    assert "larger than" in refused(HEADER + b"\n")


def test_a_kicad_list_without_rows_or_with_blank_lines_is_one() -> None:
    assert read(KICAD % b"")[0].xy_mm.shape == (0, 2)
    content, problems = read(KICAD % b"R1 0R R_0201 1.0 2.0 -45.0 top\n\n")
    assert (content.lines, content.sides, problems) == ((4,), ("Top",), [])
