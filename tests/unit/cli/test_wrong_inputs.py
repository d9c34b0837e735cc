"""Thirty wrong inputs with their messages: each names the option as it was typed, the value, the limit and what to do."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

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


@pytest.mark.parametrize(
    ("read", "texts"),
    [(newtons, ("2N", "2 N", "2")), (degrees, ("45deg", "45")), (hertz, ("100Hz", "100hz")), (micrometres, ("5um", "5µm", "5")),
     (per_inch, ("600dpi", "600")), (kilopascals, ("200kPa",)), (seconds, ("3s",)), (length, ("2mm", "2 mm", "2"))],
)  # fmt: skip
def test_a_number_may_have_its_own_unit(read: Callable[[str], object], texts: tuple[str, ...]) -> None:
    assert {read(text) for text in texts} == {read(texts[-1])} and isinstance(read(texts[0]), int)
    assert (read("2in"), read("max")) == ("2in", "max")


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
