"""Text of a Gerber file: each statement as it is written, by the clauses of the Gerber Layer Format Specification 2024.05."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from tactape_fab.base.build_date import build_date
from tactape_fab.base.version import __version__
from tactape_fab.kit.film.drawing import Project
from tactape_fab.kit.profiles import X2Mode
from tactape_fab.kit.render import gerber_text
from tactape_fab.kit.render.gerber_text import GerberText

PROJECT = Project(name="t", key="k")
FRAME = {"full": ("%", "*%"), "comments": ("G04 #@! ", "*")}


def of(x2: X2Mode = "full", **said: str) -> GerberText:
    return GerberText(PROJECT, x2, "Copper,L1,Top", **said)


def attributes(x2: str, *said: str) -> list[str]:
    before, behind = FRAME.get(x2, ("", ""))
    return [f"{before}{content}{behind}" for content in said] if x2 in FRAME else []


def written(text: GerberText, x2: str = "full") -> list[str]:
    """The lines between the head of a file and its end, both of which are looked at."""
    data = text.data().decode("ascii")
    assert data.endswith("\n")
    lines = data.splitlines()
    head = [*attributes(x2, *HEAD), "%FSLAX46Y46*%", "%MOMM*%", "%LPD*%", "G75*", "G01*"]
    signed = data[: data.index("TF.MD5") - len(FRAME[x2][0])] if x2 in FRAME else ""
    digest = hashlib.md5(signed.replace("\n", "").encode(), usedforsecurity=False).hexdigest()
    end = [*attributes(x2, f"TF.MD5,{digest}"), "M02*"]
    assert lines[: len(head)] == head and lines[-len(end) :] == end
    return lines[len(head) : -len(end)]


HEAD = (
    f"TF.GenerationSoftware,tactape-fab,tactape-fab,{__version__}",
    f"TF.CreationDate,{build_date():%Y-%m-%d}T00:00:00+00:00",
    f"TF.ProjectId,{PROJECT.id}",
    f"TF.SameCoordinates,{PROJECT.guid}",
    "TF.Part,Single",
    "TF.FileFunction,Copper,L1,Top",
    "TF.FilePolarity,Positive",
)
NO_APERTURE = ["%TA.AperFunction,Material*%", "%ADD10C,0.100000*%", "%TD*%"]


def test_a_file_without_apertures_defines_one() -> None:
    assert written(of()) == NO_APERTURE
    text = of(polarity="Negative")
    assert b"%TF.FilePolarity,Negative*%\n" in text.data()


@pytest.mark.parametrize("x2", ["full", "comments", "off"])
def test_apertures_are_numbered_from_10_and_have_their_function(x2: X2Mode) -> None:
    text = of(x2)
    assert (text.circle(0.25, "Profile"), text.polygon(1.5, 6, "Other,a")) == ("D10", "D11")
    square = np.array([(0.5, -0.5), (0.5, 0.5), (-1e-9, 0.5)])
    assert text.outline("PAD", square, "SMDPad,CuDef") == "D12"
    assert written(text, x2) == [
        *attributes(x2, "TA.AperFunction,Profile"),
        "%ADD10C,0.250000*%",
        *attributes(x2, "TD", "TA.AperFunction,Other,a"),
        "%ADD11P,1.500000X6X0.000000*%",
        *attributes(x2, "TD"),
        *("%AMPAD*", "4,1,3,", "0.500000,-0.500000,", "0.500000,0.500000,", "0.000000,0.500000,", "0.500000,-0.500000,", "0*%"),
        *attributes(x2, "TA.AperFunction,SMDPad,CuDef"),
        "%ADD12PAD*%",
        *attributes(x2, "TD"),
    ]


@pytest.mark.parametrize("portion", [1, 2, 3, 20_000])
def test_flashes_are_whole_nanometres_in_whatever_portions(portion: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gerber_text, "_CHUNK", portion)
    text = of()
    code = text.circle(0.25, "Profile")
    text.object_attribute("C,R1")
    text.flash(code, np.array([(1.5, 2.0000004), (-0.25, 0.0), (3.0, 4.0)]))
    text.delete_attributes()
    assert written(text)[3:] == [
        "%TO.C,R1*%",
        "D10*",
        "X1500000Y2000000D03*",
        "X-250000Y0D03*",
        "X3000000Y4000000D03*",
        "%TD*%",
    ]


@pytest.mark.parametrize(("x2", "line"), [("full", "%%TO.P,R%d,1*%%\n"), ("comments", "G04 #@! TO.P,R%d,1*\n"), ("off", "")])
def test_an_attribute_may_be_of_every_row(x2: X2Mode, line: str) -> None:
    text = of(x2)
    assert text.attribute_line("TO.P,R%d,1") == line
    text.rows(line + "X%dD03*\n" if line else "X%dD03*\n", np.array([(1, 5), (2, 6)] if line else [(5,), (6,)]))
    said = [(*attributes(x2, f"TO.P,R{n},1"), f"X{n + 4}D03*") for n in (1, 2)]
    own = 3 if x2 != "off" else 1
    assert written(text, x2)[:-own] == [row for rows in said for row in rows]


def test_regions_are_closed_and_strokes_are_open() -> None:
    text = of()
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)])
    text.regions([corners, corners + 3.0], "Material")
    text.stroke(corners)
    regions = [
        ["G36*", f"X{a}Y{a}D02*", f"X{b}Y{a}D01*", f"X{b}Y{c}D01*", f"X{a}Y{a}D01*", "G37*"]
        for a, b, c in ((0, 1_000_000, 2_000_000), (3_000_000, 4_000_000, 5_000_000))
    ]
    assert written(text) == [
        "%TA.AperFunction,Material*%",
        *regions[0],
        *regions[1],
        "%TD*%",
        *("X0Y0D02*", "X1000000Y0D01*", "X1000000Y2000000D01*"),
        *NO_APERTURE,
    ]
