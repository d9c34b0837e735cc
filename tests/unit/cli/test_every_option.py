"""A wrong value of each option of the commands that make something is answered by the option's own name, as typed."""

from __future__ import annotations

import shlex
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tactape_fab.cli import main

COMMANDS = {
    "make": "make --sector 7",
    "emboss": "emboss kit part.stl",
    "advise": "advise --contact 6",
    "coupon": "coupon",
    "profiles": "profiles confirm coupon --held 0 -o profile.toml",
}
FREE = {"--json", "--overwrite", "--discard-edits", "--no-verify", "--force", "--help", "--sim", "--output", "--simulate"}
FREE |= {"--explain"}
"""Options that take no value, or any."""
BESIDE = {
    "--negative": "--no-3d",
    "--no-3d": "--negative",
    "--contact": "--order jlcpcb",
    "--jobs": "--sectors 1-2",
    "--tabs": "--panel 2x1",
    "--around": "--cylinder 60",
    "--shell": "--cylinder 60",
    "--bend-axis": "--bend-radius 20",
    "--bend-radius": "--bend-axis x",
}
"""What makes a wrong value of an option one: a flag is wrong beside another, some say something only beside another."""
WRONG = ",;"
SENTENCES = ("first_sector", "same_sector", "dome_top", "tag_id", "corner_radius", "bend_axis", "part_number", "_mm", "_deg")
"""Pieces of the package's own names that no message to a user has."""


def options(command: str) -> list[click.Option]:
    given = main.get_command(click.Context(main), command)
    assert given is not None
    return [p for p in given.params if isinstance(p, click.Option) and not FREE.intersection(p.opts)]


CASES = [(command, option) for command in COMMANDS for option in options(command)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a kit, a coupon and a part."""
    place = tmp_path_factory.mktemp("made")
    for line in ("make --sector 3 --part dome --size 12x12 --no-verify -o kit", "coupon --no-verify -o coupon"):
        *words, last = line.split()
        result = CliRunner().invoke(main, [*words, str(place / last)], prog_name="tactape-fab")
        assert result.exit_code == 0, result.output
    (place / "part.stl").write_bytes((place / "kit/models/tactape-s003.stl").read_bytes())
    return place


@pytest.mark.parametrize(("command", "option"), CASES, ids=[f"{command} {option.opts[0]}" for command, option in CASES])
def test_a_wrong_value_is_named_by_its_option(
    command: str, option: click.Option, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    name, before = option.opts[0], sorted(folder.iterdir())
    words = shlex.split(f"{COMMANDS[command]} {BESIDE.get(name, '') if command == 'make' else ''}")
    if name in words or (command, name) == ("make", "--jobs"):  # the right value gives way
        at = words.index("--sector" if name == "--jobs" else name)
        del words[at : at + 2]
    result = CliRunner().invoke(main, [*words, name, *[WRONG] * (not option.is_flag)], prog_name="tactape-fab")
    assert (result.exit_code, result.stdout) == (2, ""), f"refuse {name} {WRONG}, or enter it in FREE: {result.exception}"
    said = [text for text in result.stderr.splitlines() if text.startswith("error: ")]
    assert [text for text in said if name in text or text.startswith(f"error: {WRONG} ")], said
    assert [text for text in said if any(piece in text for piece in SENTENCES)] == []
    assert sorted(folder.iterdir()) == before
