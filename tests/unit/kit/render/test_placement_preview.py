"""The picture of the first placements is drawn from the list and the layers: what is wrong in them is wrong in it."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.artifact import AnyArtifact, Artifact
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.drawing import joined
from tactape_fab.kit.profiles import load_fab
from tactape_fab.kit.render.placement_preview import render_placement_preview
from tactape_fab.kit.writer import render_all

FAB = load_fab("generic-fpc")
_SVG = "{http://www.w3.org/2000/svg}"


def artifacts(**values: object) -> list[AnyArtifact]:
    made = examine(TapeSpec(**{"sector": 7, "size_mm": (30.0, 20.0), "models": False, **values}))  # type: ignore[arg-type]
    return render_all(made.drawing, made.fab)


def drawn(files: list[AnyArtifact]) -> ElementTree.Element:
    (picture,) = render_placement_preview(files, FAB)
    assert (picture.role, picture.path) == ("placement-preview", "preview/tactape-s007-placements.svg")
    return ElementTree.fromstring(picture.data)


def changed(files: list[AnyArtifact], role: str, old: str, new: str) -> list[AnyArtifact]:
    def edited(data: bytes) -> bytes:
        text, count = re.subn(old, new, data.decode("ascii"), flags=re.MULTILINE)
        assert count
        return text.encode("ascii")

    return [replace(a, data=edited(a.data)) if isinstance(a, Artifact) and a.role == role else a for a in files]


def words(picture: ElementTree.Element) -> list[str]:
    return [str(text.text) for text in picture.iter(f"{_SVG}text")]


@pytest.mark.parametrize("house", ["jlcpcb", "macrofab", "kicad"])
def test_the_first_parts_are_named_with_their_rotation(house: str) -> None:
    said = words(drawn(artifacts(assembly=house)))
    assert said[0] == "R1" and "R2" in said and said[-1] == "45°"
    assert 9 <= len(said) <= 40


@pytest.mark.parametrize("turned", [False, True])
def test_three_or_four_parts_each_way_are_shown_of_a_turned_tape_too(turned: bool) -> None:
    made = examine(TapeSpec(sector=7, size_mm=(30.0, 20.0), models=False))
    drawing = joined([made.drawing], [((20.0, 0.0), turned)])
    parts = [text for text in words(drawn(render_all(drawing, made.fab))) if text.startswith("R")]
    columns = {(int(name[1:]) - 1) % made.tape.columns for name in parts}
    rows = {(int(name[1:]) - 1) // made.tape.columns for name in parts}
    assert min(len(columns), len(rows)) >= 3 and {0, 1, 2} <= columns and {0, 1, 2} <= rows


def test_a_turned_list_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    files = artifacts(fab="generic-fpc")
    wrong = changed(files, "cpl", r",45(?=\r?$)", ",135")
    assert words(drawn(wrong))[-1] == "135°"
    right, other = ([p.get("points") for p in drawn(of).iter(f"{_SVG}polygon")] for of in (files, wrong))
    assert right != other


def test_land_1_is_marked_once_for_each_part() -> None:
    picture = drawn(artifacts())
    parts = [text for text in words(picture) if text.startswith("R")]
    assert len(list(picture.iter(f"{_SVG}circle"))) == len(parts)
