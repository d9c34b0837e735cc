"""Gerber and drill files in the writer's form: right ones pass, and each difference of the two readings is named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.read.gerber_file import GerberContent, read_gerber
from tactape_fab.kit.render.drill import render_drill
from tactape_fab.kit.render.gerber import render_copper, render_legend, render_profile
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.written_form import alike, check_form, drill_problems, same_contours, segments


@cache
def written() -> tuple[dict[str, WrittenFile], dict[str, GerberContent]]:
    """Files of a tape with two sizes of holes, and gerbonara's reading of them."""
    spec = TapeSpec(sector=7, size_mm=(40.0, 30.0), holes_mm=[(3.0, 15.0, 1.0), (37.0, 15.0, 2.0)], models=False)
    made = examine(spec)
    found = [*render_copper(made.drawing, made.fab), *render_legend(made.drawing, made.fab)]
    found += [*render_profile(made.drawing, made.fab), *render_drill(made.drawing, made.fab)]
    files = {each.role: WrittenFile(path=each.role, data=each.data) for each in found}
    return files, {role: read_gerber(file.data) for role, file in files.items() if role != "drill-npth"}


def test_files_of_the_writer_pass() -> None:
    files, gerbers = written()
    check = check_form(files, gerbers)
    assert check.passed and check.figure == 4.0 and check.message.startswith("4 files in the writer's grammar")
    without = {role: file for role, file in files.items() if role != "drill-npth"}
    assert check_form(without, gerbers).figure == 3.0


@pytest.mark.parametrize(
    ("role", "change", "says"),
    [
        ("copper-top", lambda c: {"flash_xy_mm": c.flash_xy_mm + 1.9e-6}, ""),
        ("copper-top", lambda c: {"flash_xy_mm": c.flash_xy_mm + 2.1e-6}, "other flashes"),
        ("copper-top", lambda c: {"flash_xy_mm": c.flash_xy_mm[1:], "flash_aperture": c.flash_aperture[1:]}, "other flashes"),
        ("copper-top", lambda c: {"flash_aperture": c.flash_aperture + 1}, "other flashes"),
        ("copper-top", lambda c: {"aperture_outlines_mm": (1.001 * c.aperture_outlines_mm[0],)}, "other apertures"),
        ("copper-top", lambda c: {"aperture_outlines_mm": ()}, "other apertures"),
        ("legend-top", lambda c: {"areas_mm": c.areas_mm[1:]}, "other regions"),
        ("legend-top", lambda c: {"areas_mm": c.areas_mm[::-1]}, "other regions"),
        ("legend-top", lambda c: {"strokes_mm": tuple(line + 0.001 for line in c.strokes_mm)}, "other lines"),
        ("legend-top", lambda c: {"stroke_width_mm": c.stroke_width_mm + 0.001}, "other widths of lines"),
        ("profile", lambda c: {"strokes_mm": (c.strokes_mm[0][:4], c.strokes_mm[0][3:])}, ""),
    ],
)
def test_what_the_readings_differ_in_is_named(role: str, change: Any, says: str) -> None:
    files, gerbers = written()
    check = check_form(files, {**gerbers, role: replace(gerbers[role], **change(gerbers[role]))})
    assert check.passed == (not says)
    assert not says or check.message == f"{role}: gerbonara reads {says} than the grammar"


@pytest.mark.parametrize(
    ("role", "old", "new", "says"),
    [
        ("copper-top", b"SMDPad,CuDef", b"ViaDrill", "copper-top: an aperture of it is for '.AperFunction,ViaDrill'"),
        ("legend-top", b"Material", b"Profile", "legend-top: an aperture of it is for '.AperFunction,Profile'"),
        ("profile", b"%MOMM*%", b"%MOIN*%", "profile: "),
        ("drill-npth", b"METRIC", b"INCH", "drill-npth: it is not as the writer writes it"),
    ],
)
def test_another_form_is_named(role: str, old: bytes, new: bytes, says: str) -> None:
    files, gerbers = written()
    data = files[role].data.replace(old, new, 1)
    check = check_form({**files, role: replace(files[role], data=data)}, gerbers)
    assert not check.passed and check.message.startswith(says)


OTHER, TWICE = "it is not as the writer writes it: ", "its tools are not each defined and taken once, in order"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("X3.0000Y15.0000\n", "X3.0000Y15.0000\nX-3.0000Y5.0000\n", ""),
        ("X3.0000", "X3.000", OTHER),
        ("X3.0000Y15.0000\n", "X3.0000Y15.0000G85X5.0000Y15.0000\n", OTHER),
        ("M30\n", "M30\nT1\n", OTHER),
        ("G05\n", "", OTHER),
        ("Single", "Other", OTHER),
        ("T2C2.0000", "T1C2.0000", TWICE),
        ("T2C2.0000", "T3C2.0000", TWICE),
        ("\nT2\n", "\nT1\n", TWICE),
        ("M30\n", "T1\nX9.0000Y9.0000\nM30\n", TWICE),
    ],
)
def test_a_drill_file_has_each_tool_once(old: str, new: str, says: str) -> None:
    text = written()[0]["drill-npth"].data.decode()
    assert old in text
    problems = drill_problems(text.replace(old, new, 1).encode())
    assert bool(problems) == bool(says) and says in "".join(problems)


def test_segments_and_contours() -> None:
    strokes = [np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)]), np.array([(5.0, 5.0), (6.0, 5.0)])]
    assert segments(strokes).tolist() == [[0, 0, 1, 0], [1, 0, 1, 2], [5, 5, 6, 5]]
    assert segments([]).shape == (0, 4) and segments(strokes[:1]).tolist() == [[0, 0, 1, 0], [1, 0, 1, 2]]
    assert alike(strokes[0], strokes[0] + 1.9e-6) and not alike(strokes[0], strokes[0] + 2.1e-6)
    assert not alike(strokes[0], strokes[1]) and alike(strokes[0], strokes[0] - 0.1, 0.11)
    closed = [np.vstack([strokes[0], strokes[0][:1]])]
    assert same_contours(closed, strokes[:1], 1e-6) and same_contours(strokes[:1], closed, 1e-6)
    assert not same_contours(closed, strokes, 1e-6) and not same_contours([strokes[0][::-1]], closed, 1e-6)
    assert same_contours([strokes[0] + 0.01], closed, 0.011) and not same_contours([strokes[0] + 0.01], closed, 0.009)
