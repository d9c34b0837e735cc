"""The one reader of pick-and-place lists: what it passes over, what it refuses, and that it says all at once."""

from __future__ import annotations

import csv
import io
from itertools import product

import pytest

from tactape_fab.base.errors import Problem
from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.kit.read.readback import read_cpl as read_exactly
from tactape_fab.texture import cpl
from tactape_fab.texture.cpl import CplContent, plain_columns, read_cpl, written_with

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


def test_a_cell_with_its_unit_is_read_in_no_other() -> None:
    rows = (b"R1\t500mil\t500\t45\t1\t1\t9\t9\tv\tf\t1\tn\n", b"R2\t12.7mm\t500\t45mm\t1\t1\t9\t9\tv\tf\t1\tn\n")
    content, problems = read(TABBED + b"".join(rows))
    assert content.xy_mm[0] == pytest.approx((12.7, 12.7))
    assert [message.split(" is ")[0] for message in problems] == [
        "cpl line 3: Rotation = '45mm'",
        "cpl line 3: X-Loc = '12.7mm'",
    ]


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


@pytest.mark.parametrize(
    ("house", "given_deg", "written_deg"),
    [
        (
            "generic",
            (0.0, 45.0, 360.0, -90.0, 359.99996, 180.0, 0.00004, 0.00006),
            (0.0, 45.0, 0.0, 270.0, 0.0, 180.0, 0.0, 0.0001),
        ),
        ("macrofab", (0.0, 45.0, 360.0, -90.0, 270.0, 0.00004), (0.0, 315.0, 0.0, 90.0, 90.0, 0.0)),
        ("kicad", (0.0, 45.0, 180.0, 180.001, 270.0, -180.0, 540.0), (0.0, 45.0, 180.0, -179.999, -90.0, 180.0, 180.0)),
    ],
)
def test_rotations_are_written_as_a_house_wants_them(
    house: str, given_deg: tuple[float, ...], written_deg: tuple[float, ...]
) -> None:
    table = cpl.PLACEMENTS[house]
    assert [table.written_deg(deg) for deg in given_deg] == pytest.approx(written_deg, abs=1e-9)


def test_each_house_has_its_own_words() -> None:
    said = {name: (t.ending, t.style, t.unit_mm, t.side, t.clockwise, t.half_turns) for name, t in cpl.PLACEMENTS.items()}
    usual = ("-cpl.csv", "csv", 1.0, "Top", False, False)
    assert said == {
        **dict.fromkeys(("generic", "jlcpcb", "pcbway", "eurocircuits"), usual),
        "macrofab": (".xyrs", "tab", 0.0254, "1", True, False),
        "kicad": ("-top.pos", "kicad", 1.0, "top", False, True),
    }
    assert tuple(said) == cpl.ASSEMBLY_FORMATS


def test_numbers_may_reach_ten_metres_and_a_turn() -> None:
    rows = (b"R1,10000,-10000,Top,360\n", b"R2,10000.001,0,Top,0\n", b"R3,0,-10000.001,Top,-360\n", b"R4,0,0,Top,360.01\n")
    content, problems = read(HEADER + b"".join(rows))
    assert content.xy_mm.tolist()[0] == [10_000.0, -10_000.0] and content.rotation_deg.tolist()[2] == -360.0
    assert problems == [
        "cpl line 3: Mid X = '10000.001' is not a number from -10000 to 10000 mm; correct it",
        "cpl line 4: Mid Y = '-10000.001' is not a number from -10000 to 10000 mm; correct it",
        "cpl line 5: Rotation = '360.01' is not a number from -360 to 360 deg; correct it",
    ]


@pytest.mark.parametrize("cell", ["", "1_0", "\u0661", "0x1", "nan", "inf", "1e", "1mil", "mm", "--1", "1e999"])
def test_what_is_no_number_in_every_program_is_none(cell: str) -> None:
    content, problems = read(HEADER + f"R1,1,2,Top,0\nR2,{cell},2,Top,0\n".encode())
    assert len(problems) == 1 and problems[0].startswith(f"cpl line 3: Mid X = {cell!r} is not a number")
    assert content.xy_mm[0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("cell", ["1.5", "+1.5", "15e-1", "1.5mm", " 1.5mm ", " 1.5 "])
def test_numbers_may_have_blanks_and_their_unit(cell: str) -> None:
    content, problems = read(HEADER + f"R1,{cell},-{cell.strip(' +')},Top,0\n".encode())
    assert not problems and content.xy_mm.tolist() == [[1.5, -1.5]]


def test_no_more_than_twenty_problems_are_said_the_first_lines_first() -> None:
    for count in (20, 21):
        content, problems = read(HEADER + b"".join(b"R%d,x,0,Top,0\n" % n for n in range(count)))
        assert [message.split(":")[0] for message in problems] == [f"cpl line {n}" for n in range(2, 22)]
        assert len(content.lines) == count


def test_other_columns_are_kept_by_their_content() -> None:
    content, problems = read(TABBED + b"R1\t1000\t2000\t45\tbottom\t1\t9\t8\tv\tf\t0\tn\n")
    assert not problems and content.table is cpl.PLACEMENTS["macrofab"] and content.headers == content.table.headers
    wanted = {"type": "1", "length": "9", "width": "8", "value": "v", "footprint": "f", "populate": "0", "part_number": "n"}
    assert content.texts == {key: (value,) for key, value in wanted.items()}
    assert content.xy_mm.tolist() == [[25.4, 50.8]] and content.sides == ("bottom",)


def test_lines_of_a_kicad_list_are_those_of_the_file() -> None:
    rows = b"R1 0R R_0201 1.0 2.0 180.0 top\n# a comment\n\nR2 0R R_0201 3.0 4.0 0.0 bottom\nR3 0R\n"
    content, problems = read(KICAD % rows)
    assert (content.lines, content.sides, content.texts["footprint"]) == ((4, 7), ("Top", "bottom"), ("R_0201", "R_0201"))
    assert problems == ["cpl line 8: it has 2 cells where the header has 7; correct it"]
    assert content.xy_mm.tolist() == [[1.0, 2.0], [3.0, 4.0]] and content.rotation_deg.tolist() == [180.0, 0.0]
    assert "no last line" in refused(KICAD.replace(b"# Ref", b"#Ref") % b"")


def test_the_list_with_most_columns_in_common_is_meant() -> None:
    assert "no column X (mm); write it with the columns Reference designator, X (mm)" in refused(
        b"Reference designator,Y (mm),Rotation,Side\n"
    )
    of_another_style = ",".join(cpl.PLACEMENTS["macrofab"].headers).encode() + b"\n"
    assert "no column Mid X, Mid Y, Layer; write it with" in refused(of_another_style)
    assert read("\ufeff".encode() + HEADER)[0].xy_mm.shape == (0, 2)
    assert cpl.MOST_CPL_BYTES == 64 << 20


def _by_csv(text: str) -> list[list[str]] | None:
    """Columns of a table of two or more that Python's csv module reads, and would write in these very bytes."""
    try:
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except csv.Error:
        return None
    again = io.StringIO(newline="")
    csv.writer(again).writerows(rows)
    whole = rows and len(rows[0]) > 1 and {len(row) for row in rows} == {len(rows[0])}
    return [list(column) for column in zip(*rows, strict=True)] if whole and again.getvalue() == text else None


def test_a_table_read_by_columns_is_the_one_that_csv_reads() -> None:
    texts = ["".join(letters) for size in range(7) for letters in product(("a", "é", ",", '"', "\r\n", "\n"), repeat=size)]
    found = [(text, plain_columns(text, ",")) for text in texts]
    assert all(columns == (None if '"' in text else _by_csv(text)) for text, columns in found)
    assert sum(columns is not None for _, columns in found) > 300
    assert plain_columns("a,b\r\nc\0,d\r\n", ",") is None
    assert plain_columns("a,b\r\n" + "c" * csv.field_size_limit() + "c,d\r\n", ",") is None


def test_numbers_are_written_with_few_letters() -> None:
    assert written_with("-12.5", "0123456789.-")
    assert not written_with("1_0", "0123456789.-")
    assert not written_with("\N{ARABIC-INDIC DIGIT ONE}", "0123456789.-")
