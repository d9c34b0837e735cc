"""Thirty wrong inputs with their messages: each names the option as it was typed, the value, the limit and what to do."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from tactape_fab import Kit
from tactape_fab.base.templates import profile_names
from tactape_fab.cli import main
from tactape_fab.cli.options import degrees, hertz, kilopascals, length, micrometres, newtons, per_inch, seconds
from tests.tapes import tape_at

FORMAT = {"format": "tactape-manifest/1"}
OPTION_KEY = re.compile(r"\b\w+_(mm|deg|px|um)\b")
WRONG = {
    "make 7": "SPEC.toml = 7 is no file; did you mean --sector 7?",
    "make": "sector is missing; give --sector N",
    "make --sector 300": "--sector = 300 is outside 0 to 255",
    "make --sector 7 --dry-run": "No such option '--dry-run'. tactape-fab check measures, and writes nothing",
    "make --sector 7 --w 1.5in": "--w = '1.5in' is not a number in mm",
    "make --sector 7 --delta 0.75": "--delta = 0.75 mm is not below 0.75 mm",
    "make --sector 7 --size 0x50": "--size = '0x50': 0 mm is not above 0 mm; give WIDTHxHEIGHT",
    "make --sector 7 --size 5x5": "mm is too small: a strip with a tag and one 4x4 window",
    "make --sector 7 --hole 50,25": "--hole = '50,25' is not 3 numbers; give X,Y,DIAMETER in mm",
    "make --sector 7 --corner-radius 99": "--corner-radius = 99 mm exceeds 25 mm; give at most half the shorter side",
    "make --sector 7 --origin 5": "--origin = '5' is not 2 whole numbers; give --origin COL,ROW",
    "make --sector 7 --tag qr": "--tag = 'qr' is none of: strip, none; give one of them",
    "make --sector 7 --tag none --tag-id 3": "--tag-id = 3 contradicts --tag = 'none'; give one of them",
    "make --sector 7 --body 3": "--body = '3' contradicts part = 'r0201', whose size is fixed; use --part block",
    "make --sector 7 --bend-radius 20": "--bend-radius = 20 has no effect alone; give --bend-axis x or y too",
    "make --sector 7 --panel 0x2": "--panel = 0x2 has 0 columns and 2 rows; give 1 to 100 of each",
    "make --sector 7 -o .": "-o = . is no name for a kit; give a folder",
    "check --sector 7 --fab jlcpcb": "did you mean 'jlcpcb-fpc'?",
    "check --sector 7 --part Dome": "did you mean 'dome'?",
    "check --sector 7 --part 0805": "chips that come with it are c0201, ",
    "check --sector 7 --code anoto": "did you mean 'anoto-6x6'?",
    "check nowhere.toml": "nowhere.toml cannot be opened",
    "verify nowhere": "nowhere is no kit: there is no such file; give the folder of a kit or its manifest.json",
    "verify nowhere --contact 0x5": "--contact = '0x5' is below 0.1 mm; give a larger contact",
    "verify nowhere --quick --map map.png": "leave out --quick, or --map",
    "decode frames.npz": "no tape is given; name the kits that can be touched with --tape",
    "registry nowhere": "nowhere is no kit: there is no such file",
    "profiles nofab": f"'nofab' is none of: {', '.join(profile_names('fabs'))}",
    "advise --contact nan": "--contact = nan mm is not a finite number; give --contact MM, such as 6",
    "advise --contact 6 --blur 9": "--blur = 9 mm exceeds",
}
AS_TYPED = {
    "doctor --sensor frames.npz --like nope": "--like = 'nope' is none of: ",
    "calibrate frames.npz --tape nowhere --like nope -o s.toml": "--like = 'nope' is none of: ",
    "simulate nowhere -o a.npz --contact-model elastic --force 2kg": "--force = '2kg' is not a number in N; give a number",
    "simulate nowhere -o a.npz --contact-model elastic --tilt 3": "--tilt = '3' is not 2 numbers; give the tilts along",
    "simulate nowhere -o a.npz --contact-model elastic --tilt 3,40": "--tilt = '3,40': 40 deg exceeds 20 deg; give the tilts",
    "simulate nowhere -o a.npz --contact-model elastic --gel-thickness 0": "--gel-thickness = 0 mm is below 0.1 mm",
    "simulate nowhere -o a.npz --contact-model elastic --elastomer 9": "--elastomer = 9 mm exceeds 5 mm",
    "simulate nowhere -o a.npz --cylinder 0.1": "--cylinder = 0.1 mm is below 0.5 mm",
    "simulate nowhere -o a.npz --contact 6": "--contact = '6' is not 2 numbers; give both axes, each at most 1000 mm: 11x9",
    "simulate nowhere -o a.npz --pose 1,2": "--pose = '1,2' is not 3 numbers; give X,Y,THETA in mm and degrees",
    "simulate nowhere -o .npz": "-o = .npz is an ending without a name; give a name before it",
    "verify nowhere --contact 6": "--contact = '6' is not 2 numbers; give both axes, each at most 1000 mm: 11x9",
    "check --sector 7 --w 0.2 --size 400x400": "--size = 400 x 400 mm gives 1960 x 1987 grid points",
    "check --sector 587 --size 601x30 --w 0.2 --code touch-1": "reach of code 'touch-1' at pitch 0.2 mm; use --code anoto-6x6",
    "check --sector 7 --directions 8 --delta 0.25": "more than 1 %; use --w 2 --delta 0.34, or --directions 4, or a",
    "make --sector \u0667": "--sector = '\u0667' is not a whole number",
    "make --sector 7 --w \uff12": "--w = '\uff12' is not a number in mm",
    "make --sectors 1-3 --tabs x": "--tabs = 'x' is of a panel, and these tapes are made one by one; leave it out",
    "make --sectors 1-3 --same-sector": "--same-sector is of a panel, and these tapes are made one by one; leave it out",
}
"""Others, of which an answer once named a key of the package, or a remedy that is refused in its turn."""


OF_A_KIT = {
    "simulate {kit} -o a.npz --contact-model nope --noise-model nope --noise 1e9 --placement -3 --elastomer -1 --k1-error 7": [
        "--contact-model = 'nope'", "--elastomer = -1 mm", "--noise = 1e+09", "--placement = -3 mm", "--k1-error = 7",
        "--noise-model = 'nope'",
    ],
    "simulate {kit} -o a.npz --cylinder 5 --contact 3x3 --force 2 --noise -1": [
        "--force is of an elastic contact", "--cylinder contradicts --contact = '3x3'", "--noise = -1",
    ],
    "simulate {kit} -o a.npz --contact-model elastic --contact 3x3 --force -1N --tilt 99deg,0": [
        "--contact contradicts --contact-model = 'elastic': its", "99 deg exceeds 20 deg", " = -1 N is below 0.01 N",
    ],
    "simulate {kit} -o a.npz --as-built a.json --gel-thickness 3 --markers": [
        "--as-built = 'a.json' names measured places", "--gel-thickness is of an elastic contact; add", "--markers is of an",
    ],
    "decode f.npz --code microdots-4x4 --method paper --refine dots": [
        "--code = 'microdots-4x4': method 'paper' needs tapes, bounds nothing and takes its scale as it is; give the kits with "
        "--tape instead, or give --method ml", "--refine = 'dots': method 'paper'", "f.npz cannot be read",
    ],
    "survey f.npz --tape {kit} -o a.json --workers 0 --sensor nope": ["--workers = 0", "--sensor = 'nope'"],
    "emboss {kit} no.stl --at 0,0 --up 0,0,0 --unit ft --face -1": [
        "--face = -1", "--at = '0,0'", "--up = 0,0,0 is no direction", "--unit = 'ft'", "SURFACE = no.stl cannot be read",
    ],
    "emboss {kit} no.txt --unit ft -o .": ["--unit = 'ft'", "SURFACE = no.txt is none of", "-o = . is no name"],
    "advise --contact nan --size 0x50 --process foo --fab bar --sensor nope": [
        "--contact = nan", "--process = 'foo'", "--size = '0x50': 0 mm", "--sensor = 'nope'", "--fab = 'bar'",
    ],
    "ros2 --tape nope --sensor x --package No": ["No is no name of a ROS package", "nope is no kit", "--sensor = 'x'"],
    "ros2 --tape nope --package pp": ["nope is no kit"],
    "simulate {kit} -o a.npz --cylinder 0.5": [
        "--cylinder = 0.5 mm is below 1.1 mm, 10 times the 0.11 mm of its film, which bears no more; use --cylinder 1.1",
    ],
    "simulate {kit} -o a.npz --count 1e3": [
        "--count = 1000.0 is not a whole number, as it is written with a point or an exponent; give 1000",
    ],
    "decode - --tape {kit}": ["- is no file of frames; for arrays on standard input use watch -"],
    "decode a.npz {kit}": ["no tape is given; name the kits", "a.npz cannot be", " is a kit, no file of frames; use --tape "],
    "survey f.npz --tape {kit} -o a.json --from no.json": ["--from = no.json cannot be read: No such file", "f.npz cannot be"],
    "inspect nope.png --tape {kit} -o a.json --tolerance 50": ["--tolerance = 50 mm is not from 0.001 to 10 mm"],
    "inspect nope.png --tape {kit} -o a.json": ["SCAN = nope.png cannot be read: No such file or directory; give a scan"],
    "check --sector 7 --size 0x0": ["--size = '0x0': 0 mm is not above 0 mm"],
    "check --sector 7 --origin 4000,4000": ["--origin = '4000,4000': 4000 is outside 0 to 3374"],
}  # fmt: skip


@pytest.mark.parametrize(("command", "said"), OF_A_KIT.items(), ids=OF_A_KIT)
def test_all_that_is_wrong_is_said_once_and_together(command: str, said: list[str], default_kit: Kit, here: Path) -> None:
    result = CliRunner().invoke(main, shlex.split(command.format(kit=default_kit.path)), prog_name="tactape-fab")
    assert (result.exit_code, result.stdout) == (2, ""), result.exception
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == len(said) and all(any(text in line for line in lines) for text in said), lines
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("read", "texts"),
    [(newtons, ("2N", "2 N", "2")), (degrees, ("45deg", "45")), (hertz, ("100Hz", "100hz")), (micrometres, ("5um", "5µm", "5")),
     (per_inch, ("600dpi", "600")), (kilopascals, ("200kPa",)), (seconds, ("3s",)), (length, ("2mm", "2 mm", "2"))],
)  # fmt: skip
def test_a_number_may_have_its_own_unit(read: Callable[[str], object], texts: tuple[str, ...]) -> None:
    assert {read(text) for text in texts} == {read(texts[-1])} and isinstance(read(texts[0]), int)
    assert (read("2in"), read("max")) == ("2in", "max")


def test_a_list_of_too_many_tapes_is_refused_before_they_are_looked_at(here: Path) -> None:
    Path("many.toml").write_text("[[tapes]]\nsector = 300\n" * 4097)
    result = CliRunner().invoke(main, ["make", "many.toml", "-o", "kits"], prog_name="tactape-fab")
    assert result.exit_code == 2
    assert result.stderr.splitlines() == ["error: tapes = 4097 tables, more than 4096; make them in several runs"]


def test_what_cannot_be_written_names_the_option_and_the_remedy(
    default_kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(zipfile, "ZipFile", refuse)
    monkeypatch.setattr(Path, "mkdir", refuse)
    for command, said in {
        f"simulate {default_kit.path} -o a.npz": "-o = a.npz cannot be written: Permission denied; what stood there is as it was",
        "ros2 --package pp": "--package = pp cannot be written: Permission denied; give a folder elsewhere",
    }.items():
        result = CliRunner().invoke(main, shlex.split(command), prog_name="tactape-fab")
        assert result.exit_code == 1 and said in result.stderr, result.stderr


def test_a_cpl_of_other_parts_is_refused_and_one_of_fewer_said(default_kit: Kit, here: Path) -> None:
    shutil.copytree(default_kit.path, "kit")
    (cpl,) = Path("kit").rglob("*-cpl.csv")
    cpl.write_bytes(cpl.read_bytes().replace(b"\nR1,", b"\nX1,", 1))
    result = CliRunner().invoke(main, ["simulate", "kit", "-o", "a.npz", "--from", "cpl"], prog_name="tactape-fab")
    assert result.exit_code == 2
    assert "cpl names 'X1', which is no part of the tape (1 of " in result.stderr
    cpl.write_bytes(b"\n".join(line for line in cpl.read_bytes().split(b"\n") if not line.startswith(b"X1,")))
    result = CliRunner().invoke(main, ["simulate", "kit", "-o", "a.npz", "--from", "cpl"], prog_name="tactape-fab")
    assert result.exit_code == 0
    assert "warning: the pick-and-place file leaves out 1 part; the frames lack them" in result.stderr


def test_there_are_thirty() -> None:
    assert len(WRONG) == 30


@pytest.mark.parametrize(("command", "said"), [*WRONG.items(), *AS_TYPED.items()], ids=[*WRONG, *AS_TYPED])
def test_a_wrong_input_is_answered_as_it_was_typed(command: str, said: str, here: Path) -> None:
    result = CliRunner().invoke(main, shlex.split(command), prog_name="tactape-fab")
    assert (result.exit_code, result.stdout) == (2, ""), result.exception
    lines = [line for line in result.stderr.splitlines() if line.lower().startswith("error: ")]
    assert [line for line in lines if said in line], lines
    assert [line for line in lines if OPTION_KEY.search(line)] == []
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("check --sector 7 --name foo --fab mine.toml", "fab mine: name = 5 is not a text"),
        ("check --sector 7 --name foo --part mine.toml", "part mine: name = 5 is not a text"),
        ("coupon --name foo --fab mine.toml", "fab mine: name = 5 is not a text"),
        ("check --sector 7 --code touch-1 --avoid code", "code: code = 'zz' is none of"),
        ("decode frames.npz --tape code --code touch-1", "code: code = 'zz' is none of"),
    ],
)
def test_the_keys_of_a_file_stay(command: str, said: str, here: Path) -> None:
    Path("mine.toml").write_text('extends = "generic-fpc"\nname = 5\n')
    Path("code").mkdir()
    Path("code/manifest.json").write_text(json.dumps({**tape_at(7, (6, 5)).to_mapping(), **FORMAT, "code": "zz"}))
    result = CliRunner().invoke(main, shlex.split(command), prog_name="tactape-fab")
    assert result.exit_code == 2
    assert [line for line in result.stderr.splitlines() if line.startswith(f"error: {said}")], result.stderr


@pytest.mark.parametrize(
    ("options", "leave_out"),
    [("--sectors 1-4 --panel 1x3", "panel"), ("--sector 1 --panel none --tabs x", "tabs"), ("--sector 1 --tabs x", "tabs")],
)
def test_no_remedy_names_a_panel_for_what_goes_on_none(options: str, leave_out: str) -> None:
    result = CliRunner().invoke(main, shlex.split(f"check {options} --part cone --w 1.7"))
    assert result.exit_code == 2
    assert f"; leave out --{leave_out}\n" in result.stderr
    assert "--panel auto" not in result.stderr and "give --panel" not in result.stderr


def test_a_size_that_is_named_holds_the_tag_in_its_corners() -> None:
    command = "check --sector 1 --tag-cell 2 --rotation 30 --w 0.9"
    refused = CliRunner().invoke(main, shlex.split(f"{command} --size 5x5 --coverlay lpi"))
    found = re.search(r"or (--fab generic-lpi --w [\d.]+ --delta [\d.]+ --size [\d.x]+)", refused.stderr)
    assert found is not None
    assert CliRunner().invoke(main, shlex.split(f"{command} --coverlay lpi {found[1]}")).exit_code == 0


def test_of_many_problems_the_first_are_printed_and_the_rest_counted(here: Path) -> None:
    Path("many.toml").write_text("".join(f"[[tapes]]\nsector = {k}\npitch_mm = -1\n" for k in range(300)))
    result = CliRunner().invoke(main, ["make", "many.toml"], prog_name="tactape-fab")
    lines = result.stderr.splitlines()
    assert result.exit_code == 2 and len(lines) == 201
    assert lines[-1].startswith("error: ") and lines[-1].endswith(" more problems; correct these first")


OF_A_FILE = {
    'fab = "generic-fpc"\npart = "dome"': "error: fab = 'generic-fpc' contradicts part = 'dome', a solid element",
    'part = "dome"\nfab = "generic-fpc"': "without film or ink; leave out fab\n",
    'part = "dome"\ntag = "strip"': "without film or ink; leave out tag\n",
    'part = "dome"\ntag_id = 3': "without film or ink; leave out tag_id\n",
    'part = "dome"\ncorner_radius_mm = 3\ncylinder_mm = 40': "square corners, 0 mm; leave out corner_radius_mm\n",
    'bend_axis = "x"': "give --bend-radius MM too, or leave out bend_axis\n",
}


@pytest.mark.parametrize(("content", "said"), OF_A_FILE.items(), ids=OF_A_FILE)
def test_a_key_of_a_spec_file_is_left_out_of_the_file(content: str, said: str, here: Path) -> None:
    Path("s.toml").write_text(f"sector = 7\n{content}\n", encoding="utf-8")
    result = CliRunner().invoke(main, ["check", "s.toml"], prog_name="tactape-fab")
    assert result.exit_code == 2 and said in result.stderr, result.stderr
