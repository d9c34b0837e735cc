"""Tapes that are made or ordered together are compared before anything is written, and the remedy holds as typed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import Result

from tactape_fab.kit.examine.together import sector_words
from tactape_fab.texture.certify.kits import registry
from tests.commands import run
from tests.thorough import only_thorough, slow

pytestmark = pytest.mark.usefixtures("here")
BOTH = "tactape-s000 and tactape-s001: 1 pair of 4x4 windows read the same"


def said(result: Result) -> str:
    """The warning of tapes that conflict; "" without one."""
    return next((line for line in result.stderr.splitlines() if line.startswith("warning: together:")), "")


@only_thorough
def test_a_list_says_what_the_registry_would_find() -> None:
    command = "make --sectors 0,1 --no-3d --no-verify --jobs 1 -o kits"
    made = run(command)
    assert made.exit_code == 0, made.stderr
    assert BOTH in said(made)
    assert [c.message for c in registry(["kits"]).conflicts] == [BOTH]
    ways = re.findall(r"--(?:sectors|origin) [\w,-]*\w", said(made))
    assert ways == ["--sectors 0,2", "--origin best"]
    for way in ways:
        words = command.replace("--sectors 0,1", way) if "sectors" in way else f"{command} {way}"
        again = run(f"{words} --overwrite".replace("-o kits", f"-o {way.split()[0].strip('-')}"))
        assert again.exit_code == 0, again.stderr
        assert said(again) == ""
        assert registry([way.split()[0].strip("-")]).conflicts == ()


def test_a_panel_says_it_too_and_so_does_its_profile() -> None:
    for command in ("--sector 0 --panel 1x2", "--sectors 0,1 --panel auto", "--sector 0 --fab jlcpcb-fpc"):
        result = run(f"check {command}")
        assert BOTH in said(result), command
        assert "use --sectors 0,2" in said(result)
    for command in ("--sectors 0,2 --panel 1x2", "--sectors 0,2 --fab jlcpcb-fpc", "--sector 0 --panel 1x2 --same-sector"):
        assert said(run(f"check {command}")) == "", command


def test_a_tape_beside_others_is_compared_with_them() -> None:
    assert run("make --sector 7 --size 30x20 --no-3d --no-verify").exit_code == 0
    result = run("check --sector 7 --avoid tactape-s007 --size 30x20")
    assert "both tags have id 7; use --sector 8" in said(result)
    assert said(run("check --sector 8 --avoid tactape-s007 --size 30x20")) == ""
    assert said(run("check --avoid tactape-s007 --size 30x20")) == ""


@slow
@pytest.mark.parametrize("words", ["make --sectors 1-2 --no-verify -o kits", "check --sector 2 --avoid kits/tactape-s001"])
def test_tags_of_one_given_id_have_none_given(words: str) -> None:
    small = "--tag-id 5 --size 24x20 --no-3d"
    assert run(f"make --sectors 1 --no-verify -o kits {small}").exit_code == 0
    again = words.replace("-o kits", "-o others")
    assert said(run(f"{again} {small}")).endswith("both tags have id 5; leave out --tag-id, or tag_id in the TOML file")
    assert said(run(f"{again.replace('others', 'good')} --size 24x20 --no-3d")) == ""


@slow
def test_tapes_of_a_table_are_named() -> None:
    Path("lab.toml").write_text("models = false\n[[tapes]]\nsector = 0\n[[tapes]]\nsector = 1\n")
    result = run("make lab.toml --size 100x50 --no-verify --jobs 1")
    assert f"{BOTH}; use sector = 2 for tactape-s001" in said(result)


def test_sectors_are_named_as_they_are_typed() -> None:
    assert sector_words([7]) == "7"
    assert sector_words([0, 10, 2, 3, 4, 9, 10]) == "0,10,2-4,9,10"
