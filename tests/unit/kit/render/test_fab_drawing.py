"""The fab drawing: what is written on it, its fonts, and the same bytes every time."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
from pypdf import PdfReader

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.order import ExaminedPanel, examine_order
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.order_facts import order_facts, panel_order_facts
from tactape_fab.kit.panel.packing import pack_panels
from tactape_fab.kit.render.fab_drawing import A4_MM, PREVIEW_POINTS, render_fab_drawing
from tactape_fab.kit.render.pdf_sheet import Sheet, View, written
from tactape_fab.kit.writer import render_all
from tests.thorough import slow

POINTS_PER_MM = 72 / 25.4


@cache
def examined(**values: Any) -> Examined:
    return examine(TapeSpec(**{"sector": 7, "size_mm": (40.0, 30.0), "models": False, **values}))


def drawn(**values: Any) -> bytes:
    made = examined(**values)
    assert made.film is not None
    facts = order_facts(made.film.layout, made.film.fab, made.findings, render_all(made.drawing, made.film.fab))
    (artifact,) = render_fab_drawing(facts, made.drawing)
    assert (artifact.role, artifact.path) == ("fab-drawing", f"{made.tape.name}-drawing.pdf")
    return artifact.data


def words(data: bytes) -> str:
    (page,) = PdfReader(io.BytesIO(data)).pages
    return "\n".join(line.strip() for line in page.extract_text().splitlines())


def test_it_is_one_page_a4() -> None:
    (page,) = PdfReader(io.BytesIO(drawn())).pages
    assert np.allclose([float(v) for v in page.mediabox[2:]], np.array(A4_MM) * POINTS_PER_MM)


def test_it_says_the_tape_the_layers_and_the_parts() -> None:
    text, made = words(drawn(stiffener="PI 0.2", adhesive="tesa8854 0.1")), examined()
    for said in ("tactape-s007", "sector 7 of microdots-4x4", "amber", "PI 0.2 mm", "tesa8854 0.1 mm", "ENIG", "45°"):
        assert said in text
    # what sticks the tape to an object is outermost
    assert "PI 0.2 mm, whole underside" in text and "tesa8854 0.1 mm under the stiffener" in text
    assert f"{made.tape.part_count} openings of 1.2 x 0.5" in text
    assert "leans like this: /" in text


def test_dimensions_are_those_of_the_board() -> None:
    made = examined()
    assert made.film is not None
    facts = order_facts(made.film.layout, made.film.fab, made.findings, render_all(made.drawing, made.film.fab))
    text = words(drawn()).splitlines()
    assert {"40", "30", f"{facts.field_mm[0]:g}", f"field {facts.field_mm[2] - facts.field_mm[0]:g}", "W 1.5"} <= set(text)


def test_the_corner_names_the_first_parts_and_no_others() -> None:
    text, made = words(drawn()).splitlines(), examined()
    named = {int(line[1:]) for line in text if line.startswith("R") and line[1:].isdigit()}
    columns = made.tape.columns
    assert named == {row * columns + column + 1 for row in range(PREVIEW_POINTS) for column in range(PREVIEW_POINTS)}


def test_one_window_is_said_where_the_coverlay_has_one() -> None:
    text = words(drawn(coverlay="gang"))
    assert "one opening for all parts" in text
    assert "not merged" not in text


def test_holes_are_listed_up_to_eight() -> None:
    few = words(drawn(size_mm=(60.0, 40.0), holes_mm=((30.0, 20.0, 2.0),)))
    many = words(drawn(size_mm=(60.0, 40.0), holes_mm=tuple((12.0 + 4 * i, 20.0, 1.0) for i in range(10))))
    assert "x 30.000" in few
    assert "in the drill file" not in few
    assert "and 2 more" in many


def of_panel(**values: str) -> str:
    """The words of the drawing of a panel of 2 x 2 tapes."""
    panel, _ = examine_order({"sectors": "0-3", "panel": "2x2", "size_mm": (40.0, 30.0), "models": False, **values})
    assert isinstance(panel, ExaminedPanel)
    film = panel.tapes[0].film
    assert film is not None
    artifacts = render_all(panel.drawing, film.fab)
    layouts = [tape.layout for tape in panel.tapes]
    facts = panel_order_facts(panel.name, panel.panel, layouts, film.fab, panel.findings, artifacts)
    (artifact,) = render_fab_drawing(facts, panel.drawing)
    return words(artifact.data)


def test_a_panel_numbers_its_tapes() -> None:
    text = of_panel()
    assert {"1", "2", "3", "4"} <= set(text.splitlines())
    assert "2 x 2 tapes" in text


def test_rails_of_a_panel_have_no_backing() -> None:
    text = of_panel(stiffener="PI:0.2", adhesive="tesa8854:0.1")
    assert "PI 0.2 mm, under the tapes alone" in text and "tesa8854 0.1 mm under the stiffener" in text
    assert "tesa8854 0.1 mm, under the tapes alone" in of_panel(adhesive="tesa8854:0.1")
    assert "whole underside" not in text


def packed(*sizes_mm: tuple[float, float]) -> tuple[ExaminedPanel, str]:
    """A packed panel of tapes of these sizes, and the words of its drawing on one line."""
    tapes = [examined(sector=number, size_mm=size_mm) for number, size_mm in enumerate(sizes_mm)]
    _, (found,) = pack_panels([(tape.tape.board.size_mm, 1.0) for tape in tapes], tapes[0].fab)
    panel = ExaminedPanel(name="panel", tapes=tuple(tapes[i] for i in found.tapes), panel=found.panel, remarks=())
    film = panel.tapes[0].film
    assert film is not None
    artifacts, layouts = render_all(panel.drawing, film.fab), [tape.layout for tape in panel.tapes]
    facts = panel_order_facts("panel", found.panel, layouts, film.fab, panel.findings, artifacts)
    (artifact,) = render_fab_drawing(facts, panel.drawing)
    return panel, " ".join(words(artifact.data).split())


def test_parts_of_tapes_that_lie_turned_are_said_to_stand_otherwise() -> None:
    panel, text = packed((200.0, 30.0), (30.0, 200.0), (30.0, 40.0))
    assert {place.turned for place in panel.panel.places} == {False, True}
    assert "Parts, tape by tape, turned 45° or 135° counter-clockwise." in text
    assert "every part leans like this: / or, on turned tapes, \\" in text


def test_one_part_is_drawn_as_it_lies_where_all_tapes_are_turned() -> None:
    panel, text = packed((30.0, 40.0), (40.0, 60.0))
    assert all(place.turned for place in panel.panel.places)
    assert "All parts turned 135° counter-clockwise." in text
    outlines, parts = panel.drawing.outlines, panel.drawing.parts[0]
    np.testing.assert_allclose(outlines.pad_xy, (parts.pads.xy_mm.reshape(-1, 2, 2) - parts.xy_mm[:, None])[0], atol=2e-6)
    assert parts.openings is not None
    for shape, as_placed in ((outlines.body, parts.bodies), (outlines.opening, parts.openings), (outlines.paste, parts.paste)):
        np.testing.assert_allclose(shape, as_placed.outline_mm, atol=2e-6)


def test_notes_of_mask_and_copper_are_the_tape_s() -> None:
    mask = words(drawn(fab="generic-lpi", pitch_mm=2.0))
    assert "one opening for all parts" not in mask and "not merged" in mask
    assert "Openings of the solder mask" in mask and "coverlay" not in mask.lower()
    held = words(drawn(anchor="spur", pitch_mm=2.2))
    assert "Copper runs on from the pads" in held and "stand alone" not in held
    assert "Pads stand alone" in words(drawn())


def test_all_fonts_are_embedded() -> None:
    (page,) = PdfReader(io.BytesIO(drawn())).pages
    fonts = [font.get_object() for font in page["/Resources"]["/Font"].values()]  # type: ignore[index]
    assert len(fonts) >= 2
    for font in fonts:
        assert "/FontFile2" in font["/FontDescriptor"]


def test_it_is_vector_alone() -> None:
    (page,) = PdfReader(io.BytesIO(drawn())).pages
    assert not list(page.images)


@slow
def test_the_bytes_are_the_same_in_another_process() -> None:
    code = f"from {__name__} import drawn; import hashlib; print(hashlib.sha256(drawn()).hexdigest())"
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed, "TZ": zone},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for seed, zone in (("1", "UTC"), ("2", "Asia/Tokyo"))
    }
    assert len(digests) == 1


def test_characters_that_the_font_lacks_are_replaced() -> None:
    assert written("Δ 0.25 µm ±1") == "∆ 0.25 µm ±1"
    assert written("板") == "?"


def test_a_view_maps_the_board_to_the_sheet() -> None:
    view = View(scale=2.0, at_mm=(10.0, 20.0), origin_mm=(1.0, 1.0))
    np.testing.assert_allclose(view(np.array([[1.0, 1.0], [2.0, 3.0]])), [[10.0, 20.0], [12.0, 24.0]])


@pytest.mark.parametrize("words_", ["5", "123.456"])
def test_a_dimension_shows_its_figure(words_: str) -> None:
    sheet = Sheet((100.0, 100.0), "a dimension")
    sheet.dimension(np.array([10.0, 10.0]), np.array([60.0, 10.0]), words_, away_mm=8.0)
    assert words_ in words(sheet.pdf())
