"""The map: figures of single designs, the same whoever works; a picture that a browser reads; refusals before any work."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from tactape_fab.advise import map as advise_map
from tactape_fab.advise.answer import LOCATED, advise, seen_of
from tactape_fab.advise.designs import Design
from tactape_fab.advise.map import MapPoint, map_of
from tactape_fab.advise.map_picture import draw_map
from tactape_fab.advise.model import CODES, LOSS, least_contact_mm
from tactape_fab.advise.question import read_question
from tactape_fab.cli import main
from tests.thorough import only_thorough, slow


@pytest.fixture
def three_pitches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advise_map, "PITCHES_MM", (0.8, 1.5, 2.0))


@only_thorough
@pytest.mark.usefixtures("three_pitches")
def test_points_are_those_of_single_designs_whoever_works() -> None:
    question = read_question({"contact_mm": 6})
    points = map_of(question)
    assert map_of(question, 2) == points
    assert [(p.part, p.pitch_mm) for p in points] == [(part, w) for part in ("r0201", "r01005") for w in (0.8, 1.5, 2.0)]
    assert points[0].least_mm == {} and points[0].parts == 0
    usual = points[1]
    assert (usual.parts, usual.each is not None) == (1984, True)
    design = Design(part="r0201", shape="block", body_mm=(0.6, 0.3, 0.23), pitch_mm=1.5, displacement_mm=0.3)
    found = least_contact_mm(seen_of(design, question, 1984), CODES[0], LOSS, LOCATED, 14.0)
    assert found is not None and usual.least_mm["microdots-4x4"] == found  # of three Δ the largest is the best here
    assert set(usual.least_mm) == {code.name for code in CODES}


@pytest.mark.usefixtures("three_pitches")
def test_pitches_that_a_small_tape_has_no_room_for_are_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advise_map, "FILM_PARTS", ("r0201",))
    narrow, usual, wide = map_of(read_question({"contact_mm": 8, "size_mm": (14.0, 12.0)}))
    assert usual.parts == 24 and usual.least_mm["microdots-4x4"] is not None
    assert narrow.least_mm == wide.least_mm == {} and wide.parts == 0 and wide.each is None


@pytest.mark.parametrize("least_mm", [7.0, 7.1, None])
def test_one_size_alone_is_drawn(least_mm: float | None) -> None:
    advice = advise(read_question({"contact_mm": 9.0}))
    points = [
        MapPoint(part="r0201", body_mm=(0.6, 0.3, 0.23), pitch_mm=w, least_mm={"microdots-4x4": least_mm} if w == 1.5 else {})
        for w in (1.4, 1.5, 1.6)
    ]
    root = ElementTree.fromstring(draw_map(advice, points))
    places = [line.attrib["points"] for line in root.iter() if line.tag.endswith("polyline")]
    # 7 mm at the lower end of an axis from 7 to 8, W in the middle
    assert places == ([] if least_mm is None else ["200.0,250.0" if least_mm == 7.0 else "200.0,225.0"])


@slow
@pytest.mark.usefixtures("three_pitches")
def test_the_picture_is_svg_and_json_has_its_points(tmp_path: Path) -> None:
    file = tmp_path / "map.svg"
    asked = f"advise --contact 6 --process sla --workers 1 --json --map {shlex.quote(str(file))}"
    result = CliRunner().invoke(main, shlex.split(asked))
    assert result.exit_code == 0, result.output
    points = json.loads(result.stdout)["map"]
    assert len(points) == 4 * 3 and all(p["cost_each"] is None for p in points)
    root = ElementTree.fromstring(file.read_bytes())
    words = [element.text for element in root.iter() if element.tag.endswith("text")]
    assert {"block, 0.4x0.3x0.2 mm", "dome, 0.6x0.6x0.23 mm", "asked: 6 mm"} <= set(words)
    assert any("microdots-4x4" in str(word) for word in words)
    again = CliRunner().invoke(main, shlex.split(asked))
    assert again.exit_code == 2
    assert "exists already; use --overwrite to replace it" in again.stderr
    again = CliRunner().invoke(main, shlex.split(f"{asked} --overwrite"))
    assert again.exit_code == 0 and file.read_bytes().startswith(b"<svg")


def test_a_drawing_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    file = tmp_path / "logo.svg"
    file.write_text('<svg xmlns="http://www.w3.org/2000/svg"><text>ours</text></svg>')
    result = CliRunner().invoke(main, ["advise", "--contact", "6", "--map", str(file), "--overwrite"])
    assert result.exit_code == 2 and "is no map of this tool" in result.stderr
    assert "ours" in file.read_text()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("--map map.png", "--map = map.png is drawn as SVG; give a name that ends in .svg"),
        ("--map nowhere/map.svg", "--map = nowhere/map.svg: there is no folder of that name; make it first"),
        ("--simulate --workers none", "--workers = 'none' is no number of processes and no address"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_rest(more: str, said: str) -> None:
    result = CliRunner().invoke(main, shlex.split(f"advise --contact 0 {more}"))
    assert result.exit_code == 2
    assert said in result.stderr
    assert "--contact = 0" in result.stderr


@pytest.mark.usefixtures("three_pitches")
def test_a_code_is_drawn_only_where_its_tape_is_as_long() -> None:
    """A sector of trace-22 has 127 columns: 190.5 mm at W 1.5, 254 mm at W 2."""
    points = map_of(read_question({"contact_mm": 6, "size_mm": [220.0, 50.0]}))
    drawn = {p.pitch_mm: "trace-22" in p.least_mm for p in points if p.part == "r0201" and p.least_mm}
    assert drawn == {1.5: False, 2.0: True}
