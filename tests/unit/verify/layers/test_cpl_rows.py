"""CPL and BOM beside the tape: what is right passes, and one row or cell changed is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.kit.profiles import LandPattern
from tactape_fab.texture.cpl import PLACEMENTS, CplContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly, check_bom, check_cpl, read_assembly
from tests.tapes import tape_at

TAPE = tape_at(7, (6, 5))
NAMES = tuple(f"R{i + 1}" for i in range(30))
RECORDED = RecordedAssembly(format="kicad", value="0 R", footprint="R 0201", description="chip resistor", part_number="")
PADS = LandPattern(size_mm=(0.46, 0.40), corner_radius_mm=0.1, offset_mm=0.32)
RIGHT = CplContent(
    table=PLACEMENTS["kicad"],
    headers=PLACEMENTS["kicad"].headers,
    lines=tuple(range(2, 32)),
    designators=NAMES,
    xy_mm=TAPE.part_xy_mm(),
    sides=("Top",) * 30,
    rotation_deg=np.full(30, 45.0),
    texts={"value": ("0_R",) * 30, "footprint": ("R_0201",) * 30},
)

ONE_WRONG: dict[str, tuple[str, ...]] = {"value": ("0_R",) * 29 + ("1_R",)}


def checked(content: CplContent) -> dict[str, Check]:
    return {check.name: check for check in check_cpl(content, TAPE, RECORDED, PADS)}


def moved(x_mm: float, y_mm: float) -> FloatArray:
    return TAPE.part_xy_mm() + np.eye(30, 1, -6) * (x_mm, y_mm)


def test_a_right_list_passes_with_its_figures() -> None:
    checks = checked(RIGHT)
    assert [check.passed for check in checks.values()] == [True] * 3
    assert checks["cpl rows"].message == "30 rows, R1 to R30 in order" and checks["cpl rows"].figure == 30
    assert (checks["cpl places"].figure, checks["cpl rotation"].figure) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (replace(RIGHT, designators=(*NAMES[:29], "R31")), "it misses R30; it has unknown R31"),
        (replace(RIGHT, designators=(*NAMES[:29], "R1")), "it misses R30; it repeats R1"),
        (replace(RIGHT, designators=("R1", "R3", "R2", *NAMES[3:])), "rows are out of order: row 2 is R3, not R2"),
        (replace(RIGHT, sides=("Top", "Bottom") * 15), "15 rows are not on layer Top"),
        (replace(RIGHT, texts=ONE_WRONG), "the value of 1 rows is not '0_R': R30 '1_R'"),
        (replace(RIGHT, table=PLACEMENTS["macrofab"]), "no list of format 'kicad': its columns are Designator,X-Loc"),
    ],
)
def test_rows_are_the_parts_in_order(content: CplContent, says: str) -> None:
    check = checked(content)["cpl rows"]
    assert not check.passed and says in check.message


@pytest.mark.parametrize(("unit", "mm"), [("kicad", 1.0), ("macrofab", 0.0254)])
def test_sizes_are_those_of_both_lands_in_the_list_s_unit(unit: str, mm: float) -> None:
    """0.32 mm twice and a land of 0.46 x 0.4 mm: 1.1 x 0.4 mm."""
    texts: dict[str, tuple[str, ...]] = {"length": (f"{1.1 / mm:.4f}",) * 30, "width": (f"{0.4 / mm:.4f}",) * 30}
    table = PLACEMENTS[unit]
    recorded = replace(RECORDED, format=unit)
    (rows, *_) = check_cpl(replace(RIGHT, table=table, texts=texts), TAPE, recorded, PADS)
    assert rows.passed, rows.message


@pytest.mark.parametrize(
    ("content", "passed", "figure_um", "says"),
    [
        (replace(RIGHT, xy_mm=moved(0.0006, -0.0007)), True, 0.922, "every row within 0.922 um"),
        (replace(RIGHT, xy_mm=moved(-0.003, 0.004)), False, 5.0, "1 rows are off the manifest's grid: R7 by 5.0 um"),
        (replace(RIGHT, designators=("X", *NAMES[1:]), xy_mm=moved(-0.003, 0.004)), False, 5.0, "R7 by 5.0 um"),
        (replace(RIGHT, designators=("X", *NAMES[1:])), True, 0.0, "every row within 0.000 um"),
        (replace(RIGHT, designators=("X",) * 30), False, None, "no row names a part of this tape"),
    ],
)
def test_rows_are_at_their_places_by_name(content: CplContent, passed: bool, figure_um: float | None, says: str) -> None:
    check = checked(content)["cpl places"]
    assert check.passed is passed and says in check.message
    assert check.figure == (None if figure_um is None else pytest.approx(figure_um, abs=1e-3))


@pytest.mark.parametrize(("deg", "off_deg"), [(45.04, 0.04), (405.0, 0.0), (45.06, 0.06), (-135.0, 180.0), (315.0, 90.0)])
def test_rotations_are_compared_round_the_circle(deg: float, off_deg: float) -> None:
    check = checked(replace(RIGHT, rotation_deg=np.array([deg] + [45.0] * 29)))["cpl rotation"]
    assert check.figure == pytest.approx(off_deg, abs=1e-9) and check.passed is (off_deg < 0.05)
    assert check.passed or check.message == f"1 parts are turned: R1 at {deg:g} deg, the manifest says 45 deg"


def bom(*groups: str, quantity: int = 0) -> bytes:
    rows = (f'"{group}",{group.count(",") + 1 + quantity},0 R,R 0201,chip resistor,' for group in groups)
    return "\r\n".join(["Designator,Quantity,Value,Footprint,Description,Part Number", *rows, ""]).encode()


MANY = [f"R{i + 1}" for i in range(201)]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (bom(",".join(MANY[:200]), "R201"), ""),
        (bom(",".join(MANY[:1]), ",".join(MANY[1:])), ""),
        (bom(",".join(MANY), "R202"), "it has unknown R202; a row has 201 designators, more than 200"),
        (bom(",".join(MANY[:100]), ",".join(MANY[101:])), "it misses R101"),
        (bom(",".join(MANY[:100]), ",".join(MANY[99:])), "it repeats R100"),
        (bom(",".join(MANY[:101]), ",".join(MANY[101:]) + ",R300"), "it has unknown R300"),
        (
            bom(",".join(MANY[:101]), ",".join(MANY[101:]), quantity=1),
            "the quantity of row 1 is '102', not '101'; the quantity of",
        ),
        (bom("R1-R201"), "it misses R1, R2, R3, R4, R5 and 196 more; it has unknown R1-R201"),
    ],
)
def test_a_bom_has_each_part_once_in_rows_of_200(data: bytes, says: str) -> None:
    check = check_bom(
        data.replace(b'"R201"', b"R201").replace(b'"R1"', b"R1").replace(b'"R202"', b"R202").replace(b'"R1-R201"', b"R1-R201"),
        MANY,
        RECORDED,
    )
    assert check.passed != bool(says) and check.message.startswith(says), check.message
    assert says or (check.message == "201 designators in 2 rows, each once" and check.figure == 201)


def test_texts_are_those_of_the_manifest() -> None:
    texts = {"value": "0R", "footprint": "R_0201", "description": "chip, any", "part_number": "C12"}
    read = read_assembly(Fields({"assembly": {"format": "jlcpcb", **texts}}))
    assert read == RecordedAssembly(format="jlcpcb", **texts)
    none = {"format": "generic", **texts, "part_number": None}
    assert read_assembly(Fields({"assembly": none})) == replace(read, format="generic", part_number="")
    formula = Fields({"assembly": {**none, "value": "=1+1"}})
    read_assembly(formula)
    assert "a cell begins with a letter or digit and holds no formula" in str(formula.problems[0])
