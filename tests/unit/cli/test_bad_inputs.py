"""Bad input at the command line: every refusal names the value, the limit and the remedy, in full and without a traceback,
has its exit status, and leaves the folder it ran in exactly as it was.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from click.testing import CliRunner, Result

from tactape_fab import Kit
from tactape_fab.base.errors import CapacityError, SpecError
from tactape_fab.base.templates import templates_folder
from tactape_fab.cli import main

FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
REMEDY = re.compile(r"; \S|did you mean")
"""For messages whose wording is free: an instruction of some kind, after the value and the limit."""
LONG = "n" * 300


class Case(NamedTuple):
    """A command line, its exit status, and what one line of its answer must say."""

    args: str
    status: int
    value: str
    limit: str
    remedy: str | re.Pattern[str]


PITCH = "--w is the grid pitch in millimetres"
DELTA = "--delta is the displacement in millimetres"
SIZE = "give WIDTHxHEIGHT in millimetres, such as 100x50"
ORIGIN = "give --origin COL,ROW"
NAMES = "use 1 to 64 letters, digits"
WIDER = re.compile(r"use --w [\d.]+ --delta [\d.]+")
DEEPER = "or -o to name another folder"

OPTIONS = [
    # sector
    Case("make", USAGE, "sector", "is missing", "give --sector N"),
    Case("make --sector -1", USAGE, "-1", "0 to 255", "256 sectors"),
    Case("make --sector 256", USAGE, "256", "0 to 255", "'anoto-6x6' has 3969"),
    Case("make --sector 7.5", USAGE, "7.5", "whole number", "256 sectors"),
    Case("make --sector 4000 --code anoto-6x6", USAGE, "4000", "0 to 3968", "3969 sectors"),
    Case("make --sector 7mm", USAGE, "7mm", "whole number", "256 sectors"),
    Case("make --sector 1_0", USAGE, "1_0", "whole number", "256 sectors"),
    # pitch
    Case("make --sector 7 --w 0.1", USAGE, "0.1 mm", "below 0.2 mm", PITCH),
    Case("make --sector 7 --w 25", USAGE, "25 mm", "exceeds 20 mm", PITCH),
    Case("make --sector 7 --w 1500", USAGE, "1500 mm", "exceeds 20 mm", PITCH),
    Case("make --sector 7 --w 1.5in", USAGE, "'1.5in'", "not a number in mm", PITCH),
    Case("make --sector 7 --w 1,5", USAGE, "'1,5'", "0.2 to 20", PITCH),
    Case("make --sector 7 --w 1_5", USAGE, "1_5", "0.2 to 20", PITCH),
    # displacement
    Case("make --sector 7 --delta 0.01", USAGE, "0.01 mm", "below 0.02 mm", DELTA),
    Case("make --sector 7 --delta 0.75", USAGE, "0.75 mm", "not below 0.75 mm", "less than half the pitch 1.5, usually 0.25"),
    Case("make --sector 7 --delta 250", USAGE, "250 mm", "not below 0.75 mm", DELTA),
    Case("make --sector 7 --w 3 --delta 1.6", USAGE, "1.6 mm", "not below 1.5 mm", "usually 0.5"),
    # size and the reach of a code
    Case("make --sector 7 --size 10000000x50", USAGE, "--size = '10000000x50': 1e+07 mm", "exceeds 10000 mm", SIZE),
    Case("make --sector 7 --size 10000000x50 --code debruijn-4x4", USAGE, "1e+07 mm", "exceeds 10000 mm", SIZE),
    Case(
        "make --sector 7 --size 50x10000000 --code anoto-6x6", USAGE, "--size = '50x10000000': 1e+07 mm", "exceeds 10000 mm", SIZE
    ),
    Case(
        "make --sector 7 --w 1.13 --size 5600x50",
        USAGE,
        "--size = '5600x50': 5600.0 mm",
        "exceeds 3813.75 mm, the reach",
        "--code",
    ),
    Case(
        "make --sector 7 --size 5600x50",
        USAGE,
        "--size = '5600x50': 5600.0 mm",
        "exceeds 5062.5 mm, the reach of code 'microdots-4x4' at pitch 1.5 mm",
        "use --code debruijn-4x4 or a smaller tape",
    ),
    Case("make --sector 7 --size 100x5600", USAGE, "--size = '100x5600': 5600.0 mm", "exceeds 5062.5 mm", "use --code anoto-6x6"),
    Case("make --sector 7 --code debruijn-4x4 --size 6500x50", USAGE, "6500.0 mm", "exceeds 6144.0 mm", "use --code anoto-6x6"),
    Case("make --sector 7 --size 9000x50", USAGE, "9000.0 mm", "exceeds 5062.5 mm", "use --code anoto-6x6"),
    Case(
        "make --sector 7 --size 5000x30",
        USAGE,
        "column 84 + 3328 columns",
        "exceed 3375",
        "use --origin 47,1428, with column at most 47",
    ),
    Case("make --sector 250 --size 4000x40", USAGE, "3000 + 2662", "exceed 3375", "with column at most 713"),
    Case("make --sector 7 --code anoto-6x6 --size 9000x9000", USAGE, "5995 x 5998", "500000", "use a smaller --size"),
    Case("make --sector 7 --size 5x5", USAGE, "5 x 5 mm is too small", "needs 13 x 7.7 mm", "use --size 13x7.7"),
    Case("make --sector 7 --size 5x5 --tag none", USAGE, "5 x 5 mm", "needs 7.7 x 7.7 mm", "use --size 7.7x7.7"),
    Case("make --sector 7 --size 40x30 --w 10", USAGE, "40 x 30 mm", "at pitch 10 mm", "use --size"),
    Case("make --sector 7 --size 0x50", USAGE, "0 mm", "not above 0 mm", SIZE),
    Case("make --sector 7 --size=-100x50", USAGE, "-100 mm", "not above 0 mm", SIZE),
    Case("make --sector 7 --size 100", USAGE, "'100'", "2 numbers", SIZE),
    Case("make --sector 7 --size 100x50x2", USAGE, "'100x50x2'", "2 numbers", SIZE),
    Case("make --sector 7 --size 100,50", USAGE, "'100,50'", "2 numbers", SIZE),
    Case("make --sector 7 --size 4inx2in", USAGE, "'4in'", "not a number in mm", SIZE),
    # origin
    Case("make --sector 7 --origin 3", USAGE, "'3'", "0 to 3374", ORIGIN),
    Case("make --sector 7 --origin=-1,0", USAGE, "-1", "0 to 3374", ORIGIN),
    Case("make --sector 7 --origin 0,3375", USAGE, "--origin = '0,3375': 3375", "0 to 3374", ORIGIN),
    Case("make --sector 7 --origin 3370,0", USAGE, "column 3370 + 62", "3375", "use --origin 3313,0, with column at most 3313"),
    Case("make --sector 7 --origin 0,3370", USAGE, "row 3370 + 32", "3375", "use --origin 0,3343, with row at most 3343"),
    Case("make --sector 7 --origin bets", USAGE, "bets", "0 to 3374", ORIGIN),
    Case("make --sector 7 --origin 1.5,2", USAGE, "--origin = '1.5,2': 1.5", "whole number", ORIGIN),
    # tag
    Case("make --sector 7 --tag round", USAGE, "'round'", "none of", "strip, none"),
    Case("make --sector 7 --tag-id 587", USAGE, "587", "0 to 586", "tag36h11"),
    Case("make --sector 7 --tag-id 5mm", USAGE, "5mm", "whole number", "tag36h11 has 587 ids"),
    Case("make --sector 7 --tag none --tag-id 3", USAGE, "--tag-id = 3", "contradicts --tag = 'none'", "give one of them"),
    Case("make --sector 900 --code anoto-6x6", USAGE, "--sector = 900", "586", "choose an id with --tag-id or use --tag none"),
    Case("make --sector 7 --tag-cell 0.1", USAGE, "0.1 mm", "below 0.3 mm", REMEDY),
    Case("make --sector 7 --tag-cell 6", USAGE, "6 mm", "exceeds 5 mm", REMEDY),
    # part, holes, corners, rotation, name
    Case("make --sector 7 --part r9999", USAGE, "'r9999'", "none of: block, ", "path of a .toml file"),
    Case("make --sector 7 --fab acme", USAGE, "'acme'", "generic-fpc, generic-fr4", "path of a .toml file"),
    Case("make --sector 7 --fab ../fabs/generic-fpc", USAGE, "'../fabs/generic-fpc'", "none of", "path of a .toml file"),
    Case("make --sector 7 --code qr", USAGE, "'qr'", "none of", "microdots-4x4, debruijn-4x4, anoto-6x6"),
    Case("make --sector 7 --assembly acme", USAGE, "'acme'", "none of", "generic, jlcpcb"),
    Case("make --sector 7 --x2 maybe", USAGE, "'maybe'", "none of", "full, comments, off"),
    Case("make --sector 7 --hole 200,10,1", USAGE, "200,10,1 mm", "inside the outline 100 x 50 mm", REMEDY),
    Case("make --sector 7 --hole 50,25,60", USAGE, "50,25,60 mm", "inside the outline 100 x 50 mm", REMEDY),
    Case("make --sector 7 --hole 50,25,0", USAGE, "0 mm", "not above 0 mm", "give X,Y,DIAMETER in mm"),
    Case("make --sector 7 --hole 50,10", USAGE, "'50,10'", "3 numbers", "give X,Y,DIAMETER in mm"),
    Case("make --sector 7 --hole 3,3.5,1", RULES, "-0.500 mm", "limit 0.150 mm", "use --tag none"),
    Case("make --sector 7 --hole 50,0.7,1", RULES, "0.200 mm", "limit 0.500 mm", "use --hole 50,1,1 in its place"),
    Case("make --sector 7 --hole 50,25,0.05", RULES, "0.050 mm", "limit 0.100 mm", "use --hole 50,25,0.1 in its place"),
    Case("make --sector 7 --hole 50,25,2 --hole 51,25,2", RULES, "-1.000 mm", "limit 0.500 mm", "leave out --hole 51,25,2"),
    Case("make --sector 7 --size 20x20 --hole 12,10,15", USAGE, "holes", "4x4 window", "use fewer holes"),
    Case("make --sector 7 --corner-radius 30", USAGE, "30 mm", "exceeds 25 mm", "give at most half the shorter side"),
    Case("make --sector 7 --corner-radius -1", USAGE, "-1 mm", "below 0 mm", "give at most half the shorter side"),
    Case(
        "make --sector 7 --corner-radius 3", USAGE, "3 mm cuts into the tag", "0.3 mm", "use --corner-radius 1.7, or --tag none"
    ),
    Case("make --sector 7 --rotation 400", USAGE, "400 deg", "exceeds 360 deg", REMEDY),
    Case("make --sector 7 --rotation=-400", USAGE, "-400 deg", "below -360 deg", REMEDY),
    Case("make --sector 7 --rotation 45mm", USAGE, "45mm", "not a number in deg", REMEDY),
    Case("make --sector 7 --name a/b", USAGE, "'a/b'", "1 to 64", NAMES),
    Case("make --sector 7 --name ''", USAGE, "''", "1 to 64", NAMES),
    Case("make --sector 7 --name ..", USAGE, "'..'", "1 to 64", NAMES),
    Case(f"make --sector 7 --name {'n' * 65}", USAGE, "'nnn", "1 to 64", NAMES),
    # legal numbers that break a design rule
    Case("make --sector 7 --delta 0.7", RULES, "pad-pad: gap between pads of two parts -0.329 mm", "limit 0.100 mm", WIDER),
    Case("make --sector 7 --w 1.2 --coverlay per-part", RULES, "bridge between openings 0.066 mm", "limit 0.200 mm", WIDER),
    Case("check --sector 7 --w 0.5", RULES, "body-body: gap between two largest bodies -0.094 mm", "limit 0.150 mm", WIDER),
    Case("make --sector 7 --rotation 90", RULES, "pad-pad: gap between pads of two parts -0.100 mm", "limit 0.100 mm", WIDER),
    # coverlay, anchors, backing, bending
    Case("make --sector 7 --coverlay open", USAGE, "--coverlay = 'open'", "per-part, lpi, gang", REMEDY),
    Case(
        "make --sector 7 --coverlay lpi", USAGE, "--coverlay = 'lpi'", "generic-fpc", "leave out --coverlay, or --fab generic-lpi"
    ),
    Case("make --sector 7 --fab jlcpcb-fr4 --coverlay per-part", USAGE, "'per-part'", "jlcpcb-fr4", "--fab generic-fpc"),
    Case("make --sector 7 --anchor rope", USAGE, "--anchor = 'rope'", "none, spur, mesh", REMEDY),
    Case("make --sector 7 --anchor spur --coverlay gang", USAGE, "--anchor = 'spur'", "coverlay = 'gang'", "give one of them"),
    Case("make --sector 7 --anchor mesh", RULES, "anchor-opening: ", "0.150 mm of generic-fpc", "use --w 1.773 --delta 0.25"),
    Case(
        "make --sector 7 --anchor mesh --fab jlcpcb-fpc", RULES, "anchor-opening: ", "coverlay gang", "use --w 2.056 --delta 0.25"
    ),
    Case(
        "make --sector 7 --anchor mesh --w 1.45 --delta 0.25",
        RULES,
        "anchor-opening: ",
        "coverlay gang",
        "use --w 1.773 --delta 0.25",
    ),
    Case("make --sector 7 --w 3 --anchor mesh --rotation 0", USAGE, "'mesh'", "--rotation = 0 deg", "use --rotation 45"),
    Case("make --sector 7 --stiffener FR4", USAGE, "--stiffener = 'FR4'", "cannot be used", "give MATERIAL:MM"),
    Case("make --sector 7 --stiffener FR4:0.33", USAGE, "--stiffener = 'FR4:0.33'", "FR4:0.2", "give one of them"),
    Case("make --sector 7 --stiffener FR4:0.2 --fab generic-fr4", USAGE, "'FR4:0.2'", "has none", "leave out --stiffener"),
    Case("make --sector 7 --adhesive glue:1", USAGE, "--adhesive = 'glue:1'", "3M468:0.13", "give one of them"),
    Case("make --sector 7 --bend-axis x", USAGE, "--bend-axis = 'x'", "has no effect alone", "--bend-radius MM"),
    Case("make --sector 7 --bend-radius 0.05", USAGE, "--bend-radius = 0.05 mm", "is below 0.1 mm", "0.1 to 100000 mm"),
    Case("make --sector 7 --bend-radius 20", USAGE, "--bend-radius = 20", "has no effect alone", "--bend-axis x or y"),
    Case("make --sector 7 --bend-axis z --bend-radius 20", USAGE, "--bend-axis = 'z'", "x, y", REMEDY),
    Case("make --sector 7 --bend-axis x --bend-radius -1", USAGE, "-1 mm", "below 0.1 mm", "--bend-radius is the radius"),
    Case(
        "make --sector 7 --bend-axis x --bend-radius 9 --fab generic-fr4",
        USAGE,
        "9 mm",
        "a rigid board",
        "leave out --bend-axis and --bend-radius",
    ),
    Case("make --sector 7 --part dome --coverlay gang", USAGE, "--coverlay = 'gang'", "no film", "leave out --coverlay"),
    Case("make --sector 7 --part dome --adhesive 3M468:0.13", USAGE, "'3M468:0.13'", "no film", "leave out --adhesive"),
    Case("make --sector 7 --fab jlcpcb-fpc --size 700x50", RULES, "size: board 700 x 50 mm", "600 x 250 mm", "ask the fab"),
    Case("profiles acme", USAGE, "'acme'", "generic-fpc", "nor the path of a .toml file"),
    Case("profiles acme.toml", USAGE, "acme.toml", "cannot be opened", "TOML file that can be read"),
    Case("make --sector 7 --w 1.2 --coverlay per-part --force --anchor rope", USAGE, "'rope'", "none, spur, mesh", REMEDY),
    # solid elements
    Case("make --sector 7 --part dome --body 0.6x0.3", USAGE, "0.6 x 0.3 mm", "below its radius 0.3 mm", "use a lower dome"),
    Case("make --sector 7 --part dome --body 0.6x0.5x0.2", USAGE, "0.6 x 0.5 x 0.2 mm", "no circle", "one diameter"),
    Case("make --sector 7 --part dome --body 0.6", USAGE, "--body = '0.6'", "3 numbers", "give DIAMETERxHEIGHT in mm"),
    Case("make --sector 7 --part block --body 0.6x0.2", USAGE, "--body = '0.6x0.2'", "3 numbers", "LENGTHxWIDTHxHEIGHT"),
    Case("make --sector 7 --part block --body 0.6x0.3x0.2inch", USAGE, "'0.2inch'", "a number in mm", "LENGTHxWIDTHxHEIGHT"),
    Case(
        "make --sector 7 --part block --body nanx0.3x0.2", USAGE, "--body = 'nanx0.3x0.2': nan", "finite", "LENGTHxWIDTHxHEIGHT"
    ),
    Case(
        "make --sector 7 --part block --body 0.6x-0.3x0.2",
        USAGE,
        "--body = '0.6x-0.3x0.2': -0.3 mm",
        "below 0.01 mm",
        "LENGTHxWIDTHxHEIGHT",
    ),
    Case("make --sector 7 --part dome --body 0x0.2", USAGE, "--body = '0x0.2': 0 mm", "below 0.01 mm", "DIAMETERxHEIGHT"),
    Case("make --sector 7 --part block --body 600x300x230", USAGE, "600 mm", "exceeds 20 mm", "each at most 20"),
    Case(
        "make --sector 7 --part block --body 2x2x0.2",
        USAGE,
        "--part = 'block' is larger than its cell",
        "0.748 mm",
        "use --w ",
    ),
    Case(
        "make --sector 7 --part dome --w 0.7",
        USAGE,
        "--part = 'dome' is larger than its cell",
        "0.348 mm",
        "use --w ",
    ),
    Case("make --sector 7 --part dome --dome-top 0.6", USAGE, "0.6 mm", "between 0 and 0.6 mm", "use a smaller top"),
    Case("make --sector 7 --part dome --dome-top 0", USAGE, "0 mm", "above 0 mm", REMEDY),
    Case("make --sector 7 --part block --dome-top 0.2", USAGE, "dome_top_mm", "is for a dome", "leave it out"),
    Case("make --sector 7 --part r0201 --body 1x1x1", USAGE, "--body = '1x1x1'", "contradicts --part = 'r0201'", "--part block"),
    Case("make --sector 7 --dome-top 0.2", USAGE, "--dome-top = 0.2", "contradicts part = 'r0201'", "--part block"),
    Case("make --sector 7 --part dome --size 5x5", USAGE, "5 x 5 mm is too small", "6.7 x 6.6 mm", "use --size 6.7x6.6"),
    Case("make --sector 7 --part dome --fab generic-fpc", USAGE, "--fab = 'generic-fpc'", "contradicts --part", "out --fab"),
    Case("make --sector 7 --part dome --assembly jlcpcb", USAGE, "'jlcpcb'", "contradicts --part", "leave out --assembly"),
    Case("make --sector 7 --part dome --x2 off", USAGE, "x2 = 'off'", "contradicts --part", "leave out --x2"),
    Case("make --sector 7 --part dome --tag strip", USAGE, "--tag = 'strip'", "contradicts --part", "leave out --tag"),
    Case("make --sector 7 --part dome --tag-id 3", USAGE, "--tag-id = 3", "contradicts --part", "leave out --tag-id"),
    Case("make --sector 7 --part dome --no-3d", USAGE, "--no-3d", "contradicts --part", "leave out --no-3d"),
    Case(
        "make --sector 7 --part dome --hole 50,0.8,1",
        RULES,
        "0.300 mm",
        "limit 0.600 mm of sla",
        "use --hole 50,1.1,1 in its place",
    ),
    # process and base
    Case("make --sector 7 --process laser", USAGE, "'laser'", "none of: cnc, ", "path of a .toml file"),
    Case("make --sector 7 --process nowhere.toml", USAGE, "nowhere.toml", "No such file", REMEDY),
    Case("make --sector 7 --process sla --no-3d", USAGE, "--process = 'sla'", "contradicts --no-3d", "give one of them"),
    Case("make --sector 7 --base 0.1", USAGE, "0.1 mm", "below 0.2 mm", "--base is the thickness"),
    Case("make --sector 7 --base 800", USAGE, "800 mm", "exceeds 50 mm", "--base is the thickness"),
    Case("make --sector 7 --base 1 --no-3d", USAGE, "--base = 1", "contradicts --no-3d", "give one of them"),
    Case("make --sector 7 --negative --no-3d", USAGE, "negative", "contradicts --no-3d", "give one of them"),
    Case("make --sector 7 --top half", USAGE, "'half'", "none of", "tiles, single"),
    # cylinder
    Case("make --sector 7 --cylinder 0", USAGE, "0 mm", "above 0 mm", "--cylinder is the radius"),
    Case("make --sector 7 --cylinder 1e9", USAGE, "1e+09 mm", "exceeds 100000 mm", "--cylinder is the radius"),
    Case("make --sector 7 --cylinder 0.5 --size 20x20", USAGE, "0.5 mm", "below", "use a larger --cylinder"),
    Case("make --sector 7 --cylinder 15 --part dome", USAGE, "15 mm", "the largest length that fits is 94.147 mm", "--size"),
    Case("make --sector 7 --cylinder 30 --part dome --hole 50,25,2", USAGE, "holes_mm", "no holes", "leave out --hole"),
    Case(
        "make --sector 7 --cylinder 30 --part dome --corner-radius 2",
        USAGE,
        "2 mm",
        "square corners",
        "leave out --corner-radius",
    ),
    Case("make --sector 7 --around x", USAGE, "around = 'x'", "without a cylinder", "give --cylinder RADIUS"),
    Case("make --sector 7 --shell whole", USAGE, "shell = 'whole'", "without a cylinder", "give --cylinder RADIUS"),
    Case("make --sector 7 --cylinder 30 --around z", USAGE, "around = 'z'", "none of", "x, y"),
    Case("make --sector 7 --cylinder 30 --shell half", USAGE, "shell = 'half'", "none of", "segment, whole"),
    Case("make --sector 7 --cylinder 30 --no-3d", USAGE, "--cylinder = 30", "contradicts --no-3d", "give one of them"),
    # options that are unknown, in this version or at all
    Case("make --sector 7 --no-2d", USAGE, "--no-2d", "No such option", "--help"),
    Case("check --sector 7 -o kit", USAGE, "-o", "No such option", "--help"),
    Case("verify", USAGE, "KIT", "Missing argument", "--help"),
    Case("panel --sector 7", USAGE, "panel", "No such command", "--help"),
    # kits to verify
    Case("verify nowhere", USAGE, "nowhere", "no such file", REMEDY),
    Case("verify .", USAGE, ".", "holds no manifest.json", REMEDY),
    Case(f"verify {LONG}", USAGE, "nnn", "no kit", REMEDY),
    # places to write to
    Case("make --sector 7 -o .", USAGE, "-o = .", "no name for a kit", "give a folder"),
    Case("make --sector 7 -o ..", USAGE, "-o = ..", "no name for a kit", "give a folder"),
    Case("make --sector 7 -o / --overwrite", USAGE, "-o = /", "no name for a kit", "give a folder"),
    Case("make --sector 7 -o kit.partial", USAGE, "kit.partial", "no name for a kit", "give a folder"),
    Case(f"make --sector 7 -o {LONG}", USAGE, "nnn", "File name too long", REMEDY),
    Case(f"make --sector 7 -o new/{LONG[:256]}", FAILED, "nnn", "File name too long", REMEDY),
]


def say(text: str, case: Case) -> bool:
    """Whether one line of an answer says value, limit and remedy."""
    if isinstance(case.remedy, str):
        return any(case.value in line and case.limit in line and case.remedy in line for line in text.splitlines())
    for line in text.splitlines():
        at = max(line.find(case.value) + len(case.value), line.find(case.limit) + len(case.limit))
        if case.value in line and case.limit in line and case.remedy.search(line[at:]):
            return True
    return False


def snapshot(folder: Path) -> dict[str, object]:
    """Everything below a folder: links by target, files by content."""
    return {
        str(p.relative_to(folder)): str(p.readlink()) if p.is_symlink() else p.read_bytes() if p.is_file() else "folder"
        for p in sorted(folder.rglob("*"))
    }


def run(args: str | list[str]) -> Result:
    return CliRunner().invoke(main, shlex.split(args) if isinstance(args, str) else args, prog_name="tactape-fab")


def refuse(folder: Path, case: Case) -> str:
    """Run a command in `folder`, and prove that it was refused as the case says; return what stood on stderr."""
    before = snapshot(folder)
    result = run(case.args)
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code == case.status, result.output
    assert "Traceback" not in result.output
    assert snapshot(folder) == before, "something was written"
    if (
        "No such option" in result.stderr or "No such command" in result.stderr or "Missing argument" in result.stderr
    ):  # click's own, on two lines
        assert case.value in result.stderr
        assert case.limit in result.stderr
        assert str(case.remedy) in result.stderr
    else:
        assert say(result.stderr, case), f"no line says {case.value!r}, {case.limit!r} and a remedy:\n{result.stderr}"
    return result.stderr


@pytest.mark.parametrize("case", OPTIONS, ids=[case.args[:60] for case in OPTIONS])
def test_a_bad_option_is_refused_with_value_limit_and_remedy(case: Case, here: Path) -> None:
    refuse(here, case)


NUMBERS = {
    "--sector": "{}",
    "--w": "{}",
    "--delta": "{}",
    "--size": "100x{}",
    "--origin": "{},0",
    "--tag-id": "{}",
    "--tag-cell": "{}",
    "--rotation": "{}",
    "--corner-radius": "{}",
    "--base": "{}",
    "--cylinder": "{}",
    "--part block --dome-top": "{}",
    "--part block --body": "0.6x0.3x{}",
    "--hole": "50,25,{}",
}


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999", "1e12", "-500", "wide", ""])
@pytest.mark.parametrize("option", NUMBERS)
def test_no_option_takes_what_is_no_sensible_number(option: str, value: str, here: Path) -> None:
    key, form = option.rsplit(maxsplit=1)[-1], NUMBERS[option]
    shown = {"1e12": "1", "1e999": "inf", "wide": "'wide'", "": "''"}.get(value, value)
    if value == "" and option in ("--size", "--part block --body"):
        shown = repr(form.format(""))
    sector = "" if option == "--sector" else "--sector 7"
    typed = form.format(value)
    if typed != value and shown != repr(typed):
        shown = f"{typed!r}: {shown}"
    result = run(f"make {sector} {option}='{typed}'")
    assert result.exit_code == USAGE, repr(result.exception)
    assert re.search(rf"^error: {re.escape(f'{key} = {shown}')}[^;]* (is|exceeds) [^;]+; \S", result.stderr, re.MULTILINE)
    assert list(here.iterdir()) == []


# Everything at once


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ("--sector 300 --w nan --size 10x --tag round", ["--sector = 300", "--w = nan", "--size = '10x'", "--tag = 'round'"]),
        ("--sector 300 --delta 0.7 --coverlay per-part", ["--sector = 300", "pad-pad: ", "body-body: ", "opening-bridge: "]),
        (
            "--sector 7 --delta 0.7 --coverlay per-part --fab nowhere.toml",
            ["nowhere.toml cannot be opened", "pad-pad: ", "opening-bridge: "],
        ),
        ("--sector 7 --part r9 --fab acme --code qr", ["--part = 'r9'", "--fab = 'acme'", "--code = 'qr'"]),
        ("--sector 7 --part dome --fab acme --base 0", ["--fab = 'acme' contradicts", "--base = 0 mm"]),
        ("--sector 300 --part dome --cylinder 15", ["--sector = 300", "the largest length that fits is 94.147 mm"]),
        ("--sector 7 --delta 0.7 --cylinder 15", ["the tape would overlap itself", "pad-pad: ", "body-body: "]),
        ("--sector 7 --process laser --no-3d --negative", ["--process = 'laser'", "--negative contradicts --no-3d"]),
        ("--sector 7 --part r9 --body nanx1x1 --base nan", ["--part = 'r9'", "--base = nan"]),
        ("--sector 300 --fab nowhere.toml", ["--sector = 300", "nowhere.toml cannot be opened"]),
        ("--sector 300 --size 5x5", ["--sector = 300", "5 x 5 mm is too small"]),
        ("--sector 7 --size 5000x40 --corner-radius 10", ["--origin", "--corner-radius = 10 mm cuts into the tag"]),
        (
            "--sector 7 --delta 0.7 --coverlay per-part -o taken",
            ["-o = taken exists already", "pad-pad: ", "opening-bridge: "],
        ),
        ("--sector 7 --w nan -o taken", ["-o = taken exists already", "--w = nan"]),
    ],
)
def test_all_findings_come_together(args: str, said: list[str], here: Path) -> None:
    (here / "taken").mkdir()
    result = run(f"make {args}")
    assert result.exit_code == USAGE
    assert [text for text in said if text not in result.stderr] == []
    assert [path.name for path in here.rglob("*")] == ["taken"]


def test_a_tape_larger_than_its_code_is_a_capacity_error() -> None:
    from tactape_fab import TapeSpec

    with pytest.raises(CapacityError, match="the reach of code 'microdots-4x4'"):
        TapeSpec(sector=7, size_mm=(5600.0, 50.0))
    with pytest.raises(SpecError) as caught:
        TapeSpec(sector=300, size_mm=(5600.0, 50.0))
    assert not isinstance(caught.value, CapacityError)


@pytest.mark.parametrize(
    ("args", "remedy"),
    [
        ("--sector 7 --size 5000x30", "--origin 47,0"),
        ("--sector 7 --size 5600x50", "--code debruijn-4x4"),
        ("--sector 7 --size 5x5", "--size 13x7.7"),
        ("--sector 7 --size 5x5 --tag none", "--size 7.7x7.7"),
        ("--sector 900 --code anoto-6x6", "--tag-id 5"),
        ("--sector 7 --corner-radius 3", "--tag none"),
        ("--sector 7 --part dome --size 5x5", "--size 6.7x6.6"),
        ("--sector 7 --part dome --cylinder 15", "--size 94x50"),
        ("--sector 7 --part dome --body 0.6x0.3", "--dome-top 0.3"),
    ],
)
def test_the_remedy_of_a_message_helps(args: str, remedy: str, here: Path) -> None:
    assert run(f"check {args}").exit_code == USAGE
    assert run(f"check {args} {remedy}").exit_code == 0


# Spec files

SPEC_FILES = [
    Case("nowhere.toml", USAGE, "nowhere.toml", "No such file", REMEDY),
    Case("folder.toml", USAGE, "folder.toml", "no regular file", REMEDY),
    Case("binary.toml", USAGE, "binary.toml", "is not TOML", REMEDY),
    Case("open.toml", USAGE, "open.toml", "is not TOML", REMEDY),
    Case("deep.toml", USAGE, "deep.toml", "is not TOML: it is nested too deep", REMEDY),
    Case("large.toml", USAGE, "large.toml", "1048576 bytes", "it is not a spec or profile"),
    Case("empty.toml", USAGE, "sector", "is missing", "sector = N in the TOML file"),
    Case("near.toml", USAGE, "pitchmm", "not a known key", "did you mean 'pitch_mm'?"),
    Case("far.toml", USAGE, "zzz", "not a known key", "known are: sector, pitch_mm"),
    Case("true.toml", USAGE, "sector = True", "whole number", "256 sectors"),
    Case("text.toml", USAGE, "sector = '7'", "whole number", "256 sectors"),
    Case("half.toml", USAGE, "sector = 7.5", "whole number", "256 sectors"),
    Case("nan.toml", USAGE, "pitch_mm = nan", "0.2 to 20", PITCH),
    Case("inf.toml", USAGE, "size_mm[0] = inf", "finite number", SIZE),
    Case("sizes.toml", USAGE, "size_mm = '100x50'", "2 numbers", SIZE),
    Case("table.toml", USAGE, "origin = {'a': 1}", "2 whole numbers", ORIGIN),
    Case("holes.toml", USAGE, "holes_mm = 3", "a list", REMEDY),
    Case("date.toml", USAGE, "tag = 1979-05-27", "a text", REMEDY),
    Case("zero.toml", USAGE, "fab = ", "cannot be opened", REMEDY),
]
CONTENTS: dict[str, str | bytes] = {
    "binary.toml": bytes(range(256)),
    "open.toml": "sector = [[",
    "deep.toml": "a = " + "[" * 5000 + "]" * 5000,
    "large.toml": "sector = 7\n" + "#" * 2_000_000,
    "empty.toml": "",
    "near.toml": "sector = 7\npitchmm = 1.5\n",
    "far.toml": "sector = 7\nzzz = 1\n",
    "true.toml": "sector = true\n",
    "text.toml": "sector = '7'\n",
    "half.toml": "sector = 7.5\n",
    "nan.toml": "sector = 7\npitch_mm = nan\n",
    "inf.toml": "sector = 7\nsize_mm = [inf, 1e400]\n",
    "sizes.toml": "sector = 7\nsize_mm = '100x50'\n",
    "table.toml": "sector = 7\norigin = {a = 1}\n",
    "holes.toml": "sector = 7\nholes_mm = 3\n",
    "date.toml": "sector = 7\ntag = 1979-05-27\n",
    "zero.toml": 'sector = 7\nfab = "a\\u0000.toml"\n',
}


@pytest.mark.parametrize("case", SPEC_FILES, ids=[case.args for case in SPEC_FILES])
def test_a_bad_spec_file_is_refused(case: Case, here: Path) -> None:
    (here / "folder.toml").mkdir()
    content = CONTENTS.get(case.args)
    if content is not None:
        (here / case.args).write_bytes(content if isinstance(content, bytes) else content.encode())
    refuse(here, case._replace(args=f"make {case.args}"))


# Profiles

PROFILES = [
    # kind, text to replace in the profile that comes with the package, its replacement; value, limit, remedy
    ("fabs", r"\[limits.pad-pad\][^\[]*", "", "limits.pad-pad", "is missing", REMEDY),
    ("fabs", "value_mm = 0.10\n", "value_mm = -0.10\n", "limits.pad-pad.value_mm = -0.1 mm", "below 0 mm", REMEDY),
    ("fabs", "value_mm = 0.10\n", "value_mm = nan\n", "limits.pad-pad.value_mm = nan", "finite", REMEDY),
    ("fabs", "value_mm = 0.10\n", "value_mm = '0.1'\n", "limits.pad-pad.value_mm = '0.1'", "a number in mm", REMEDY),
    ("fabs", "value_mm = 0.10\n", "", "limits.pad-pad.value_mm", "is missing", "give a number in mm"),
    ("fabs", "value_mm = 0.10\n", "value_mm = 0.10\nvalue_um = 3\n", "limits.pad-pad.value_um", "known key", "did you mean"),
    ("fabs", "confirmed = false", "confirmed = 'no'", "anchor.confirmed = 'no'", "true nor false", REMEDY),
    ("fabs", 'level = "block"', 'level = "stop"', "limits.pad-pad.level = 'stop'", "none of", "block, warn, info"),
    ("fabs", r"\[limits.pad-pad\]", "[limits.pad-pads]", "limits.pad-pads", "known key", "did you mean 'pad-pad'?"),
    ("fabs", 'title = "', 'titel = "', "titel", "known key", "did you mean 'title'?"),
    ("fabs", 'legend = "white"', 'legend = "pink"', "colours.legend = 'pink'", "none of", "white, black"),
    ("fabs", '"{name}.gtl"', '"../{name}.gtl"', "'../{name}.gtl'", "cannot be used", "give a file name"),
    ("fabs", '"{name}.gtl"', '"{name}.gts"', "files.copper-top and coverlay-top = '{name}.gts'", "one file", "a name of its own"),
    ("fabs", '"{name}.gtl"', '"{name}.GTS"', "files.copper-top and coverlay-top = '{name}.GTS'", "one file", "a name of its own"),
    ("fabs", "layers = 1", "layers = 1.5", "material.layers = 1.5", "whole number", REMEDY),
    ("fabs", r"(?s).*", "", "limits", "is missing", REMEDY),
    ("fabs", "web_mm = 0.1\n", "web_mm = -0.1\n", "anchor.web_mm = -0.1 mm", "above 0 mm", REMEDY),
    ("fabs", "overlap_mm = 0.15\n", "", "anchor.overlap_mm", "is missing", "give a number in mm"),
    ("fabs", r"\[anchor\]", "[anchors]", "anchors", "known key", "did you mean 'anchor'?"),
    (
        "fabs",
        'modes = ["per-part", "gang"]',
        'modes = ["per-part", "lpi"]',
        "coverlay.modes",
        "both 'per-part' and 'lpi'",
        REMEDY,
    ),
    ("fabs", 'modes = ["per-part", "gang"]', 'modes = ["per part"]', "'per part'", "none of", "correct it"),
    ("fabs", 'modes = ["per-part", "gang"]', "modes = []", "coverlay.modes = []", "one mode or more", "correct it"),
    ("fabs", 'modes = ["per-part", "gang"]', "modes = 3", "coverlay.modes = 3", "not a list", "give a list"),
    ("fabs", '"PI 0.1"', '"PI-0.1"', "stiffener.choices holds 'PI-0.1'", "thickness in mm", REMEDY),
    ("fabs", "least_thicknesses = 10.0", "least_thicknesses = 0", "bend.least_thicknesses = 0", "above 0", REMEDY),
    ("fabs", r"smallest_mm = \[70.0, 70.0\]", "smallest_mm = [300, 70]", "panel.largest_mm = ", "smaller than", "correct one"),
    ("fabs", "warn_mm = 0.15", "warn_mm = 0.05", "limits.pad-pad.warn_mm = 0.05 mm", "0.1 mm", "leave it out"),
    ("fabs", "_{material}.gbr", ".gbr", "files.stiffener-bottom", "cannot be used", "letters and digits, with {name}"),
    ("fabs", "job_in_zip = true", "job_in_zip = 1", "gerber.job_in_zip = 1", "true nor false", REMEDY),
    ("fabs", "most = 300", "most = 0", "parts.most = 0", "outside 1 to", REMEDY),
    ("fabs", "thickness_mm = 0.10", "thickness_mm = 0", "stencil.thickness_mm = 0 mm", "above 0 mm", REMEDY),
    ("fabs", r"(?s).*", "[[", "mine.toml", "is not TOML", REMEDY),
    ("fabs", r"(?s).*", "#" * 2_000_000, "mine.toml", "1048576 bytes", "it is not a spec or profile"),
    ("processes", r"\[limits.gap\][^\[]*", "", "limits.gap", "is missing", REMEDY),
    ("processes", "value_mm = 0.30\n", "value_mm = -0.30\n", "limits.feature.value_mm = -0.3 mm", "below 0 mm", REMEDY),
    ("processes", r"\[limits.gap\]", "[limits.gaps]", "limits.gaps", "known key", "did you mean 'gap'?"),
    ("processes", 'title = "', 'titel = "', "titel", "known key", "did you mean 'title'?"),
    ("elements", "0.60, 0.60, 0.23", "0.60, 0.60, 0.30", "0.6 x 0.3 mm", "below its radius 0.3 mm", "use a lower dome"),
    ("elements", "0.60, 0.60, 0.23", "0.60, 0.50, 0.23", "0.6 x 0.5 x 0.23 mm", "no circle", "give it"),
    ("elements", "0.60, 0.60, 0.23", "0.60, 0.60, -1", "body.size_mm[2] = -1 mm", "below 0.01 mm", REMEDY),
    ("elements", "0.60, 0.60, 0.23", "0.60, 0.60, nan", "body.size_mm[2] = nan", "finite", REMEDY),
    ("elements", 'shape = "dome"', 'shape = "ball"', "shape = 'ball'", "none of", "block, dome"),
    ("elements", "tolerance_mm = 0.0", "top_mm = 0.7\ntolerance_mm = 0.0", "top_mm = 0.7 mm", "0.6 mm", "use a smaller top"),
    ("elements", "[body]", "value = '1R'\n[body]", "value", "known key", REMEDY),
    ("elements", r"(?s)\[body\].*", "[pads]\nsize_mm = [1, 1]\n", "pads.offset_mm", "is missing", REMEDY),
    ("parts", "0.60, 0.30", "-0.60, nan", "body.size_mm[0] = -0.6 mm", "below 0.01 mm", REMEDY),
    ("parts", '"block"', '"dome"', "shape = 'dome'", "none of", "block"),
    ("parts", "offset_mm = 0.32", "offset_mm = 0.1", "pads.offset_mm = 0.1 mm", "0.23 mm", "must not touch"),
    ("parts", 'value = "0R"', 'value = "a;b"', "value = 'a;b'", "cannot be used", "use plain letters"),
    ("parts", r"(?s)\[courtyard\].*", "", "courtyard", "is missing", REMEDY),
]
SOURCES = {
    "fabs": ("fabs", "generic-fpc", "fab"),
    "parts": ("parts", "r0201", "part"),
    "elements": ("parts", "dome", "part"),
    "processes": ("processes", "sla", "process"),
}
"""Folder and name of the profile that is changed, and the option that names it."""


@pytest.mark.parametrize(("kind", "old", "new", "value", "limit", "remedy"), PROFILES, ids=[f"{p[0]} {p[3]}" for p in PROFILES])
def test_a_bad_profile_is_refused(
    kind: str, old: str, new: str, value: str, limit: str, remedy: str | re.Pattern[str], here: Path
) -> None:
    folder, name, option = SOURCES[kind]
    source = (templates_folder() / folder / f"{name}.toml").read_text(encoding="utf-8")
    pattern = old if any(mark in old for mark in ("(?s)", r"\[")) else re.escape(old)
    changed, count = re.subn(pattern, lambda _: new, source, count=1)
    assert count == 1
    (here / "mine.toml").write_text(changed, encoding="utf-8")
    refuse(here, Case(f"make --sector 7 --{option} mine.toml", USAGE, value, limit, remedy))


def test_a_profile_that_cannot_be_read_is_refused(here: Path) -> None:
    (here / "folder.toml").mkdir()
    (here / "binary.toml").write_bytes(bytes(range(256)))
    for name, reason in (("nowhere", "No such file"), ("folder", "no regular file"), ("binary", "is not TOML")):
        for option in ("fab", "part", "process"):
            refuse(here, Case(f"make --sector 7 --{option} {name}.toml", USAGE, f"{option} = {name}.toml", reason, REMEDY))


# Places that are taken


@pytest.mark.parametrize(
    ("args", "status", "value", "limit", "remedy"),
    [
        ("-o file", USAGE, "-o = file", "is not a folder", "use -o to name another folder"),
        ("-o file/kit", USAGE, "-o = file/kit", "file is there and is no folder", "use -o to name another one"),
        ("-o file --overwrite", USAGE, "-o = file", "is not a folder", "use -o to name another folder"),
        ("-o file/a/kit", USAGE, "-o = file/a/kit", "file is there and is no folder", "use -o to name another one"),
        ("-o foreign", USAGE, "-o = foreign", "exists already", DEEPER),
        ("-o foreign --overwrite", USAGE, "-o = foreign", "is no kit of this tool", "nothing was touched; use -o"),
        ("-o empty --overwrite", USAGE, "-o = empty", "is no kit of this tool", "nothing was touched; use -o"),
        ("-o link", USAGE, "-o = link", "is not a folder", "use -o to name another folder"),
        ("-o link --overwrite", USAGE, "-o = link", "is not a folder", "use -o to name another folder"),
        ("-o dangling", USAGE, "-o = dangling", "is not a folder", "use -o to name another folder"),
        ("-o dangling --overwrite", USAGE, "-o = dangling", "is not a folder", "use -o to name another folder"),
        ("-o kit", USAGE, "-o = kit", "exists already", "use --overwrite"),
        ("-o kit --overwrite", USAGE, "-o = kit holds notes.txt", "manifest does not list", "nothing was touched; use -o"),
        ("-o hidden --overwrite", USAGE, "-o = hidden holds .git", "manifest does not list", "nothing was touched; use -o"),
        ("-o linked --overwrite", USAGE, "-o = linked holds gerber", "manifest does not list", "nothing was touched; use -o"),
    ],
)
def test_what_is_not_ours_is_not_replaced(
    args: str, status: int, value: str, limit: str, remedy: str | re.Pattern[str], here: Path, small_kit: Kit
) -> None:
    (here / "file").write_text("mine")
    (here / "foreign").mkdir()
    (here / "foreign" / "thesis.txt").write_text("mine")
    (here / "empty").mkdir()
    (here / "dangling").symlink_to("gone")
    for name in ("kit", "hidden", "linked", "whole"):
        shutil.copytree(small_kit.path, here / name)
    (here / "link").symlink_to("whole")
    (here / "kit" / "notes.txt").write_text("mine")
    (here / "hidden" / ".git").write_text("mine")
    (here / "linked" / "gerber").rename(here / "gerbers")
    (here / "linked" / "gerber").symlink_to(here / "gerbers")
    refuse(here, Case(f"make --sector 7 {args}", status, value, limit, remedy))


@pytest.mark.parametrize("with_manifest", [False, True])
def test_a_home_folder_given_by_mistake_survives(
    with_manifest: bool, here: Path, small_kit: Kit, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = here / "home"
    if with_manifest:
        shutil.copytree(small_kit.path, home)
    (home / ".ssh").mkdir(parents=True)
    (home / ".ssh" / "known_hosts").write_text("mine")
    (home / "thesis.txt").write_text("mine")
    monkeypatch.setenv("HOME", str(home))
    limit = "manifest does not list" if with_manifest else "is no kit of this tool"
    refuse(here, Case(f"make --sector 7 -o {home} --overwrite", USAGE, f"-o = {home}", limit, "nothing was touched; use -o"))
    monkeypatch.chdir(home)
    refuse(here, Case("make --sector 7 -o . --overwrite", USAGE, "-o = .", "no name for a kit", "give a folder"))


@pytest.mark.parametrize("text", ["tomorrow", "-1", "1e9", "1_0", " 7", "\u0667", "99999999999999999999", "", "nan"])
def test_a_build_date_that_is_no_number_of_seconds_is_refused(text: str, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", text)
    case = Case("make --sector 7 --size 20x20", USAGE, f"SOURCE_DATE_EPOCH = {text!r}", "since 1970", "correct it or unset it")
    refuse(here, case)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("\x00{{", "cannot be read as JSON"),
        ("[1]", "this version reads 'tactape-manifest/1'"),
        ('{"format": "tactape-manifest/0"}', "has format 'tactape-manifest/0'"),
        ('{"format": "tactape-manifest/1"}', "sector is missing"),
        ("[" * 20_000, "cannot be read as JSON"),
    ],
)
def test_a_file_that_is_no_manifest_fails_the_verification(content: str, said: str, here: Path) -> None:
    (here / "kit").mkdir()
    (here / "kit" / "manifest.json").write_text(content)
    for path in ("kit", "kit/manifest.json"):
        refuse(here, Case(f"verify {path}", VERIFICATION, "error: manifest: ", said, re.compile("")))


# The same as real processes


@pytest.mark.parametrize(
    ("args", "status", "said"),
    [
        ("make --sector 7 --w nan", USAGE, "--w = nan mm is not a finite number"),
        ("make --sector 7 --delta 0.7", RULES, "pad-pad: gap between pads of two parts -0.329 mm"),
        ("make nowhere.toml", USAGE, "nowhere.toml cannot be opened"),
        ("make --sector 300 --delta 0.7", USAGE, "--sector = 300 is outside 0 to 255"),
        ("verify nowhere", USAGE, "nowhere is no kit"),
    ],
)
def test_a_refused_process_says_why_on_stderr_only(args: str, status: int, said: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tactape_fab", *args.split()], cwd=tmp_path, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == status
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []
