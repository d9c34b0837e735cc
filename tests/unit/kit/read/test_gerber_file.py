"""Gerber files in arrays: everything that gerbonara's own list of objects holds, read in its way whatever comes first."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from gerbonara.graphic_objects import Flash, Line, Region
from gerbonara.rs274x import GerberFile, GerberParser

from tactape_fab import Kit
from tactape_fab.kit.read.gerber_file import GerberContent, ReadbackError, read_gerber

HEAD = "%FSLAX46Y46*%\n%MOMM*%\n%LPD*%\nG75*\nG01*\n%ADD10C,0.1*%\n%ADD11C,0.2*%\nD10*\n"
GERBERS = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile", "components-top")


def drawn(*lines: str, head: str = HEAD) -> GerberContent:
    return read_gerber((head + "\n".join([*lines, "M02*\n"])).encode("ascii"))


def points(*xy: tuple[float, float]) -> list[list[float]]:
    return [list(point) for point in xy]


def test_gerbonara_is_a_version_that_its_parser_s_order_has_been_tried_with() -> None:
    """Read `gerber_file._drawn` against a new version of gerbonara, then name it here and in pyproject.toml.

    1.5.0 is the last for Python 3.10 and 3.11; in the parser 1.6.3 changes polygon apertures, %SR and attributes without a value.
    """
    assert version("gerbonara") in ("1.5.0", "1.6.3")
    assert '"gerbonara>=1.5,<=1.6.3"' in (Path(__file__).parents[4] / "pyproject.toml").read_text(encoding="utf-8")
    kinds = GerberParser.STATEMENT_REGEXES
    assert {"coord", "attribute", "aperture"} <= kinds.keys()
    parser = GerberParser(GerberFile())
    assert all(callable(getattr(parser, f"_parse_{kind}")) for kind in kinds)


@pytest.mark.parametrize("role", GERBERS)
def test_arrays_hold_what_gerbonara_draws(small_kit: Kit, role: str) -> None:
    data = (small_kit.path / small_kit.files[role]).read_bytes()
    content, objects = read_gerber(data), GerberFile.from_string(data.decode("ascii")).objects
    flashes = [o for o in objects if isinstance(o, Flash)]
    lines = [o for o in objects if isinstance(o, Line)]
    assert content.flash_xy_mm.tolist() == [[o.x, o.y] for o in flashes]
    names = [(*o.attrs.get(".P", o.attrs.get(".C", ())), "", "")[:1] for o in flashes]
    assert list(content.flash_component) == [name for (name,) in names]
    assert [area.tolist() for area in content.areas_mm] == [
        [list(point) for point in o.outline] for o in objects if isinstance(o, Region)
    ]
    ends = {(*a, *b) for stroke in content.strokes_mm for a, b in zip(stroke[:-1].tolist(), stroke[1:].tolist(), strict=True)}
    assert {(o.x1, o.y1, o.x2, o.y2) for o in lines} <= ends
    assert len(lines) == sum(len(stroke) - 1 for stroke in content.strokes_mm) or role == "profile"  # which has arcs, too


def test_lines_join_where_the_next_begins_at_the_open_end_of_the_last() -> None:
    content = drawn(
        *("X0Y0D02*", "X1000000Y0D01*", "X1000000Y1000000D01*"),  # two lines on
        *("X3000000Y0D02*", "X4000000Y0D01*"),  # somewhere else
        *("D11*", "X5000000Y0D01*"),  # with another pen
        *("X5000000Y0D02*", "X6000000Y0D01*", "X6000000Y1000000D01*", "X5000000Y0D01*"),  # with the same pen, and round
        *("X7000000Y0D01*", "X7000000Y1000000D01*", "X5000000Y0D01*"),  # from where that closed, and round again
        *("X5000000Y9000000D01*",),
    )
    assert [stroke.tolist() for stroke in content.strokes_mm] == [
        points((0, 0), (1, 0), (1, 1)),
        points((3, 0), (4, 0)),
        points((4, 0), (5, 0), (6, 0), (6, 1), (5, 0), (7, 0), (7, 1), (5, 0), (5, 9)),
    ]
    assert content.stroke_width_mm.tolist() == [0.1, 0.1, 0.2]


def test_a_line_that_follows_on_a_closed_polyline_begins_another() -> None:
    triangle = ("X1000000Y0D01*", "X1000000Y1000000D01*", "X0Y0D01*")
    other = ("X-1000000Y0D01*", "X-1000000Y-1000000D01*", "X0Y0D01*")
    content = drawn("X0Y0D02*", *triangle, *other, "X0Y5000000D01*")
    assert [stroke.tolist() for stroke in content.strokes_mm] == [
        points((0, 0), (1, 0), (1, 1), (0, 0)),
        points((0, 0), (-1, 0), (-1, -1), (0, 0)),
        points((0, 0), (0, 5)),
    ]


def test_back_and_forth_is_closed_and_a_line_of_no_length_is_not() -> None:
    content = drawn(
        "X0Y0D02*", "X0Y0D01*", "X1000000Y0D01*", "X2000000Y0D02*", "X3000000Y0D01*", "X2000000Y0D01*", "X9000000Y0D01*"
    )
    assert [stroke.tolist() for stroke in content.strokes_mm] == [
        points((0, 0), (0, 0), (1, 0)),
        points((2, 0), (3, 0), (2, 0)),
        points((2, 0), (9, 0)),
    ]


def test_arcs_are_chords_that_begin_and_end_where_they_do() -> None:
    (stroke,) = drawn("X1000000Y0D02*", "G03*", "X0Y1000000I-1000000J0D01*", "G01*", "X0Y3000000D01*").strokes_mm
    assert stroke[0].tolist() == [1.0, 0.0]
    assert stroke[-2:].tolist() == points((0, 1), (0, 3))
    assert np.abs(np.hypot(*stroke[:-1].T) - 1.0).max() < 1e-9
    assert len(stroke) > 50


def test_an_arc_that_does_not_fit_is_said_as_such() -> None:
    with pytest.raises(ReadbackError, match=r"^an arc of it does not fit its centre$"):
        drawn("X1000000Y0D02*", "G03*", "X0Y1100000I-1000000J0D01*")


def test_a_number_is_read_anew_where_the_format_changes() -> None:
    """Coordinates are remembered, but not beyond the format that says how to read them."""
    late = "%MOMM*%\n%LPD*%\nG75*\nG01*\n%ADD10C,0.1*%\nD10*\nX12Y34D03*\n%FSLAX46Y46*%\n"
    text = late + "X12Y34D03*\nM02*\n"
    expected = [[o.x, o.y] for o in GerberFile.from_string(text).objects]
    assert expected[0] != expected[1]
    assert drawn("X12Y34D03*", head=late).flash_xy_mm.tolist() == expected


def test_clear_polarity_and_inches_are_seen() -> None:
    assert not drawn("X0Y0D03*").clear
    assert drawn("X0Y0D03*", "%LPC*%", "X0Y5D03*").clear
    with pytest.raises(ReadbackError, match="not in millimetres"):
        drawn("X0Y0D03*", head=HEAD.replace("MOMM", "MOIN"))
