"""Order at JLC, typed by a reader who does what the page and the notes say, into a form that reads what it is given.

The form is played by software that is not ours (gerbonara), and knows only the house's rules.
"""

from __future__ import annotations

import csv
import io
import json
import re
import shlex
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from gerbonara import GerberFile, LayerStack

from tactape_fab.cli import main
from tests.thorough import only_thorough

pytestmark = only_thorough
PAGE = Path(__file__).parents[2] / "docs" / "order-jlc.md"


def commands() -> list[list[str]]:
    """What the page says to type into a shell, in order."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]


@pytest.fixture(scope="module")
def ordered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which every command of the page was typed, each without a fault."""
    here = tmp_path_factory.mktemp("order")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        for words in commands():
            result = CliRunner().invoke(main, words, prog_name="tactape-fab")
            assert result.exit_code == 0, f"{shlex.join(words)}: {result.output}"
    return here / "jlc-order"


@pytest.fixture(scope="module")
def steps(ordered: Path) -> dict[int, str]:
    """The notes' steps by number."""
    text = next(ordered.glob("*-order-notes.txt")).read_text("utf-8").partition("\nAPPENDIX")[0]
    parts = re.split(r"^STEP (\d+)\. ", text, flags=re.MULTILINE)[1:]
    return {int(number): body for number, body in zip(parts[::2], parts[1::2], strict=True)}


def fields(step: str) -> dict[str, str]:
    """Rows of a step: the form's field, and what to type."""
    rows = re.findall(r"^   (\S.{0,32}?) {2,}(\S.*)$", step, re.MULTILINE)
    return {label.strip(): value for label, value in rows}


def test_the_page_and_the_notes_have_the_same_steps(steps: dict[int, str]) -> None:
    page = PAGE.read_text("utf-8")
    numbered = {int(n): body for n, body in re.findall(r"^(\d+)\. (.*?)(?=^\d+\. |^Keep)", page, re.MULTILINE | re.DOTALL)}
    assert sorted(numbered) == sorted(steps) == list(range(1, 11))
    for number, body in numbered.items():
        for label in re.findall(r"\*([A-Z][A-Za-z ]+)\*(?!\*)", body.replace("**", "")):
            said = steps[number] + (steps[2] + steps[3] if number in (2, 3) else "")
            assert label in said, f"the notes' step {number} has no field {label}"


def test_the_form_reads_the_board_as_it_was_typed(ordered: Path, steps: dict[int, str], tmp_path: Path) -> None:
    upload = ordered / fields(steps[1])["Add gerber file"]
    with zipfile.ZipFile(upload) as archive:
        assert all(not name.endswith((".txt", ".csv", ".pdf")) for name in archive.namelist())
        archive.extractall(tmp_path)
    stack = LayerStack.open(tmp_path)
    (x0, y0), (x1, y1) = stack.outline.bounding_box("mm")
    typed = fields(steps[2])
    width, height = map(float, re.findall(r"[\d.]+", typed["Dimensions"]))
    assert (x1 - x0, y1 - y0) == pytest.approx((width, height), abs=0.15)  # the outline's pen
    assert int(typed["Layers"]) == len([role for role in stack.graphic_layers if role[1] == "copper"]) == 1
    assert min(width, height) >= 70.0 and max(width, height) <= 250.0 and typed["Delivery Format"].startswith("Panel by Customer")
    manifest = json.loads((ordered / "manifest.json").read_bytes())
    assert int(typed["Different Design"]) == len({tape["sector"] for tape in manifest["tapes"]})


def test_the_form_matches_lists_parts_and_pads(ordered: Path, steps: dict[int, str]) -> None:
    uploads = fields(steps[6])
    bom = list(csv.DictReader(io.StringIO((ordered / uploads["Add BOM File"]).read_text("utf-8"))))
    cpl = list(csv.DictReader(io.StringIO((ordered / uploads["Add CPL File"]).read_text("utf-8"))))
    assert list(bom[0]) == ["Comment", "Designator", "Footprint", "JLCPCB Part #"]
    assert list(cpl[0]) == ["Designator", "Mid X", "Mid Y", "Layer", "Rotation"]
    groups = [row["Designator"].split(",") for row in bom]
    assert max(map(len, groups)) <= 200
    names = [name for group in groups for name in group]
    assert names == [row["Designator"] for row in cpl] and len(set(names)) == len(names)
    (number,) = {row["JLCPCB Part #"] for row in bom}
    assert re.fullmatch(r"C\d+", number) and number == fields(steps[7])["part number"] == fields(steps[5])["JLCPCB Part #"]
    assert re.search(r"as of \d{4}-\d\d-\d\d", steps[7])
    assert f"{len(names)} parts" in steps[6] and f"{len(names)} parts" in steps[8] and f"{len(names)} parts" in steps[9]
    copper = GerberFile.open(next(ordered.rglob("*.gtl")))
    flashed = np.array([(o.x, o.y) for o in copper.objects if type(o).__name__ == "Flash"])[: 2 * len(names)]
    centres = np.array([(float(row["Mid X"]), float(row["Mid Y"])) for row in cpl])
    np.testing.assert_allclose(flashed.reshape(-1, 2, 2).mean(axis=1), centres, atol=1e-4)
    first, last = re.findall(r"R\d+ at ([\d.]+), ([\d.]+) mm", steps[9].replace("and R", "\nR"))
    np.testing.assert_allclose(np.array([first, last], dtype=float), centres[[0, -1]], atol=6e-4)


def test_every_field_and_tick_is_that_of_the_files(ordered: Path, steps: dict[int, str]) -> None:
    """No row of the form is left without a file, or a page of the house, that says so."""
    manifest = json.loads((ordered / "manifest.json").read_bytes())
    paths = {row["role"]: row["path"] for row in manifest["files"]}
    job = json.loads((ordered / paths["job"]).read_bytes())
    layers = {layer["Type"]: layer for layer in job["MaterialStackup"]}
    panel, parts = manifest["panel"], sum(tape["parts"] for tape in manifest["tapes"])
    holes = re.findall(r"^X\S+Y\S+$", (ordered / paths["drill-npth"]).read_text(), re.MULTILINE)
    board = {
        "Base Material": {"polyimide": "Flex"}[layers["Dielectric"]["Material"]],
        "Layers": str(job["GeneralSpecs"]["LayerNumber"]),
        "Dimensions": "{:g} x {:g} mm".format(*panel["size_mm"]),
        "Different Design": str(len({tape["sector"] for tape in manifest["tapes"]})),
        "Delivery Format": f"Panel by Customer, {panel['columns']} x {panel['rows']} tapes",
        "PCB Thickness": f"{job['GeneralSpecs']['BoardThickness']} mm",
        "Coverlay Color": layers["SolderMask"]["Color"],
        "Silkscreen": layers["Legend"]["Color"],
        "Surface Finish": job["GeneralSpecs"]["Finish"],
        "Outer Copper Weight": {0.018: "1/2 oz", 0.035: "1 oz"}[layers["Copper"]["Thickness"]],
        "Stiffener": "Without" if "stiffener-bottom" not in paths else "With",
        "Adhesive Tape": "Without" if "adhesive-bottom" not in paths else "With",
        "Cutting Method": "Laser",  # slots of 2 mm and tabs of 1 mm; the house's page
        "Mark on PCB": "Remove Mark",
        "Confirm Production File": "Yes",
        "PCB Remark": "the text of step 3; prose in the zip is not read",
    }
    assembly = {
        "PCB Assembly": "yes, Standard (Economic takes no 0201)",
        "Assembly Side": "Top Side" if {row.split(",")[3] for row in _lines(ordered / paths["cpl"])} == {"Top"} else "Both Sides",
        "Tooling holes": "in the rails, as drawn" if len(holes) == len(panel["tooling_holes_mm"]) > 1 else "added",
        "Confirm Parts Placement": "Yes",
        "Comment in the BOM": manifest["assembly"]["value"],
        "JLCPCB Part #": manifest["assembly"]["part_number"],
    }
    assert fields(steps[1]) == {"Add gerber file": paths["fab-zip"]}
    assert fields(steps[2]) == board
    assert fields(steps[5]) == assembly
    assert {key: fields(steps[6])[key] for key in ("Add BOM File", "Add CPL File")} == {
        "Add BOM File": paths["bom"],
        "Add CPL File": paths["cpl"],
    }
    for count in (1, 5, 20):
        typed = fields(steps[7])[f"parts for {count} panel{'s' * (count > 1)}"]
        assert int(typed.partition(",")[0]) == -(-parts * count * 11 // 10)  # 10 % are lost by the line


def _lines(path: Path) -> list[str]:
    return path.read_text("utf-8").splitlines()[1:]


def test_previews_drawing_and_questions_are_there(ordered: Path, steps: dict[int, str]) -> None:
    for step, pattern in ((4, r"preview/\S+\.png"), (9, r"preview/\S+-placements\.svg"), (10, r"\S+-drawing\.pdf")):
        (path,) = re.findall(pattern, steps[step])
        assert (ordered / path).stat().st_size > 1000
    assert "bare board unknown" in steps[10] and re.search(r"assembly and parts USD [\d.]+ to [\d.]+", steps[10])
    assert "opening-bridge" in steps[10] and "?" in steps[10]


def test_what_was_confirmed_was_used(ordered: Path) -> None:
    manifest = json.loads((ordered.parent / "confirmed-order" / "manifest.json").read_bytes())
    assert manifest["fab"]["limits_mm"]["opening-bridge"] == 0.35
    before = json.loads((ordered / "manifest.json").read_bytes())
    assert manifest["spec"]["pitch_mm"] < before["spec"]["pitch_mm"]
