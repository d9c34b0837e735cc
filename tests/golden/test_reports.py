"""What `check` says of the default grid (W 1.5, delta 0.25) for every fab profile and every way to open its coverlay."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from tactape_fab.base.templates import profile_names
from tactape_fab.cli import main
from tactape_fab.kit.profiles import COVERLAY_MODES

FOLDER = Path(__file__).parent / "reports"
FABS = profile_names("fabs")


def report(name: str) -> str:
    """One tape with strip and hole, each way to open the coverlay in turn, the default first."""
    parts = []
    for mode in ("default", *COVERLAY_MODES):
        tape = ["--sector", "7", "--w", "1.5", "--delta", "0.25", "--hole", "60,25,1"]
        asked = [] if mode == "default" else ["--coverlay", mode]
        result = CliRunner().invoke(main, ["check", *tape, "--fab", name, *asked])
        output = "".join(f"{stream}{text}" for stream, text in (("", result.stdout), ("\n", result.stderr)) if text)
        parts.append(f"== coverlay {mode}, exit status {result.exit_code}\n\n{output}")
    return "\n".join(parts)


@pytest.mark.parametrize("name", FABS)
def test_the_report_of_a_profile_is_the_golden_one(name: str, request: pytest.FixtureRequest) -> None:
    found, golden = report(name), FOLDER / f"{name}.txt"
    if request.config.getoption("--update-golden"):
        golden.write_text(found, encoding="utf-8")
    assert found == golden.read_text(encoding="utf-8")


def test_there_is_a_golden_report_of_every_profile_and_no_other() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.txt")) == FABS
