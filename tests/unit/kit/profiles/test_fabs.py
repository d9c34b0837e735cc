"""Fab profiles that a user wrote: names of files, and rails of panels."""

from __future__ import annotations

from pathlib import Path

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.kit.profiles import load_fab, read_part, templates_folder


def profile(folder: Path, files: str) -> str:
    place = folder / "mine.toml"
    place.write_text(f'extends = "generic-fpc"\n[files]\n{files}\n')
    return str(place)


@pytest.mark.parametrize("name", ["top_{name}.art", "{name}.art", "{name}-top.art", "L1.art", "1-{name}_F.Cu.gbr"])
def test_the_tape_s_name_stands_where_the_fab_wants_it(name: str, tmp_path: Path) -> None:
    fab = load_fab(profile(tmp_path, f'copper-top = "{name}"'))
    assert fab.file_path("copper-top", "t7") == f"gerber/{name.replace('{name}', 't7')}"


@pytest.mark.parametrize(
    "name", ["{name}", ".{name}.art", "{name}{name}.art", "a/{name}.art", "{name}.ü", "-" * 31 + "{name}.art", ""]
)
def test_other_names_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(
        SpecError, match=r"files\.copper-top = .*give a file name of letters and digits, with \{name\} for the tape's"
    ):
        load_fab(profile(tmp_path, f'copper-top = "{name}"'))


def test_material_and_thickness_stand_in_the_names_of_backings(tmp_path: Path) -> None:
    fab = load_fab(profile(tmp_path, 'stiffener-bottom = "under_{name}_{material}.art"'))
    assert fab.file_names["stiffener-bottom"] == "under_{name}_{material}.art"


def test_rails_are_as_wide_as_their_marks_ask_for(tmp_path: Path) -> None:
    def rails(rules: str) -> float:
        place = tmp_path / "rails.toml"
        place.write_text(f'extends = "generic-fpc"\n[panel]\n{rules}\n')
        return load_fab(str(place)).panel.rail_mm

    with pytest.raises(SpecError, match=r"panel\.rail_mm = 2\.5 mm has no room for marks and holes of 2 mm; give 3 or more"):
        rails("rail_mm = 2.5")
    assert rails("rail_mm = 1.5\nfiducials = 0\ntooling_holes = 0") == 1.5
    assert rails("rail_mm = 2.2\nfiducials = 0\ntooling_hole_mm = 1.2") == 2.2


@pytest.mark.parametrize("height", [0.0, -0.0, 5e-324, 0.09])
def test_capitals_have_a_height(height: float, tmp_path: Path) -> None:
    """With none, a strip has no end of lines: a division by zero in `check` and `verify`."""
    path = tmp_path / "a.toml"
    path.write_text(f'extends = "generic-fpc"\nname = "a"\n[legend]\ntext_mm = {height!r}\n', encoding="utf-8")
    with pytest.raises(SpecError, match=r"legend\.text_mm = .* is below 0\.1 mm"):
        load_fab(str(path))


@pytest.mark.parametrize("size", [1e-300, 0.009])
def test_a_courtyard_has_an_area(size: float, tmp_path: Path) -> None:
    """That of a line has no gaps."""
    text = (templates_folder() / "parts" / "r0201.toml").read_text(encoding="utf-8")
    head, _, rest = text.partition("[courtyard]\nsize_mm = [")
    (tmp_path / "a.toml").write_text(f"{head}[courtyard]\nsize_mm = [{size}, {rest.partition(',')[2]}", encoding="utf-8")
    with pytest.raises(SpecError, match=r"courtyard\.size_mm\[0\] = .* is below 0\.01 mm"):
        read_part(str(tmp_path / "a.toml"))


@pytest.mark.parametrize("land", ["pads", "paste"])
@pytest.mark.parametrize("size", [5e-324, 1e-9, 0.009])
def test_lands_have_an_area(land: str, size: float, tmp_path: Path) -> None:
    """Pads of none ended `make` in a traceback, apertures of paste in an error that did not name the key."""
    text = (templates_folder() / "parts" / "r0201.toml").read_text(encoding="utf-8")
    head, _, rest = text.partition(f"[{land}]")
    before, _, after = rest.partition("size_mm = [")
    changed = f"{head}[{land}]{before}size_mm = [{size!r}, {after.partition(',')[2]}"
    (tmp_path / "a.toml").write_text(changed, encoding="utf-8")
    with pytest.raises(SpecError, match=rf"{land}\.size_mm\[0\] = .* is below 0\.01 mm"):
        read_part(str(tmp_path / "a.toml"))


@pytest.mark.parametrize("key", ["parts", "least"])
def test_a_reel_holds_a_part(key: str, tmp_path: Path) -> None:
    """With none, the order notes divided by zero."""
    path = tmp_path / "a.toml"
    path.write_text(f'extends = "generic-fpc"\n[order.reel]\n{key} = 0.5\n', encoding="utf-8")
    with pytest.raises(SpecError, match=rf"order\.reel\.{key} = 0\.5 is below 1"):
        load_fab(str(path))


@pytest.mark.parametrize(("key", "least"), [("tab_pitch_mm", "1"), *((key, r"0\.1") for key in ("tab_mm", "gap_mm", "rail_mm"))])
@pytest.mark.parametrize("length", [5e-324, 1e-9, 0.09])
def test_tabs_and_slots_have_a_length(key: str, least: str, length: float, tmp_path: Path) -> None:
    """`make` laid out millions of tabs, without end, or wrote a panel whose outline its own check refused."""
    path = tmp_path / "a.toml"
    path.write_text(f'extends = "generic-fpc"\n[panel]\n{key} = {length!r}\n', encoding="utf-8")
    with pytest.raises(SpecError, match=rf"panel\.{key} = .* is below {least} mm; give a number from {least} to 100 mm"):
        load_fab(str(path))


@pytest.mark.parametrize(("table", "key", "least"), [("material", "thickness_mm", r"0\.001"), ("legend", "line_mm", r"0\.01")])
@pytest.mark.parametrize("length", [0.0, 5e-324, 1e-9])
def test_board_and_lines_have_a_thickness(table: str, key: str, least: str, length: float, tmp_path: Path) -> None:
    """`make` wrote a STEP file with NaN into a kit that passed, and a legend that no Gerber reader takes."""
    path = tmp_path / "a.toml"
    path.write_text(f'extends = "generic-fpc"\n[{table}]\n{key} = {length!r}\n', encoding="utf-8")
    with pytest.raises(SpecError, match=rf"{table}\.{key} = .* is below {least} mm"):
        load_fab(str(path))
