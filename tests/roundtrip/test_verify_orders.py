"""What an assembly line gets, in every house's format, is verified with the whole kit: one change at a time, hashes fitted."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import OpenKit, failed

Copy = Callable[[Kit], Path]
Edit = Callable[[OpenKit], object]
NUMBERS = {"jlcpcb": "C1000"}


@pytest.fixture(scope="module")
def kits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kit]:
    """A small kit in each format; not to be changed."""
    folder = tmp_path_factory.mktemp("houses")
    return {
        house: make_kit(
            TapeSpec(sector=100, size_mm=(20.0, 20.0), models=False, assembly=house, part_number=NUMBERS.get(house, "RC0201-5")),
            folder / house,
        )
        for house in ASSEMBLY_FORMATS
    }


@pytest.mark.parametrize("house", ASSEMBLY_FORMATS)
def test_every_format_passes_and_the_manifest_says_which_it_is(house: str, kits: dict[str, Kit]) -> None:
    assert verify_kit(kits[house].path, quick=True).passed
    manifest = OpenKit(kits[house].path).manifest
    assert manifest["assembly"] == {
        "format": house,
        "value": "0R",
        "footprint": "R_0201_0603Metric",
        "description": "chip resistor 0201 (0603 metric), any value, body height 0.23 mm",
        "part_number": NUMBERS.get(house, "RC0201-5"),
    }
    assert manifest["spec"]["assembly"] == house


def text(role: str, old: str, new: str, count: int = 0) -> Edit:
    def edit(kit: OpenKit) -> None:
        before = kit.data[role].decode("utf-8")
        after = re.sub(old, new, before, count=count)
        assert after != before
        kit.data[role] = after.encode("utf-8")

    return edit


def record(key: str, value: Any) -> Edit:
    return lambda kit: kit.manifest["assembly"].__setitem__(key, value)


def forget(kit: OpenKit) -> None:
    del kit.manifest["assembly"]


CHANGES: list[tuple[str, Edit, tuple[str, ...], str]] = [
    ("macrofab", text("cpl", r"\t315\t", "\t45\t"), ("cpl rotation",), "at -45 deg"),
    ("macrofab", text("cpl", r"\t315\t", "\t405\t", 1), ("cpl",), "405"),
    ("macrofab", text("cpl", r"\nR1\t", r"\nR1\t1"), ("cpl places",), "1 rows are off the manifest's grid: R1 by"),
    ("macrofab", text("cpl", "R_0201_0603Metric", "R_0603", 1), ("cpl rows",), "footprint of 1 rows"),
    ("macrofab", text("cpl", r"\t1\tRC0201-5", "\t0\tRC0201-5", 1), ("cpl rows",), "populate of 1 rows is not '1': R1 '0'"),
    ("macrofab", text("cpl", "RC0201-5", "RC0201-6"), ("cpl rows",), "part_number of 96 rows is not 'RC0201-5'"),
    ("macrofab", text("cpl", "43.3071", "43.3"), ("cpl rows",), "length of 96 rows"),
    ("macrofab", text("cpl", "#Designator", "Designator"), ("cpl",), "has no column Designator"),
    ("kicad", text("cpl", " 45.0000", "-45.0000"), ("cpl rotation",), "at -45 deg"),
    ("kicad", text("cpl", "## End\n", ""), ("cpl",), "## End"),
    ("kicad", text("cpl", "= mm", "= inches"), ("cpl",), "not in millimetres"),
    ("kicad", text("cpl", "## Unit", "## Unit = inches, Angle = deg.\n## Unit"), ("cpl",), "not KiCad's of a top side in mm"),
    ("kicad", text("cpl", "Side : top", "Side : bottom"), ("cpl",), "not KiCad's of a top side in mm"),
    ("kicad", text("cpl", "\nR2 ", "\n# Ref Val Package PosY PosX Rot Side\nR2 "), ("cpl",), "each once"),
    ("kicad", text("cpl", "top\nR2 ", "top\fR2 "), ("cpl",), "its lines end otherwise"),
    ("kicad", text("cpl", "  top\n", "  bottom\n", 1), ("cpl rows",), "1 rows are not on layer Top"),
    ("kicad", text("cpl", "R_0201_0603Metric", "R_0402_1005Metric", 1), ("cpl rows",), "footprint of 1 rows"),
    ("eurocircuits", text("cpl", r"X \(mm\)", "X (inch)"), ("cpl",), "has no column X (mm)"),
    ("eurocircuits", text("cpl", r"(R2,\S+?),45,", r"\1,135,"), ("cpl rotation",), "R2 at 135 deg"),
    ("eurocircuits", text("bom", "RC0201-5", "RC0201-6"), ("bom",), "part_number of row 1 is 'RC0201-6', not 'RC0201-5'"),
    ("pcbway", text("bom", ",96,,", ",95,,"), ("bom",), "quantity of row 1 is '95', not '96'"),
    ("pcbway", text("bom", "\n1,", "\n2,"), ("bom",), "item of row 1 is '2', not '1'"),
    ("pcbway", text("bom", ",SMD,", ",THT,"), ("bom",), "type of row 1 is 'THT'"),
    ("pcbway", text("bom", '"0R, chip', '"1R, chip'), ("bom",), "value_description of row 1"),
    ("jlcpcb", text("bom", "C1000", "C1001"), ("bom",), "part_number of row 1"),
    ("generic", text("bom", "R_0201_0603Metric", "R_0603"), ("bom",), "footprint of row 1 is 'R_0603'"),
    ("generic", text("bom", "0R", "=1+1"), ("bom",), "value of row 1"),
    ("generic", text("order-notes", "96 parts", "97 parts"), ("order-notes",), "they lack '96 parts'"),
    ("generic", record("footprint", "R_0402_1005Metric"), ("bom",), "not 'R_0402_1005Metric'"),
    ("generic", record("part_number", None), ("bom",), "is 'RC0201-5', not ''"),
    ("generic", record("format", "jlcpcb"), ("bom",), "'Comment', 'JLCPCB Part #' is missing"),
    ("generic", record("format", "macrofab"), ("cpl rows",), "it is no list of format 'macrofab'"),
    ("generic", record("format", "acme"), ("manifest",), "assembly.format = 'acme' is none of"),
    ("generic", record("value", 5), ("manifest",), "assembly.value = 5 is not a text"),
    ("generic", forget, ("manifest",), "assembly is missing"),
]


@pytest.mark.parametrize(("house", "edit", "fails", "says"), CHANGES, ids=[f"{c[0]}-{i}" for i, c in enumerate(CHANGES)])
def test_a_change_is_caught(
    house: str, edit: Edit, fails: tuple[str, ...], says: str, kits: dict[str, Kit], tmp_path: Path
) -> None:
    kit = OpenKit(Path(shutil.copytree(kits[house].path, tmp_path / house)))
    edit(kit)
    lines = failed(verify_kit(kit.save(consistent=True), quick=True))
    assert set(fails) <= set(lines)
    assert says in lines[fails[0]].message
    assert not {"files", "roles", "fab-zip"} & set(lines)
