"""Thirty wrong inputs with their messages: each names the option as it was typed, the value, the limit and what to do."""

from __future__ import annotations

import re
import shlex
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from tactape_fab import Kit
from tactape_fab.cli import main
from tactape_fab.cli.options import degrees, hertz, kilopascals, length, micrometres, newtons, per_inch, seconds

OPTION_KEY = re.compile(r"\b\w+_(mm|deg|px|um)\b")
WRONG = {
    "make 7": "SPEC.toml = 7 is no file; did you mean --sector 7?",
    "make": "sector is missing; give --sector N",
    "make --sector 300": "--sector = 300 is outside 0 to 255",
    "make --sector 7 --dry-run": "No such option '--dry-run'. tactape-fab check measures, and writes nothing",
    "make --sector 7 --w 1.5in": "--w = '1.5in' is not a number in mm",
    "make --sector 7 --delta 0.75": "--delta = 0.75 mm is not below 0.75 mm",
    "make --sector 7 --size 0x50": "--size = 0 mm is not above 0 mm; give WIDTHxHEIGHT",
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
    "check --sector 7 --part 0402": "chips that come with it are r01005, r0201",
    "check --sector 7 --code anoto": "did you mean 'anoto-6x6'?",
    "check nowhere.toml": "nowhere.toml cannot be opened",
    "verify nowhere": "nowhere is no kit: there is no such file; give the folder of a kit or its manifest.json",
    "verify nowhere --contact 0x5": "--contact = '0x5' is below 0.1 mm; give a larger contact",
    "verify nowhere --quick --map map.png": "leave out --quick, or --map",
    "decode frames.npz": "no tape is given; name the kits that can be touched with --tape",
    "registry nowhere": "nowhere is no kit: there is no such file",
    "profiles nofab": "'nofab' is none of: generic-fpc, generic-fr4, generic-lpi",
    "advise --contact nan": "--contact = nan mm is not a finite number; give --contact MM, such as 6",
    "advise --contact 6 --blur 9": "--blur = 9 mm exceeds",
}


OF_A_KIT = {
    "simulate {kit} -o a.npz --contact-model nope --noise-model nope --noise 1e9 --placement -3 --elastomer -1 --k1-error 7": [
        "--contact-model = 'nope'", "--elastomer = -1 mm", "--noise = 1e+09", "--placement = -3 mm", "--k1-error = 7",
        "--noise-model = 'nope'",
    ],
    "simulate {kit} -o a.npz --cylinder 5 --contact 3x3 --force 2 --noise -1": [
        "force belongs to an elastic contact", "cylinder and contact both name", "--noise = -1",
    ],
    "simulate {kit} -o a.npz --contact-model elastic --contact 3x3 --force -1N --tilt 99deg,0": [
        "contact is decided by the force", "99 deg exceeds 20 deg", " = -1 N is below 0.01 N",
    ],
    "survey f.npz --tape {kit} -o a.json --workers 0 --sensor nope": ["--workers = 0", "--sensor = 'nope'"],
    "emboss {kit} no.stl --at 0,0 --up 0,0,0 --unit ft --face -1": [
        "--face = -1", "--at = '0,0'", "--up = 0,0,0 is no direction", "--unit = 'ft'", "SURFACE = no.stl cannot be read",
    ],
    "emboss {kit} no.txt --unit ft -o .": ["--unit = 'ft'", "SURFACE = no.txt is none of", "-o = . is no name"],
    "advise --contact nan --size 0x50 --process foo --fab bar --sensor nope": [
        "--contact = nan", "--process = 'foo'", "--size = 0 mm", "--sensor = 'nope'", "--fab = 'bar'",
    ],
    "ros2 --tape nope --sensor x --package No": ["No is no name of a ROS package", "nope is no kit", "--sensor = 'x'"],
    "ros2 --tape nope --package pp": ["nope is no kit"],
    "inspect nope.png --tape {kit} -o a.json": ["SCAN = nope.png cannot be read: No such file or directory; give a scan"],
    "check --sector 7 --size 0x0": ["--size = 0 mm is not above 0 mm"],
    "check --sector 7 --origin 4000,4000": ["--origin = 4000 is outside 0 to 3374"],
    "check --sector 7 --tag none --tag-cell 1": ["--tag-cell = 1 mm is of a tag, and there is none; leave it out"],
    "check --sector 7 --part dome --tag-cell 1": ["--tag-cell = 1 mm is of a tag, and there is none; leave it out"],
}  # fmt: skip


@pytest.mark.parametrize(("command", "said"), OF_A_KIT.items(), ids=OF_A_KIT)
def test_all_that_is_wrong_is_said_once_and_together(
    command: str, said: list[str], default_kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, shlex.split(command.format(kit=default_kit.path)), prog_name="tactape-fab")
    assert (result.exit_code, result.stdout) == (2, ""), result.exception
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == len(said) and all(any(text in line for line in lines) for text in said), lines
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("read", "texts"),
    [(newtons, ("2N", "2 N", "2")), (degrees, ("45deg", "45")), (hertz, ("100Hz", "100hz")), (micrometres, ("5um", "5µm", "5")),
     (per_inch, ("600dpi", "600")), (kilopascals, ("200kPa",)), (seconds, ("3s",)), (length, ("2mm", "2 mm", "2"))],
)  # fmt: skip
def test_a_number_may_have_its_own_unit(read: Callable[[str], object], texts: tuple[str, ...]) -> None:
    assert {read(text) for text in texts} == {read(texts[-1])} and isinstance(read(texts[0]), int)
    assert (read("2in"), read("max")) == ("2in", "max")


def test_a_list_of_too_many_tapes_is_refused_before_they_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
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


def test_a_cpl_of_other_parts_is_refused_and_one_of_fewer_said(
    default_kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
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


@pytest.mark.parametrize(("command", "said"), WRONG.items(), ids=WRONG)
def test_a_wrong_input_is_answered_as_it_was_typed(
    command: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, shlex.split(command), prog_name="tactape-fab")
    assert (result.exit_code, result.stdout) == (2, ""), result.exception
    lines = [line for line in result.stderr.splitlines() if line.lower().startswith("error: ")]
    assert [line for line in lines if said in line], lines
    assert [line for line in lines if OPTION_KEY.search(line)] == []
    assert list(tmp_path.iterdir()) == []
