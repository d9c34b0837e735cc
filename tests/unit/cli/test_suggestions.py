"""What was probably meant is named, and what is left out or not run is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from tactape_fab.base.errors import Check
from tactape_fab.cli.printing import verified_line
from tactape_fab.kit.profiles import PartProfile, profile_names, read_part
from tests.commands import run

CHIPS = [name for name in profile_names("parts") if isinstance(read_part(name), PartProfile)]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("check --sector 7 --fab jlcpcb", "did you mean 'jlcpcb-fpc'?"),
        ("check --sector 7 --fab PCBWay-FR4", "did you mean 'pcbway-fr4'?"),
        ("check --sector 7 --part Dome", "did you mean 'dome'?"),
        ("check --sector 7 --part 0201", "did you mean 'r0201'?"),
        ("check --sector 7 --part 0402", "did you mean 'r0402'?"),
        ("check --sector 7 --part 0805", f"chips that come with it are {', '.join(CHIPS)}"),
        ("check --sector 7 --part r2512", f"chips that come with it are {', '.join(CHIPS)}"),
        ("check --sector 7 --coverlay Gang", "did you mean 'gang'?"),
        ("check --sector 7 --code anoto", "did you mean 'anoto-6x6'?"),
        ("check --sector 7 --assembly jlc", "did you mean 'jlcpcb'?"),
        ("make 7", "did you mean --sector 7?"),
        ("make --sector 7 --dry-run", "tactape-fab check measures, and writes nothing"),
    ],
)
def test_what_was_meant_is_named(command: str, said: str, here: Path) -> None:
    result = run(command)
    assert result.exit_code == 2
    assert said in result.stderr
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("advise --contact nan", "error: --contact = nan mm is not a finite number"),
        ("advise --contact 6 --blur 9", "error: --blur = 9 mm exceeds"),
        ("advise --contact 6 --size 1x", "error: --size = '1x' is not 2 numbers"),
        ("certify --code microdots-4x4 --size 3x", "error: --size = '3x' is not 2 numbers"),
    ],
)
def test_values_are_named_as_they_were_typed(command: str, said: str) -> None:
    result = run(command)
    assert result.exit_code == 2
    assert said in result.stderr


def test_a_check_that_was_not_run_is_not_counted() -> None:
    made = [
        Check(name="a", passed=True, message="within limits"),
        Check(name="b", passed=False, warning=True, message="unlisted"),
    ]
    absent = Check(name="OCCT", passed=False, warning=True, skipped=True, message="OCCT is not installed")
    assert verified_line(made) == "verified: 2 checks of the written files"
    assert verified_line([*made, absent]) == "verified: 2 checks of the written files, 1 not run: OCCT"


def test_grid_points_without_a_part_are_counted(here: Path) -> None:
    result = run("make --sector 7 --size 30x20 --hole 20,10,2 --no-3d --no-verify")
    assert result.exit_code == 0
    assert "grid points at holes and corners left out" in result.stdout.splitlines()[0]


def test_equal_names_are_certified_with_their_paths(here: Path) -> None:
    for folder in ("a", "b"):
        assert run(f"make --sector 7 --size 30x20 --no-3d --no-verify -o lab/{folder}").exit_code == 0
    rows = [line for line in run("certify lab").stdout.splitlines() if line.startswith("tactape-s007")]
    assert [row.split()[1] for row in rows] == ["(lab/a)", "(lab/b)"]
