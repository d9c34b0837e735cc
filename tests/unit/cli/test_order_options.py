"""Bad input about orders at the command line: formats, part numbers, a profile's [order], size codes of parts."""

from __future__ import annotations

import csv
import io
import re
import shlex
from pathlib import Path

import pytest

from tactape_fab.base.templates import profile_names, templates_folder
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS
from tests.commands import run

USAGE = 2
CELL = "use 1 to 80 letters, digits, spaces and ._()/#+-"
LCSC = "a C and up to 10 digits"


def refused(args: str, *said: str) -> list[str]:
    """The lines of a refusal, one of which says everything."""
    result = run(args)
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert (result.exit_code, result.stdout) == (USAGE, "")
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert any(all(text in line for text in said) for line in lines), result.stderr
    return lines


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--assembly acme", (f"assembly = 'acme' is none of: {', '.join(ASSEMBLY_FORMATS)}",)),
        ("--assembly macrofab2", ("did you mean 'macrofab'?",)),
        ("--assembly ''", ("assembly = '' is none of",)),
        ("--part-number ''", ("--part-number = ''", CELL)),
        ("--part-number 'RC0201,5%'", ("--part-number = 'RC0201,5%'", CELL)),
        ("--part-number =1+1", ("--part-number = '=1+1'", "the first a letter or digit")),
        ("--part-number=-C1", ("--part-number = '-C1'", CELL)),
        ("--part-number +C1", ("--part-number = '+C1'", CELL)),
        ("--part-number @SUM", ("--part-number = '@SUM'", CELL)),
        ("--part-number 'A\nB'", (r"--part-number = 'A\nB'", CELL)),
        ("--part-number 'A\tB'", (r"--part-number = 'A\tB'", CELL)),
        ("--part-number 'A '", ("--part-number = 'A '", CELL)),
        ("--part-number 'A\"B'", ("--part-number = 'A\"B'", CELL)),
        ("--part-number \u0421123", ("--part-number = ", CELL)),
        (f"--part-number {'9' * 81}", ("--part-number = '999", "...", CELL)),
        ("--assembly jlcpcb --part-number RC0201-0R", ("--part-number = 'RC0201-0R'", "format 'jlcpcb'", LCSC)),
        ("--fab jlcpcb-fpc --part-number 12345", ("--part-number = '12345'", "format 'jlcpcb'", LCSC)),
        ("--assembly jlcpcb --part-number C12345678901", ("'C12345678901'", LCSC)),
        ("--part dome --part-number C1", ("--part-number = 'C1' contradicts --part = 'dome'", "leave out --part-number")),
    ],
)
def test_a_bad_option_is_refused(options: str, said: tuple[str, ...], here: Path) -> None:
    refused(f"make --sector 7 {options}", *said)
    assert list(here.iterdir()) == []


def test_all_problems_come_together(here: Path) -> None:
    lines = refused("make --sector 700 --assembly jlcpcb --part-number X1 --size 5x5", "--part-number = 'X1'", LCSC)
    assert any("sector = 700" in line for line in lines)
    assert len(refused("make --sector 7 --assembly acme --part-number =1", "assembly = 'acme'")) == 2


@pytest.mark.parametrize("number", ["C1", "ERJ-1GN0R00C", "RC0201FR-070RL", "LTC1234#PBF", "74/5 (0201)", "9" * 80, "7"])
def test_real_part_numbers_are_taken(number: str) -> None:
    assert run(f"check --sector 7 --size 20x20 --part-number {shlex.quote(number)}").exit_code == 0


def own(folder: Path, kind: str, name: str, pattern: str, new: str) -> Path:
    """A profile of the user's own: a shipped one with one change."""
    text = (templates_folder() / kind / f"{name}.toml").read_text(encoding="utf-8")
    changed, count = re.subn(pattern, lambda _: new, text, count=1, flags=re.DOTALL)
    assert count == 1
    path = folder / "own.toml"
    path.write_text(changed, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("pattern", "new", "said"),
    [
        (r"\[order\].*", "", ("order is missing; give a table of that name",)),
        (r"\[order.joint\].*?(?=\[order.part\])", "", ("order.joint is missing; give a table of that name",)),
        (r"cost = 25.56", "cost = -1", ("order.setup.cost = -1 USD is below 0 USD", "; give a number")),
        (r"cost = 25.56", "cost = nan", ("order.setup.cost = nan USD is not a finite number",)),
        (r"cost = 25.56", "cost = 1e9", ("order.setup.cost = 1e+09 USD exceeds 1e+06 USD",)),
        (r"cost = 25.56", 'cost = "25"', ("order.setup.cost = '25' is not a number in USD",)),
        (r"cost = 25.56", "", ("order.setup.cost is missing; give a number in USD",)),
        (r"cost = 25.56", "costs = 25.56", ("order.setup.costs is not a known key; did you mean 'cost'?",)),
        (r"seconds = 0.1", "seconds = -0.1", ("order.placement.seconds = -0.1 s is below 0 s",)),
        (r"currency = \"USD\"", 'currency = "dollars"', ("order.currency = 'dollars'", "give three capitals, such as USD")),
        (r"template = \"generic-fpc\"", 'template = "../base"', ("order.template = '../base' is none of: generic-fpc",)),
        (r"template = \"generic-fpc\"", 'template = "base"', ("order.template = 'base' is none of",)),
        (r"template = \"generic-fpc\"", "", ("order.template is missing",)),
        (r"\[order.setup\]", "[order.rush]\ncost = 1\n[order.setup]", ("order.rush is not a known key",)),
        (r"(?<=cost = 25.56\n)source = [^\n]*", "", ("order.setup.source is missing",)),
        (r"format = \"generic\"", 'format = "acme"', ("assembly.format = 'acme' is none of: generic, jlcpcb, pcbway",)),
        (r"format = \"generic\"", 'format = "generic"\ncolumns = 5', ("assembly.columns is not a known key",)),
    ],
)
def test_a_bad_fab_profile_is_refused(pattern: str, new: str, said: tuple[str, ...], here: Path) -> None:
    own(here, "fabs", "generic-fpc", pattern, new)
    refused("check --sector 7 --fab own.toml", "fab own: ", *said)


@pytest.mark.parametrize(
    ("pattern", "new", "said"),
    [
        (r"R_0201_0603Metric", "R_0603", ("footprint = 'R_0603' names a chip of 1.6 x 0.8 mm", "write 0201")),
        (r"chip resistor 0201 \(0603 metric\)", "chip resistor 0603", ("description = 'chip resistor 0603", "write 0201")),
        (r"value = \"0R\"", 'value = "=0R"', ("value = '=0R'", "the first a letter or digit")),
        (r"value = \"0R\"", 'value = "-0R"', ("value = '-0R'", "the first a letter or digit")),
        (r"\[body\]", '[part_numbers]\njlcpcb = "123"\n[body]', ("part_numbers.jlcpcb = '123'", LCSC)),
        (r"\[body\]", '[part_numbers]\ngeneric = "a,b"\n[body]', ("part_numbers.generic = 'a,b'", CELL)),
        (r"\[body\]", '[part_numbers]\njlc = "C1"\n[body]', ("part_numbers.jlc is not a known key; did you mean 'jlcpcb'?",)),
        (r"\[body\]", "[part_numbers]\njlcpcb = 5\n[body]", ("part_numbers.jlcpcb = 5 is not a text", LCSC)),
        (r"shape = \"block\"", 'shape = "block"\npart_numbers = "C1"', ("part_numbers = 'C1' is not a table",)),
    ],
)
def test_a_bad_part_profile_is_refused(pattern: str, new: str, said: tuple[str, ...], here: Path) -> None:
    own(here, "parts", "r0201", pattern, new)
    refused("check --sector 7 --part own.toml", "part own: ", *said)


def test_a_part_profile_s_number_is_the_house_s_own_and_an_option_overrides_it(here: Path) -> None:
    numbers = '[part_numbers]\njlcpcb = "C77"\ngeneric = "ABC-1"\n[body]'
    own(here, "parts", "r0201", r"\[body\]", numbers)
    make = "make --sector 7 --size 20x20 --no-3d --part own.toml"
    for options, last in (("", "ABC-1"), ("--assembly jlcpcb", "C77"), ("--assembly pcbway", ""), ("--part-number Z9", "Z9")):
        result = run(f"{make} --overwrite {options}")
        assert result.exit_code == 0, result.stderr
        (bom,) = here.glob("tactape-s007/assembly/*-bom.csv")
        (row, *_) = csv.DictReader(io.StringIO(bom.read_text("ascii")))
        columns = [name for name in row if "part" in name.lower()]
        assert [row[name] for name in columns] == [last]
        notes = (here / "tactape-s007" / "tactape-s007-order-notes.txt").read_text("utf-8")
        assert (f"number {last}." if last else "no part number is given") in notes


def test_every_profile_has_its_template() -> None:
    stems = {path.stem for path in (templates_folder() / "order").glob("*.j2")}
    assert stems == {"base", *profile_names("fabs")}
