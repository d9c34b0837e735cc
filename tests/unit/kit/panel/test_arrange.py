"""Panels: which arrangement, and what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tactape_fab.base.errors import SpecError
from tactape_fab.cli import main
from tactape_fab.cli.exits import RULES, USAGE
from tactape_fab.kit.examine.order import ExaminedPanel, examine_order
from tactape_fab.kit.examine.tape import Examined
from tactape_fab.kit.panel.arrange import arrangements, choose_arrangement
from tactape_fab.kit.profiles import load_fab
from tests.thorough import slow

FAB = load_fab("jlcpcb-fpc")


# Which arrangement


@pytest.mark.parametrize(
    ("size_mm", "count", "expected"),
    [
        ((100.0, 50.0), None, (1, 2)),  # a tape alone is too small in one direction
        ((100.0, 80.0), None, (1, 1)),
        ((50.0, 100.0), None, (2, 1)),
        ((20.0, 20.0), None, (3, 3)),
        ((100.0, 50.0), 6, (2, 3)),
        ((100.0, 50.0), 4, (2, 2)),
        ((236.0, 236.0), None, (1, 1)),
    ],
)
def test_the_fewest_tapes_that_assembly_takes(size_mm: tuple[float, float], count: int | None, expected: tuple[int, int]) -> None:
    assert choose_arrangement(size_mm, FAB, count) == expected


def test_every_arrangement_is_within_the_limits() -> None:
    found = arrangements((30.0, 25.0), FAB)
    sizes = {(c, r): (10 + 2 + c * 32.0, 10 + 2 + r * 27.0) for c in range(1, 12) for r in range(1, 12)}
    assert set(found) == {pair for pair, size in sizes.items() if min(size) >= 70 and max(size) <= 250}


@pytest.mark.parametrize(("size_mm", "count"), [((236.1, 50.0), None), ((50.0, 250.0), None), ((100.0, 50.0), 7)])
def test_tapes_that_fit_on_no_panel(size_mm: tuple[float, float], count: int | None) -> None:
    with pytest.raises(SpecError, match=r"fit on no panel|fill no panel"):
        choose_arrangement(size_mm, FAB, count)


def test_a_fab_that_makes_smaller_boards_than_assembly_takes_decides() -> None:
    small = replace(FAB, size=replace(FAB.size, largest_mm=(120.0, 118.0)))
    assert arrangements((100.0, 50.0), small) == [(1, 2)]


# What is refused


def run(arguments: str) -> tuple[int, list[str]]:
    with_output = f"{arguments} --no-3d" if "dome" not in arguments else arguments
    answer = CliRunner().invoke(main, with_output.split())
    return answer.exit_code, [line for line in answer.stderr.splitlines() if line.startswith("error")]


CASES: list[tuple[str, int, str]] = [
    ("--sector 7 --panel 3x6", USAGE, "panel = 3x6 .* is 318 x 324 mm, but assembly .* to 250 x 250 mm.*; use --panel 2x4"),
    ("--sectors 3,9 --panel 2x1 --size 40x24", USAGE, "panel = 2x1 .* 96 x 38 mm.*; use --panel 2x3, and name 6 sectors$"),
    ("--sectors 1-6 --panel 1x6", USAGE, "panel = 1x6 .*; use --panel 2x3$"),
    ("--sector 7 --panel 1x1", USAGE, "panel = 1x1 .* is 114 x 64 mm, but .* takes 70 x 70 .*; use --panel 1x2"),
    (
        "--sector 7 --panel auto --size 300x100",
        USAGE,
        "tapes of 300 x 100 mm fit on no panel.* 314 x 114 mm.*; use another --size",
    ),
    (
        "--sectors 1-7 --panel auto",
        USAGE,
        "7 tapes of 100 x 50 mm fill no panel .*; name another number of --sectors, such as 6, 8",
    ),
    ("--sector 7 --panel 0x6", USAGE, "panel = 0x6 has 0 columns and 6 rows; give 1 to 100 of each"),
    ("--sector 7 --panel 2", USAGE, "panel = '2' is no arrangement; give columns x rows, such as 2x3, or auto, or none"),
    ("--sector 7 --panel -1x2", USAGE, "panel = '-1x2' is no arrangement"),
    ("--sector 7 --panel 2x3x4", USAGE, "panel = '2x3x4' is no arrangement"),
    ("--sectors 7,8,9 --panel 2x3", USAGE, "names 3 tapes, but --panel = 2x3 has 6; name 6, or use --panel auto"),
    ("--sectors 7,8,7 --panel auto", USAGE, "sectors = '7,8,7' names sector 7 more than once"),
    ("--sectors 9-7 --panel auto", USAGE, "sectors = '9-7' .* runs backwards; give 7-9"),
    ("--sectors 7,x --panel auto", USAGE, "holds 'x', which is neither a sector nor a range"),
    ("--sectors 254-257 --panel auto", USAGE, "outside 0 to 255; the code has 256 sectors"),
    ("--sector 7 --sectors 7,8 --panel auto", USAGE, "--sectors = '7,8' and --sector = 7 are given; give one of them"),
    (
        "--sectors 7,8 --same-sector --panel auto",
        USAGE,
        "--same-sector contradicts --sectors = '7,8', one for each tape; give --sector N in their place",
    ),
    ("--sector 7 --same-sector", USAGE, "--same-sector is of a panel, and none is asked for; give --panel"),
    ("--sector 7 --panel none --tabs y", USAGE, "tabs is of a panel, but --panel = 'none'; leave out --tabs"),
    (
        "--sector 255 --panel auto",
        USAGE,
        "asks for sectors up to 256, but code 'microdots-4x4' has 256, .*; use --sector 254 or less",
    ),
    ("--sector 7 --panel auto --tag-id 5", USAGE, "--tag-id = 5 would be that of all 2 tapes; leave out --tag-id$"),
    ("--sector 7 --panel auto --tabs z", USAGE, "tabs = 'z' is none of: auto, x, y, xy"),
    (
        "--sector 7 --panel auto --part dome",
        USAGE,
        "panel = 'auto' is of films with parts, but --part = 'dome' .*; leave out --panel",
    ),
    ("--sector 7 --panel 2x2 --part dome --sector x", USAGE, "panel = '2x2' is of films"),
    ("--panel auto", USAGE, "sector is missing; give --sector N"),
    (
        "--sector 7 --panel auto --tabs x --size 100x9 --corner-radius 4 --tag none",
        USAGE,
        "tabs = 'x': the left and right sides of 9 mm have no room for a tab of 1 mm, .* needs 11 mm; use --tabs y, ",
    ),
    (
        "--sector 7 --panel auto --size 10x10 --corner-radius 5 --tag none",
        USAGE,
        "tabs = 'auto': the left and right sides of 10 mm have no room .* needs 13 mm; use a larger --size or a smaller --corner",
    ),
    ("--sector 7 --panel auto --w 0.9", RULES, "pad-pad: gap between pads of two parts .* is below the limit"),
]


@pytest.mark.parametrize(("arguments", "status", "message"), CASES, ids=[case[0] for case in CASES])
@pytest.mark.parametrize("command", ["make", "check"])
def test_one_clear_message(command: str, arguments: str, status: int, message: str, here: Path) -> None:
    code, lines = run(f"{command} {arguments}")
    assert code == status, lines
    assert len([line for line in lines if re.search(message, line)]) == 1, lines
    assert list(here.iterdir()) == []


def test_everything_that_is_wrong_is_said_together(here: Path) -> None:
    code, lines = run("make --sector 7 --sectors 8,9 --panel 9x --tabs q --w -1 --fab nowhere")
    assert code == USAGE
    said = "\n".join(lines)
    for key in ("panel = '9x'", "sector = 7", "tabs = 'q'", "--w = -1", "fab = 'nowhere'"):
        assert said.count(key) == 1, said


@slow
def test_a_toml_may_ask_for_a_panel(tmp_path: Path) -> None:
    spec = tmp_path / "p.toml"
    spec.write_text('sectors = [7, 8]\npanel = "1x2"\ntabs = "y"\nsize_mm = [60, 30]\nmodels = false\n')
    answer = CliRunner().invoke(main, ["make", str(spec), "-o", str(tmp_path / "out")])
    assert answer.exit_code == 0, answer.stderr
    assert sorted(p.name for p in (tmp_path / "out" / "tapes").iterdir()) == ["tactape-s007", "tactape-s008"]


# Whether there is a panel


@pytest.mark.parametrize(
    ("values", "count"),
    [
        ({"sector": 7}, None),
        ({"sector": 7, "fab": "generic-fpc", "panel": "auto"}, 2),
        ({"sector": 7, "fab": "jlcpcb-fpc"}, 2),
        ({"sector": 7, "fab": "jlcpcb-fpc", "panel": "none"}, None),
        ({"sector": 7, "fab": "jlcpcb-fpc", "size_mm": [100.0, 80.0]}, 1),
        ({"sector": 7, "fab": "pcbway-fpc"}, None),
        ({"sector": 7, "panel": "3x1", "size_mm": [60.0, 58.0]}, 3),
        ({"sector": 7, "part": "dome"}, None),
        ({"sector": 7, "fab": "jlcpcb-fpc", "size_mm": [300.0, 100.0]}, None),
    ],
)
def test_a_panel_is_made_where_it_is_asked_for_or_the_profile_says_so(values: dict[str, Any], count: int | None) -> None:
    examined, remarks = examine_order({"models": False, **values} if values.get("part") != "dome" else values)
    if count is None:
        assert isinstance(examined, Examined)
    else:
        assert isinstance(examined, ExaminedPanel)
        assert [tape.tape.sector for tape in examined.tapes] == list(range(7, 7 + count))
    aloud = values.get("fab") == "jlcpcb-fpc" and "panel" not in values
    assert bool(remarks) == aloud


def test_copies_are_said_to_be_copies() -> None:
    examined, remarks = examine_order({"sector": 7, "panel": "auto", "same_sector": True, "models": False})
    assert isinstance(examined, ExaminedPanel)
    assert [tape.tape.name for tape in examined.tapes] == ["tactape-s007-1", "tactape-s007-2"]
    assert {tape.tape.sector for tape in examined.tapes} == {7}
    assert [r for r in remarks if "cannot tell one of these copies from another" in r]


def test_a_panel_may_be_named() -> None:
    examined, _ = examine_order({"sector": 7, "panel": "auto", "name": "lab", "models": False})
    assert isinstance(examined, ExaminedPanel)
    assert (examined.name, [tape.tape.name for tape in examined.tapes]) == ("lab", ["lab-s007", "lab-s008"])


def test_what_assembly_asks_is_asked_of_the_panel() -> None:
    examined, _ = examine_order({"sector": 7, "panel": "auto", "models": False})
    findings = {finding.rule: finding for finding in examined.findings}
    assert findings["part-count"].value == 2 * 1984
    assert findings["assembly-size"].passed
    assert "the panel is 114 x 116 mm" in findings["assembly-size"].message
    assert findings["size"].message.startswith("board 116 x 114 mm is within")  # it was the tape's, beside the panel's own size
