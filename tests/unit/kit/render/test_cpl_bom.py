"""CPL and BOM of each assembly house, read by nothing but the csv module and the columns as they stand here in letters."""

from __future__ import annotations

import csv
import io
import re
from functools import cache

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.base.errors import Check
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.profiles.chips import chip_code_problem
from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.kit.render.cpl_bom import render_bom, render_cpl
from tactape_fab.kit.render.gerber import render_copper
from tactape_fab.kit.writer import render_all
from tactape_fab.sense import parts_from_cpl
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly, check_bom, check_cpl

COMMON = ["Designator", "Mid X", "Mid Y", "Layer", "Rotation"]
CPL_HEADERS = {
    "generic": COMMON,
    "jlcpcb": COMMON,
    "pcbway": COMMON,
    "eurocircuits": ["Reference designator", "X (mm)", "Y (mm)", "Rotation", "Side"],
    "macrofab": [
        *("#Designator", "X-Loc", "Y-Loc", "Rotation", "Side", "Type"),
        *("X-Size", "Y-Size", "Value", "Footprint", "Populate", "MPN"),
    ],
    "kicad": ["Ref", "Val", "Package", "PosX", "PosY", "Rot", "Side"],
}
GENERIC_BOM = ["Designator", "Quantity", "Value", "Footprint", "Description", "Part Number"]
BOM_HEADERS = {
    "generic": GENERIC_BOM,
    "jlcpcb": ["Comment", "Designator", "Footprint", "JLCPCB Part #"],
    "pcbway": [
        *("Item #", "Designator", "Qty", "Manufacturer", "Mfg Part #", "Description / Value", "Footprint", "Type"),
        "Your Instructions / Notes",
    ],
    "eurocircuits": ["Reference designator", "Quantity", "MPN", "Value", "Package", "Description"],
    "macrofab": GENERIC_BOM,
    "kicad": GENERIC_BOM,
}
PATHS = {"macrofab": "assembly/t.xyrs", "kicad": "assembly/t-top.pos"}
NUMBERS = {"jlcpcb": "C1234567890"}
DESCRIPTION = "chip resistor 0201 (0603 metric), any value, body height 0.23 mm"
FOOTPRINT = "R_0201_0603Metric"
EVERY = pytest.mark.parametrize("house", ASSEMBLY_FORMATS)


@cache
def examined(house: str, rotation_deg: float = 45.0, number: bool = True) -> Examined:
    """A tape of 15 x 15 grid points with two BOM rows."""
    return examine(
        TapeSpec(
            sector=9,
            size_mm=(26.0, 26.0),
            tag="none",
            name="t",
            models=False,
            assembly=house,
            rotation_deg=rotation_deg,
            part_number=NUMBERS.get(house, "ABC-0201/5+#7") if number else None,
            pitch_mm=1.6,
            displacement_mm=0.1,
        )
    )


def cpl_of(house: str, rotation_deg: float = 45.0, number: bool = True) -> bytes:
    made = examined(house, rotation_deg, number)
    (artifact,) = render_cpl(made.drawing, made.fab)
    assert artifact.role == "cpl"
    assert artifact.path == PATHS.get(house, "assembly/t-cpl.csv")
    return artifact.data


def bom_of(house: str, number: bool = True) -> bytes:
    made = examined(house, number=number)
    (artifact,) = render_bom(made.drawing, made.fab)
    assert (artifact.role, artifact.path) == ("bom", "assembly/t-bom.csv")
    return artifact.data


def cpl_rows(house: str, data: bytes) -> list[dict[str, str]]:
    """Rows by column, as a reader has them that knows the house's columns and nothing of this package."""
    text = data.decode("ascii")
    if house == "kicad":
        lines = text.split("\n")
        assert re.fullmatch(r"### Footprint positions - created on .+ ###", lines[0])
        assert lines[2:4] == ["## Unit = mm, Angle = deg.", "## Side : top"]
        assert lines[4].removeprefix("# ").split() == CPL_HEADERS[house]
        assert lines[-2:] == ["## End", ""]
        widths = (8, 8, len(FOOTPRINT))
        row = re.compile(r"(R\d+) +(\S+) +(\S+) +(-?\d+\.\d{4}) +(-?\d+\.\d{4}) +(-?\d+\.\d{4})  (top)")
        for line in lines[5:-2]:
            cells = row.fullmatch(line)
            assert cells is not None, line
            starts = [cells.start(i) for i in (1, 2, 3)]
            assert starts == [0, widths[0] + 2, widths[0] + widths[1] + 4]
            ends = sum(widths) + 4 + 11, sum(widths) + 4 + 22, sum(widths) + 4 + 32 + max(len(cells[6]) - 8, 0)
            assert (cells.end(4), cells.end(5), cells.end(6)) == ends
        return [dict(zip(CPL_HEADERS[house], line.split(), strict=True)) for line in lines[5:-2]]
    assert text.endswith("\r\n") and text.count("\r\n") == text.count("\n")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter="\t" if house == "macrofab" else ",", strict=True)
    header, *rows = reader
    assert header == CPL_HEADERS[house]
    return [dict(zip(header, row, strict=True)) for row in rows]


def bom_rows(house: str, data: bytes) -> list[dict[str, str]]:
    header, *rows = csv.reader(io.StringIO(data.decode("ascii"), newline=""), strict=True)
    assert header == BOM_HEADERS[house]
    return [dict(zip(header, row, strict=True)) for row in rows]


def test_every_format_is_tested_here() -> None:
    assert set(ASSEMBLY_FORMATS) == set(CPL_HEADERS) == set(BOM_HEADERS)


# Pick-and-place


@EVERY
def test_every_row_of_a_cpl_is_a_part_at_its_place(house: str) -> None:
    rows = cpl_rows(house, cpl_of(house))
    tape = examined(house).tape
    name, x, y = {
        "eurocircuits": ("Reference designator", "X (mm)", "Y (mm)"),
        "macrofab": ("#Designator", "X-Loc", "Y-Loc"),
        "kicad": ("Ref", "PosX", "PosY"),
    }.get(house, ("Designator", "Mid X", "Mid Y"))
    unit_mm = 0.0254 if house == "macrofab" else 1.0
    assert [row[name] for row in rows] == [f"R{i + 1}" for i in range(tape.part_count)]
    found = np.array([(float(row[x]), float(row[y])) for row in rows]) * unit_mm
    assert np.abs(found - tape.part_xy_mm()).max() < 5.1e-5 * unit_mm


@pytest.mark.parametrize(
    ("rotation_deg", "common", "macrofab", "kicad"),
    [
        (45.0, "45", "315", "45.0000"),
        (0.0, "0", "0", "0.0000"),
        (90.0, "90", "270", "90.0000"),
        (135.0, "135", "225", "135.0000"),
        (180.0, "180", "180", "180.0000"),
        (225.0, "225", "135", "-135.0000"),
        (315.0, "315", "45", "-45.0000"),
        (44.5, "44.5", "315.5", "44.5000"),
        (359.99999, "0", "0", "0.0000"),
    ],
)
def test_a_part_is_turned_as_each_house_counts(rotation_deg: float, common: str, macrofab: str, kicad: str) -> None:
    """Counter-clockwise seen from above, 0 along x; MacroFab counts clockwise, KiCad in half turns."""
    for house in ASSEMBLY_FORMATS:
        rows = cpl_rows(house, cpl_of(house, rotation_deg))
        found = {row.get("Rotation", row.get("Rot")) for row in rows}
        assert found == {{"macrofab": macrofab, "kicad": kicad}.get(house, common)}, house
        assert np.allclose((read_cpl(cpl_of(house, rotation_deg)).rotation_deg - rotation_deg + 180) % 360, 180, atol=1e-4)


def test_macrofab_s_rows_hold_the_part_and_its_size_over_the_lands() -> None:
    row = cpl_rows("macrofab", cpl_of("macrofab"))[0]
    assert {key: row[key] for key in ("Side", "Type", "Populate", "Value", "Footprint", "MPN")} == {
        **{"Side": "1", "Type": "1", "Populate": "1"},
        **{"Value": "0R", "Footprint": FOOTPRINT, "MPN": "ABC-0201/5+#7"},
    }
    assert (float(row["X-Size"]) * 0.0254, float(row["Y-Size"]) * 0.0254) == pytest.approx((1.10, 0.40), abs=2e-6)


@EVERY
def test_sides_are_the_house_s_word_for_the_top(house: str) -> None:
    sides = {row.get("Layer", row.get("Side")) for row in cpl_rows(house, cpl_of(house))}
    assert sides == {{"macrofab": "1", "kicad": "top"}.get(house, "Top")}


# Bill of materials


@EVERY
def test_a_bom_names_every_part_once_and_nothing_else(house: str) -> None:
    rows = bom_rows(house, bom_of(house))
    column = "Reference designator" if house == "eurocircuits" else "Designator"
    groups = [row[column].split(",") for row in rows]
    names = [name for group in groups for name in group]
    copper, *_ = render_copper(examined(house).drawing, examined(house).fab)
    in_copper = set(re.findall(r"TO\.P,([^,]+),", copper.data.decode("ascii")))
    assert len(names) == len(set(names)) == examined(house).tape.part_count > 200
    assert set(names) == in_copper
    assert all(re.fullmatch(r"R[1-9]\d*", name) for name in names)
    assert [len(group) for group in groups] == [200, len(names) - 200]
    quantity = {"jlcpcb": None, "pcbway": "Qty"}.get(house, "Quantity")
    if quantity is not None:
        assert [row[quantity] for row in rows] == [str(len(group)) for group in groups]


@EVERY
def test_a_bom_says_what_part_it_is(house: str) -> None:
    for number, row in enumerate(bom_rows(house, bom_of(house)), start=1):
        said = {
            "jlcpcb": {"Comment": "0R", "Footprint": FOOTPRINT, "JLCPCB Part #": "C1234567890"},
            "pcbway": {
                **{"Item #": str(number), "Manufacturer": "", "Mfg Part #": "ABC-0201/5+#7", "Type": "SMD"},
                **{"Description / Value": f"0R, {DESCRIPTION}", "Footprint": FOOTPRINT, "Your Instructions / Notes": ""},
            },
            "eurocircuits": {"MPN": "ABC-0201/5+#7", "Value": "0R", "Package": FOOTPRINT, "Description": DESCRIPTION},
        }.get(
            house,
            {"Value": "0R", "Footprint": FOOTPRINT, "Description": DESCRIPTION, "Part Number": "ABC-0201/5+#7"},
        )
        assert said.items() <= row.items()


@EVERY
def test_no_part_number_is_invented(house: str) -> None:
    column = {"jlcpcb": "JLCPCB Part #", "pcbway": "Mfg Part #", "eurocircuits": "MPN"}.get(house, "Part Number")
    assert {row[column] for row in bom_rows(house, bom_of(house, number=False))} == {""}
    if house == "macrofab":
        assert {row["MPN"] for row in cpl_rows(house, cpl_of(house, number=False))} == {""}


@EVERY
def test_no_cell_calls_the_part_0603_alone(house: str) -> None:
    rows = [*bom_rows(house, bom_of(house)), *cpl_rows(house, cpl_of(house))]
    for cell in (cell for row in rows for column, cell in row.items() if "esignator" not in column):
        if "0603" in cell:
            assert "0201" in cell and re.search(r"0603 ?metric", cell, re.IGNORECASE), cell


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("R_0201_0603Metric", None),
        ("chip resistor 0201 (0603 metric), any value", None),
        ("0603M", None),
        ("0201", None),
        ("R0201", None),
        ("4700R", None),
        ("value 12060, 0.0603", None),
        ("R_0603", "1.6 x 0.8 mm (0603 in inches), but the body is 0.6 x 0.3 mm; write 0201"),
        ("chip 0603", "write 0201"),
        ("0402_1005Metric", "1 x 0.5 mm (0402 in inches)"),
        ("0201Metric", "0.25 x 0.125 mm (0201 metric)"),
        ("R_0201_0402metric", "0.4 x 0.2 mm (0402 metric)"),
    ],
)
def test_a_size_code_must_be_the_body_s(text: str, says: str | None) -> None:
    problem = chip_code_problem(text, (0.6, 0.3, 0.23))
    assert problem is None if says is None else problem is not None and says in problem


# Read back


def recorded(house: str) -> RecordedAssembly:
    number = NUMBERS.get(house, "ABC-0201/5+#7")
    return RecordedAssembly(format=house, value="0R", footprint=FOOTPRINT, description=DESCRIPTION, part_number=number)


def cpl_checks(house: str, data: bytes) -> dict[str, Check]:
    made = examined(house)
    return {c.name: c for c in check_cpl(read_cpl(data), made.tape, recorded(house), made.layout.part.pads)}


@EVERY
def test_verify_accepts_what_was_written(house: str) -> None:
    assert all(check.passed for check in cpl_checks(house, cpl_of(house)).values())
    assert check_bom(bom_of(house), examined(house).tape.designators(), recorded(house)).passed
    parts = parts_from_cpl(cpl_of(house))
    assert parts.xy_mm == pytest.approx(examined(house).tape.part_xy_mm(), abs=5.1e-5)
    assert parts.rotation_deg % 360 == pytest.approx(45.0)


def changed(data: bytes, old: bytes, new: bytes) -> bytes:
    assert old in data
    return data.replace(old, new, 1)


@EVERY
def test_every_word_of_a_bom_is_compared(house: str) -> None:
    data, tape = bom_of(house), examined(house).tape
    header, first, second = list(csv.reader(io.StringIO(data.decode("ascii"), newline="")))
    for column, name in enumerate(header):
        for cell in ("X", "=1+1", "" if second[column] else " "):
            rows = [header, first, [cell if i == column else old for i, old in enumerate(second)]]
            text = io.StringIO(newline="")
            csv.writer(text, lineterminator="\r\n").writerows(rows)
            check = check_bom(text.getvalue().encode("ascii"), tape.designators(), recorded(house))
            assert not check.passed, f"{name} = {cell!r}"
        renamed = changed(data, name.encode(), b"Refs")
        assert "column" in check_bom(renamed, tape.designators(), recorded(house)).message


@EVERY
def test_every_word_of_a_cpl_is_compared(house: str) -> None:
    data = cpl_of(house)
    separator = {"macrofab": "\t", "kicad": None}.get(house, ",")
    lines = data.decode("ascii").splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("R5" + (separator or " ")))
    cells = lines[at].split(separator)
    for column in range(len(cells)):
        for cell in ("999", "X"):
            row = (separator or "  ").join(cell if i == column else old for i, old in enumerate(cells))
            text = "\r\n".join([*lines[:at], row, *lines[at + 1 :], ""]).encode("ascii")
            try:
                passed = all(check.passed for check in cpl_checks(house, text).values())
            except ReadbackError as error:
                passed = not str(error)
            assert not passed, f"column {column} = {cell!r}"


@pytest.mark.parametrize("house", [h for h in ASSEMBLY_FORMATS if CPL_HEADERS[h] != COMMON])
def test_a_list_of_another_house_is_named(house: str) -> None:
    made = examined("generic")
    checks = check_cpl(read_cpl(cpl_of(house)), made.tape, recorded("generic"), made.layout.part.pads)
    assert "is no list of format 'generic'" in checks[0].message


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"## Unit = mm", b"## Unit = inches", "not in millimetres"),
        (b"## End\n", b"", "## End"),
        (b"# Ref ", b"# Rex ", "no column Ref;"),
        (b"R4 ", b"", "line 9: it has 6 cells"),
    ],
)
def test_a_damaged_kicad_list_is_refused(old: bytes, new: bytes, says: str) -> None:
    with pytest.raises(ReadbackError, match=re.escape(says)):
        read_cpl(changed(cpl_of("kicad"), old, new))


def test_simulated_parts_of_another_list_name_its_line() -> None:
    with pytest.raises(ValueError, match="line 8: PosX = 'x'"):
        parts_from_cpl(re.sub(rb"(?m)^(R3 +\S+ +\S+ +)\S+", rb"\1x", cpl_of("kicad")))
    with pytest.raises(ValueError, match="line 3: 'R2' is on layer '2'"):
        parts_from_cpl(re.sub(rb"(?m)^(R2\t\S+\t\S+\t\S+\t)1", rb"\g<1>2", cpl_of("macrofab")))


@EVERY
def test_previews_have_the_tape_s_name_whatever_the_list_is_called(house: str) -> None:
    made = examined(house)
    paths = {artifact.role: artifact.path for artifact in render_all(made.drawing, made.fab)}
    assert paths["cpl"] == PATHS.get(house, "assembly/t-cpl.csv")
    assert (paths["preview-svg"], paths["preview-png"]) == ("preview/t.svg", "preview/t.png")
