"""Bad lists of tapes at the command line: every refusal names the value and the remedy, all together, and nothing is written."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from tactape_fab.cli import main
from tactape_fab.kit.examine.tape_lists import list_tapes

USAGE, RULES = 2, 3


def refuse(folder: Path, args: str, status: int) -> list[str]:
    """Lines of a refusal that wrote nothing."""
    before = sorted(folder.rglob("*"))
    result = CliRunner().invoke(main, shlex.split(args), prog_name="tactape-fab")
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code == status, result.output
    assert result.stdout == ""
    assert "Traceback" not in result.output
    assert sorted(folder.rglob("*")) == before
    return [line.removeprefix("error: ") for line in result.stderr.splitlines() if line.startswith("error: ")]


@pytest.mark.parametrize(
    ("args", "status", "said"),
    [
        ("make --sectors 0-256", USAGE, "holds 0-256, outside 0 to 255; the code has 256 sectors"),
        ("make --sectors 0-3968 --code debruijn-4x4", USAGE, "outside 0 to 255"),
        ("make --sectors 0-3969 --code anoto-6x6 --tag none", USAGE, "outside 0 to 3968; the code has 3969 sectors"),
        ("make --sectors 0-99999999999999", USAGE, "outside 0 to 255"),
        ("make --sectors 9-7", USAGE, "runs backwards; give 7-9"),
        ("make --sectors=", USAGE, "names no sector; give sectors and ranges of them, such as 0-9,20"),
        ("make --sectors 7-", USAGE, "holds '7-', which is neither a sector nor a range"),
        ("make --sectors 7,7", USAGE, "names sector 7 more than once; name each once"),
        ("make --sectors 7 --sector 8", USAGE, "--sector = 8 contradicts --sectors = '7'; give one of them"),
        ("make --sectors 7,8 --name lab", USAGE, "name = 'lab' cannot be that of all tapes"),
        ("make --sectors 7 --workers 0", USAGE, "workers = 0 is outside 1 to 64; give a number of processes"),
        ("make --sectors 7 --jobs 1000000", USAGE, "workers = 1000000 is outside 1 to 64"),
        ("make --sectors 7 --workers two", USAGE, "workers = 'two' is no number of processes and no address"),
        ("make --sectors 7,8 --size 300x300 --pack", USAGE, "--size = 300 x 300 mm does not fit into 236 x 236 mm"),
        ("make --sectors 7,8 --part dome --pack", USAGE, "part = 'dome' makes no film that could be packed"),
        ("make --sectors 7,8 --w nan", USAGE, "--w = nan mm is not a finite number"),
        ("make --sectors 7,8 --part r9999", USAGE, "part = 'r9999' is none of"),
        ("make --sectors 7,8 --delta 0.7", RULES, "pad-pad: gap between pads of two parts -0.329 mm is below the limit 0.100 mm"),
        ("make --sector 7 --pack", USAGE, "--pack is for lists of tapes; give --sectors or [[tapes]], or leave it out"),
        ("make --sector 7 --jobs 2", USAGE, "--workers is for lists of tapes; give --sectors or [[tapes]], or leave it out"),
        ("make --sectors 7,8 --pack --panel 1x2", USAGE, "--panel = '1x2' makes one panel of them; leave one of the two out"),
        ("make --sectors 7,8 --workers 2 --panel auto", USAGE, "--workers is for lists of tapes, and --panel = 'auto' makes one"),
    ],
)
def test_a_bad_list_is_refused_once(args: str, status: int, said: str, here: Path) -> None:
    lines = refuse(here, args, status)
    assert [said in line for line in lines].count(True) == 1, lines


def test_everything_wrong_comes_together(here: Path) -> None:
    (here / "file").write_text("")
    lines = refuse(here, "make --sectors 9-7,300 --jobs 0 -o file --w nan --delta 0.7 --name x", USAGE)
    said = ["workers = 0", "-o = file exists and is not a folder", "holds 9-7", "holds 300", "name = 'x'", "--w = nan"]
    assert [any(part in line for line in lines) for part in said] == [True] * len(said), lines


@pytest.mark.parametrize("command", ["make lab.toml", "make lab.toml --pack", "make lab.toml --workers 2", "check lab.toml"])
def test_tapes_of_a_file_are_no_panel_but_packed(command: str, here: Path) -> None:
    (here / "lab.toml").write_text('size_mm = [60, 30]\n[[tapes]]\nsectors = "1-2"\n')
    (line,) = refuse(here, f"{command} --panel 1x2", USAGE)
    assert line.startswith("--panel = '1x2' is of tapes of one size, and [[tapes]] lists any; leave out --panel, and use --pack")
    (here / "lab.toml").write_text('panel = "1x2"\n[[tapes]]\nsectors = "1-2"\n')
    assert "; leave out panel, and use --pack to put them on panels" in refuse(here, command, USAGE)[0]


def test_tapes_of_a_file_are_named_by_their_index(here: Path) -> None:
    (here / "lab.toml").write_text(
        "models = false\n"
        "[[tapes]]\nsize_mm = [60, 40]\n"
        "[[tapes]]\nsector = 12\nsize_mm = [100, -50]\n"
        '[[tapes]]\nsector = 12\nsectors = "3"\npitch = 3\n'
        "[[tapes]]\nsector = 12\ndisplacement_mm = 0.7\n"
        "[[tapes]]\nsectors = [1, 1]\npitch_mm = inf\n"
        '[[tapes]]\nsectors = "250-251"\nsize_mm = [4000, 40]\n'
    )
    lines = refuse(here, "make lab.toml", USAGE)
    for said in (
        "tapes[0]: sector is missing; give sector = N",
        "tapes[1]: size_mm[1] = -50 mm is not above 0 mm",
        "tapes[2]: sector = 12 contradicts sectors = '3'",
        "tapes[2]: pitch is not a known key",
        "tapes[4]: sectors = [1, 1] names sector 1 more than once",
        "tapes[4]: pitch_mm = inf mm is not a finite number",
        "tapes[5]: sector 250: origin column 3000 + 2662",
        "tapes[5]: sector 251: origin column 3012 + 2662",
        "pad-pad: tapes[3]: gap between pads",
    ):
        assert [said in line for line in lines].count(True) == 1, (said, lines)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("tapes = []", "tapes = [] is no list of tapes; give each a table of its own, [[tapes]]"),
        ("tapes = [1]", "tapes[0]: 1 is no table"),
        ("sector = 1\n[[tapes]]\nsector = 2", "sector = 1 cannot be that of all tapes"),
        ("[[tapes]]\nsector = 1\n[[tapes]]\nsector = 1\nsize_mm = [30, 20]", "name = 'tactape-s001' is that of 2 tapes"),
        ("[[tapes]]\nsector = 1\ncode = []", "tapes[0]: code = [] is not a text"),
        ("sectors = 7", "sectors = 7 is no list of sectors"),
        ("[[tapes", "is not TOML"),
    ],
)
def test_a_bad_file_of_tapes_is_refused_once(text: str, said: str, here: Path) -> None:
    (here / "lab.toml").write_text(text)
    lines = refuse(here, "make lab.toml", USAGE)
    assert [said in line for line in lines].count(True) == 1, lines


def test_many_sectors_out_of_reach_are_counted(here: Path) -> None:
    lines = refuse(here, "make --sectors 0-255 --size 4000x40 --no-3d", USAGE)
    assert len(lines) == 6
    assert lines[0].startswith("sector 60: origin column 720 + 2662 columns of the tape exceed 3375")
    assert lines[5] == "191 more sectors are refused for their origin; give fewer of them"


def test_a_place_that_cannot_hold_kits_is_refused(here: Path) -> None:
    (here / "kit").mkdir()
    (here / "kit" / "manifest.json").write_text("{}")
    (here / "lab" / "tactape-s007").mkdir(parents=True)
    (here / "lab" / "tactape-s007" / "mine.txt").write_text("")
    assert refuse(here, "make --sectors 7 -o kit", USAGE) == [
        "-o = kit is a kit, which holds no other kits; use -o to name another folder"
    ]
    (line,) = refuse(here, "make --sectors 7 -o lab --overwrite", USAGE)
    assert "lab/tactape-s007 is no kit of this tool" in line
    (line,) = refuse(here, f"make --sectors 7 -o {'n' * 300}", USAGE)
    assert "cannot be a folder: File name too long" in line


def test_check_takes_one_tape(here: Path) -> None:
    (here / "lab.toml").write_text("[[tapes]]\nsector = 1\n")
    (line,) = refuse(here, "check lab.toml", USAGE)
    assert "lab.toml is a list of tapes" in line


def test_tables_that_are_alike_are_each_named(here: Path) -> None:
    (here / "lab.toml").write_text(
        "models = false\n"
        "[[tapes]]\nsector = 1\ndisplacement_mm = 0.7\n[[tapes]]\nsector = 2\ndisplacement_mm = 0.7\n"
        "[[tapes]]\nsector = 3\npitch_mm = -1\n[[tapes]]\nsector = 300\npitch_mm = -1\n[[tapes]]\nsector = 5\n"
    )
    lines = refuse(here, "make lab.toml", USAGE)
    for said in (
        "pad-pad: tapes[0]: gap",
        "pad-pad: tapes[1]: gap",
        "tapes[2]: pitch_mm = -1 mm",
        "tapes[3]: pitch_mm = -1 mm",
        "tapes[3]: sector = 300",
    ):
        assert [said in line for line in lines].count(True) == 1, (said, lines)
    assert not any("tapes[4]" in line for line in lines)


def test_a_warning_of_many_tables_is_said_once(tmp_path: Path) -> None:
    values = {"models": False, "size_mm": (700.0, 20.0), "tapes": [{"sector": 1}, {"sectors": "2-3"}]}
    listed = list_tapes(values, {}, tmp_path / "lab")
    assert [finding.rule for finding in listed.findings if finding.level == "warn" and not finding.passed].count("size") == 1
    assert [tape.spec.sector for tape in listed.tapes] == [1, 2, 3]
    assert not (tmp_path / "lab").exists()
