"""Figures in the prose of order notes that somebody acts on: the field to keep clear, the board's size, the last part's place."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tactape_fab import Kit, PanelKit, TapeSpec, make_kit
from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.base.templates import templates_folder
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.verify import verify_kit
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.film import read_film_manifest
from tactape_fab.verify.layers.order_notes import _length, check_order_notes
from tests.roundtrip.kits import OpenKit, failed


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=7, size_mm=(30, 25), models=False, stiffener="FR4 0.2", adhesive="3M468 0.13")
    return make_kit(spec, tmp_path_factory.mktemp("notes") / "kit", verify=False)


def checked(kit: Kit, pattern: str, new: str) -> Check:
    manifest = read_manifest(kit.path / "manifest.json")
    files = {row["role"]: WrittenFile(path=row["path"], data=(kit.path / row["path"]).read_bytes()) for row in manifest["files"]}
    text, count = re.subn(pattern, new, files["order-notes"].data.decode())
    assert count
    files["order-notes"] = WrittenFile(path=files["order-notes"].path, data=text.encode())
    film = read_film_manifest(Fields(manifest))
    return check_order_notes(files, kit.tape, film=film)


@pytest.mark.parametrize(
    ("pattern", "new", "said"),
    [
        (r"field of parts, x 6\.0 to", "field of parts, x 16.0 to", "they protect x 16 to 28.8 mm, y 1.1 to 23.9 mm"),
        (r"(field of parts, .* y) 1\.1 to", r"\1 2.1 to", "and parts lie beyond it"),
        (r"(field of parts, .* to) 23\.9", r"\1 13.9", "and parts lie beyond it"),
        (
            r"(strip at .* to) 5\.5 mm",
            r"\1 6.7 mm",
            "print at x 0.5 to 6.7 mm, y 17.9 to 20.5 mm, on parts, ink or holes, or off",
        ),
        (r"(strip at .* y) 17\.9", r"\1 16.9", "print at x 0.5 to 5.5 mm, y 16.9 to 20.5 mm, on parts, ink"),
        (r"(strip at .* to) 20\.5 mm", r"\1 24.0 mm", "print at x 0.5 to 5.5 mm, y 17.9 to 24 mm, on parts, ink"),
        (r"(strip at .* x) 0\.5", r"\1 -0.1", "print at x -0.1 to 5.5 mm, y 17.9 to 20.5 mm, on parts, ink"),
        (r"only in the strip", "anywhere in the strip", "they do not say where the fab may print"),
        (r"(parts for 5 tapes +)1238", r"\g<1>1124", "they say 1124 parts for 5 boards of 225"),
        (r"$", 100_000 * " ", "they are longer than 100000 bytes"),
        (r"one board of 30 x 25", "one board of 30 x 52", "they say 30, 52 where 30, 25 should stand"),
        (r"board alone \(30 x", "board alone (300 x", "they say 300, 25 where 30, 25 should stand"),
        (r"and R225 at 28\.15", "and R225 at 2.15", "they say 225, 2.15, 2 where 225, 28.15, 2 should stand"),
        (r"and R225 at", "and R226 at", "they say 226, 28.15, 2 where 225, 28.15, 2 should stand"),
        (r"opening of 1\.2 x", "opening of 1.5 x", "they say 1.5, 0.5 where 1.2, 0.5 should stand"),
        (r"Stiffener FR4 0\.2 mm", "Stiffener FR4 0.5 mm", "they say Stiffener FR4 0.5 mm by gerber/"),
        (r"   Stiffener .*\n", "", "they say nothing of the underside, where Stiffener FR4 0.2 mm by gerber/"),
        (r"_3M468_0\.13mm\.gbr has", "_3M468_0.2mm.gbr has", "mm.gbr, which is not in the kit"),
        (r"height 0\.23 mm; no", "height 0.5 mm; no", "body height 0.5 mm, no part number is given where"),
        (r"(least spacing of copper +)0\.18", r"\1 0.48", "is '0.48 mm', more than between the lands of a part"),
        (r"(stencil +)0\.1 mm", r"\1 0.4 mm", "'stencil' is '0.4 mm', which is not the manifest's"),
        (r"(   electrical test .*\n)", r"\1   Mark on PCB  Order Number\n", "'Mark on PCB' is 'Order Number', which"),
        (r"(legend +)white, top", r"\1none", "'legend' is 'none', which is not the manifest's"),
        (r"(panel +)by the fab.*", r"\1as drawn, 2 x 2 tapes", "'panel' is 'as drawn, 2 x 2 tapes', which"),
        *((rf"   {row} .*\n", "", f"they do not say the {row}") for row in ("copper", "coverlay", "stiffener", "adhesive")),
    ],
)
def test_figures_that_somebody_acts_on_are_the_tape_s(kit: Kit, pattern: str, new: str, said: str) -> None:
    line = checked(kit, pattern, new)
    assert not line.passed and said in line.message


def test_notes_without_such_sentences_and_as_written_pass(kit: Kit) -> None:
    assert checked(kit, "ORDER NOTES", "ORDER NOTES").passed
    assert checked(kit, r"(parts for 5 tapes +)1238", r"\g<1>1125").passed
    assert checked(kit, r", x 6\.0 to .* mm:", ":").passed  # as of an older version


def test_figures_of_a_panel_are_compared_too(panel_2: PanelKit, tmp_path: Path) -> None:
    kit = OpenKit(Path(shutil.copytree(panel_2.path, tmp_path / "panel")))
    changes = {
        "turned 45 deg": "turned 90 deg",
        "like this: /": "like this: -",
        "rails of 5": "rails of 7",
        "slots of 2": "slots of 3",
    }
    for old, new in {**changes, "tabs of 1": "tabs of 3", "R1 at ": "R1 at 1", "as drawn, 1": "as drawn, 3"}.items():
        assert old in kit.data["order-notes"].decode()
        kit.data["order-notes"] = kit.data["order-notes"].replace(old.encode(), new.encode())
    said = failed(verify_kit(kit.save(consistent=True), quick=True))["order-notes"].message
    wrong = (
        "'turned 45 deg'",
        "they say - where /",
        "'in rails of 5 mm'",
        "'slots of 2 mm'",
        "'tabs of 1 mm'",
        "'R1 at",
        "'panel' is",
    )
    assert [words for words in wrong if words not in said] == []


def test_half_a_micrometre_is_rounded_alike_however_it_was_reckoned() -> None:
    assert _length(0.1 + 9.1145) == _length(9.2145) == _length(9.2145 + 2e-15)
    assert _length(9.2145 - 4e-15) == _length(9.2145 + 4e-15)


@pytest.mark.parametrize("name", ["merge", "x-align.b"])
def test_names_may_be_words_that_no_sentence_may_have(name: str, tmp_path: Path) -> None:
    fab, part = tmp_path / "align.toml", tmp_path / "merge.toml"
    fab.write_text('extends = "generic-fpc"\nname = "align"\ntitle = "Merge & Align"\n', encoding="utf-8")
    shipped = (templates_folder() / "parts" / "r0201.toml").read_text(encoding="utf-8")
    part.write_text(re.sub(r'(?m)^((?:description|footprint|value) = ").*"', r'\1do align"', shipped), encoding="utf-8")
    spec = TapeSpec(sector=7, size_mm=(30, 25), models=False, name=name, fab=str(fab), part=str(part), pitch_mm=1.0)
    kit = make_kit(spec, tmp_path / "kit", verify=False, force=True)
    assert checked(kit, "ORDER NOTES", "ORDER NOTES").passed
    assert "they say 'merge' without" in checked(kit, "\n\nSTEP 1. ", r"\n   You may merge openings.\g<0>").message
    assert "they say 'align' without" in checked(kit, "Do not align", "Do align").message
