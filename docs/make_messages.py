"""Makes what commands answer on troubleshooting.md. Run: python docs/make_messages.py (a test holds the page to it)

The page's `console` blocks hold commands behind a `$`; below each stand its errors, or else its warnings, as they are printed.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import tempfile
from argparse import ArgumentParser
from collections.abc import Iterator
from pathlib import Path

from click.testing import CliRunner

from tactape_fab.cli import main

PAGE = Path(__file__).parent / "troubleshooting.md"
BLOCK = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)
STATUS = re.compile(r"^(FAIL|warn) ")
BEFORE = ("make --sector 7 --no-3d", "simulate tactape-s007 -o frames.npz --seed 1")
"""What has been done before the first command of the page."""


def answer(command: str) -> Iterator[str]:
    """What a command of the page prints of errors, or of warnings where there is no error."""
    words = shlex.split(command)
    if words[0] == "rm":
        Path(words[1]).unlink()
        return
    if words[0] == "touch":
        Path(words[1]).touch()
        return
    assert words[0] == "tactape-fab", command
    result = CliRunner().invoke(main, words[1:], prog_name="tactape-fab")
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    lines = [re.sub(r" {2,}", "  ", line) for line in result.stdout.splitlines() if STATUS.match(line)]
    said = result.stderr.splitlines()
    yield from lines or [line for line in said if line.startswith(("error:", "Error:"))] or said


def made_anew(text: str) -> str:
    """The page with every answer as the commands give it here, in the current folder."""

    def block(found: re.Match[str]) -> str:
        lines = []
        for line in found[1].splitlines():
            if line.startswith("$ "):
                lines += [line, *answer(line[2:])]
        return "```console\n" + "\n".join(lines) + "\n```"

    return BLOCK.sub(block, text)


def prepare(kit: Path | None = None) -> None:
    """What the page takes for granted, in the current folder."""
    if kit is not None:
        shutil.copytree(kit, "tactape-s007")
    for line in BEFORE[0 if kit is None else 1 :]:
        result = CliRunner().invoke(main, shlex.split(line), prog_name="tactape-fab")
        assert result.exit_code == 0, result.output


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    page, here = PAGE.resolve(), Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            prepare()
            fresh = made_anew(page.read_text(encoding="utf-8"))
        finally:
            os.chdir(here)
    page.write_text(fresh, encoding="utf-8")
