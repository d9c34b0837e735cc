"""coupon: what stands in its place is refused for that alone, and its remedies are options that it has."""

from __future__ import annotations

import shlex
from pathlib import Path

from click.testing import CliRunner, Result

from tactape_fab.cli import main
from tests.thorough import slow


def run(*words: str) -> Result:
    return CliRunner().invoke(main, ["coupon", *words, "--no-verify"], prog_name="tactape-fab")


@slow
def test_a_coupon_that_is_there_is_replaced_as_its_messages_say(here: Path) -> None:
    made = run("-o", "my coupon")
    assert made.exit_code == 0, made.output
    assert "my coupon" in shlex.split(made.stderr)  # in the command that it names
    refused = run("-o", "my coupon")
    assert refused.exit_code == 2
    (line,) = refused.stderr.splitlines()  # not the limits that it breaks on purpose
    assert "use --overwrite to replace a kit" in line
    notes = here / "my coupon" / "generic-fpc-coupon-order-notes.txt"
    notes.write_text("edited")
    (line,) = run("-o", "my coupon", "--overwrite").stderr.splitlines()
    assert "--discard-edits to lose these edits" in line
    assert run("-o", "my coupon", "--discard-edits").exit_code == 0 and notes.read_text() != "edited"


def test_sectors_beyond_the_code_are_named_from_the_first_to_the_last() -> None:
    assert "--first-sector = -1: its 9 tapes need sectors -1 to 7; use --first-sector 0 to" in run("--first-sector", "-1").stderr
    assert "--first-sector = 250: its 9 tapes need sectors 250 to 258; use" in run("--first-sector", "250").stderr
