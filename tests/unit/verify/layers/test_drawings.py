"""DXF and PDF of the drawing: right ones pass, and one change of a layer, a tag or an object of the file is named."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.order_facts import order_facts
from tactape_fab.kit.read.gerber_file import read_gerber
from tactape_fab.kit.render.fab_drawing import render_fab_drawing
from tactape_fab.kit.render.fab_dxf import render_fab_dxf
from tactape_fab.kit.writer import render_all
from tactape_fab.verify.layers.drawings import _dxf_problems, _read_pdf
from tactape_fab.verify.layers.kicad import Shown, shown_tape
from tactape_fab.verify.layers.kicad_drawn import Made


@cache
def written() -> tuple[str, bytes, Shown, Made]:
    """DXF and PDF of a tape with a hole, and what is expected of them."""
    made = examine(TapeSpec(sector=7, size_mm=(40.0, 30.0), holes_mm=[(3.0, 15.0, 1.0)], models=False))
    assert made.film is not None
    artifacts = render_all(made.drawing, made.film.fab)
    facts = order_facts(made.film.layout, made.film.fab, made.findings, artifacts)
    (dxf,), (pdf,) = render_fab_dxf(facts, made.drawing), render_fab_drawing(facts, made.drawing)
    legend = next(each for each in artifacts if each.role == "legend-top")
    record: Any = None
    expected = Made(
        name=made.tape.name,
        tape=made.tape,
        record=record,
        gerbers={"legend-top": read_gerber(legend.data)},
        radius_mm=made.tape.board.corner_radius_mm,
    )
    return dxf.data.decode(), pdf.data, shown_tape(made.tape, np.empty((0, 2, 2)), 0.0), expected


def line(layer: str, low: tuple[float, float], high: tuple[float, float]) -> str:
    """A rectangle as the writer has it."""
    corners = [low, (high[0], low[1]), high, (low[0], high[1])]
    text = f"  0\nPOLYLINE\n  8\n{layer}\n 66\n1\n 10\n0.000000\n 20\n0.000000\n 30\n0.0\n 70\n1\n"
    text += "".join(f"  0\nVERTEX\n  8\n{layer}\n 10\n{x:.6f}\n 20\n{y:.6f}\n 30\n0.0\n" for x, y in corners)
    return f"{text}  0\nSEQEND\n  8\n{layer}\n"


def swapped(old: str, new: str) -> Callable[[str], str]:
    """The last one, as layers are named in the header as well."""

    def change(text: str) -> str:
        assert old in text
        return new.join(text.rsplit(old, 1))

    return change


def added(text: str) -> Callable[[str], str]:
    return swapped("  0\nENDSEC\n  0\nEOF\n", f"{text}  0\nENDSEC\n  0\nEOF\n")


HOLE = "HOLES\n 10\n3.000000\n 20\n15.000000\n 30\n0.0\n 40\n0.500000\n"
PRINTS = "it lets the fab print on parts, ink or holes, or off the board"
CHANGES: dict[str, tuple[Callable[[str], str], str]] = {
    "as it is": (lambda text: text, ""),
    "hole moved": (swapped(HOLE, HOLE.replace("3.000000", "3.002000")), "its HOLES are 1 contours that are not the 1 of the kit"),
    "hole larger": (swapped(HOLE, HOLE.replace("0.500000", "0.501000")), "its HOLES are 1 contours that are not the 1"),
    "hole by half a micrometre": (swapped(HOLE, HOLE.replace("3.000000", "3.000500")), ""),
    "hole gone": (swapped(f"  0\nCIRCLE\n  8\n{HOLE}", ""), "its HOLES are 0 contours that are not the 1"),
    "hole twice": (added(f"  0\nCIRCLE\n  8\n{HOLE}"), "its HOLES are 2 contours that are not the 1"),
    "hole above": (swapped("15.000000\n 30\n0.0\n", "15.000000\n 30\n1.0\n"), "a point of it is not in the plane"),
    "hole far away": (swapped(HOLE, HOLE.replace("3.000000", "10001.0")), "farther away than 10000 mm"),
    "hole nowhere": (swapped(HOLE, HOLE.replace("3.000000", "nan")), "'nan' stands where a number should"),
    "outline larger": (lambda text: text.replace("40.000000", "40.002000"), "its outline is not that of 40 x 30 mm"),
    "outline twice": (added(line("OUTLINE", (0.0, 0.0), (40.0, 30.0))), "its outline is not that of 40 x 30 mm"),
    "a slot": (added(line("SLOTS", (1.0, 1.0), (2.0, 9.0))), "its SLOTS are 1 contours that are not the 0"),
    "field with a corner cut off": (swapped("39.300000\n 20\n28.700000", "35.000000\n 20\n28.700000"), "is no rectangle"),
    "field without the last parts": (lambda text: text.replace("39.300000", "36.000000"), "parts lie in no FIELD of it"),
    "two fields": (added(line("FIELD", (0.0, 0.0), (1.0, 1.0))), ""),
    "no field": (
        lambda text: text[: (at := text.index("  0\nPOLYLINE\n  8\nFIELD"))] + text[text.index("  0\nPOLYLINE\n  8\nTAG", at) :],
        "parts lie in no FIELD",
    ),
    "area of ink": (added(line("TAG", (20.0, 0.2), (21.0, 0.9))), "its TAG are "),
    "line of ink": (added(line("LABEL", (20.0, 0.2), (21.0, 0.9)).replace("70\n1", "70\n0")), "its LABEL are "),
    "closed line of ink": (
        added(line("LABEL", (20.0, 0.2), (21.0, 0.9))),
        "a line of its 'LABEL' has a width or a bulge, or is not",
    ),
    "open outline": (
        lambda text: text.replace("70\n1\n  0\nVERTEX", "70\n0\n  0\nVERTEX", 1),
        "a line of its 'OUTLINE' has a width",
    ),
    "a number": (added(line("NUMBER", (20.0, 28.8), (24.0, 29.9))), ""),
    "a number on parts": (added(line("NUMBER", (20.0, 28.6), (24.0, 29.9))), PRINTS),
    "a number on the hole": (added(line("NUMBER", (2.0, 14.0), (4.0, 16.0))), PRINTS),
    "a number off the board": (added(line("NUMBER", (20.0, 28.8), (24.0, 30.1))), PRINTS),
    "a number left of it": (added(line("NUMBER", (-0.1, 28.8), (0.2, 29.9))), PRINTS),
    "another layer": (added(line("NOTES", (1.0, 1.0), (2.0, 2.0))), "its table has no layer 'NOTES'"),
    "another entity": (swapped("CIRCLE\n", "ELLIPSE\n"), "it draws a 'ELLIPSE'"),
    "another unit": (
        lambda text: text.replace("$INSUNITS\n 70\n4", "$INSUNITS\n 70\n1"),
        "it has another unit or release, a layer that",
    ),
    "a layer that is off": (
        lambda text: text.replace(" 62\n1\n", " 62\n-1\n", 1),
        "it has another unit or release, a layer that",
    ),
    "cut off": (lambda text: text[:-13], "or it was cut off"),
    "a line without end": (swapped("  0\nSEQEND\n", "  0\nSEQUEL\n"), "a line of it does not end"),
    "spread out": (lambda text: text.replace("  0\n", "   0\n", 1), "it is not written as this tool writes it"),
}


@pytest.mark.parametrize(("change", "says"), CHANGES.values(), ids=CHANGES)
def test_a_dxf_is_the_kit_s(change: Callable[[str], str], says: str) -> None:
    dxf, _, shown, made = written()
    problems = _dxf_problems(change(dxf).encode(), shown, made)
    assert bool(problems) == bool(says) and says in "; ".join(problems), problems


PDFS: dict[str, tuple[bytes, bytes, str]] = {
    "another version": (b"%PDF-1", b"%PDF-2", "it does not begin as one"),
    "a script": (b"/PageMode", b"/JS", "it holds '/JS'"),
    "objects in another order": (b"\n2 0 obj", b"\n3 0 obj", "its objects are not in order"),
    "another filter": (b"/FlateDecode", b"/LZWDecode", "it holds '/LZWDecode'"),
    "a longer stream": (b"/Length ", b"/Length 1", "a stream does not end where it says"),
    "something behind": (b"%%EOF\n", b"%%EOF\n ", "something stands behind it"),
    "another place": (b" 00000 n", b" 00001 n", "its table of objects is not of those"),
    "another start": (b"startxref\n", b"startxref\n1", "its table of objects is not of those"),
    "no catalogue": (b"/Catalog", b"/Page   ", "it has not one page"),
}


@pytest.mark.parametrize(("old", "new", "says"), PDFS.values(), ids=PDFS)
def test_a_pdf_in_another_form_is_refused(old: bytes, new: bytes, says: str) -> None:
    pdf = written()[1]
    assert old in pdf
    with pytest.raises((ValueError, zlib.error), match=re.escape(says)):
        _read_pdf(pdf.replace(old, new, 1))


def test_words_of_a_pdf_are_those_of_its_page() -> None:
    words = _read_pdf(written()[1])
    assert words.startswith(" OUTLINE, seen from the parts' side 40 30 ") and " radius 1 (4x) " in words


def test_a_page_is_unpacked_up_to_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactape_fab.verify.layers.drawings._MOST_TEXT", 1000)
    with pytest.raises(ValueError, match="its page is too long"):
        _read_pdf(written()[1])
