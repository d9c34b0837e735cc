"""Every command and every script of the how-to pages in docs/ runs as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from tests.thorough import only_thorough

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"^```(sh|python|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@only_thorough
@pytest.mark.parametrize(
    ("page", "least"),
    [
        *(("solids.md", 6), ("localization.md", 7), ("fabs.md", 5), ("ordering.md", 5)),
        *(("certify.md", 4), ("verify.md", 1), ("panels.md", 4), ("many.md", 4)),
    ],
)
def test_page_runs_from_top_to_bottom(page: str, least: int, tmp_path: Path) -> None:
    blocks = BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))
    assert len(blocks) >= least
    environment = {**os.environ, "PATH": os.pathsep.join([sysconfig.get_path("scripts"), os.environ["PATH"]])}
    for language, text in blocks:
        if language == "toml":  # a file, which its first line names
            (tmp_path / text.split("\n", maxsplit=1)[0].removeprefix("# ")).write_text(text, encoding="utf-8")
            continue
        commands = [[sys.executable, "-c", text]] if language == "python" else [shlex.split(line) for line in text.splitlines()]
        for command in commands:
            run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
            assert run.returncode == 0, f"{' '.join(command)}\n{run.stdout}{run.stderr}"
            if "decode" in command:
                assert "located 0 of" not in run.stderr, f"{' '.join(command)}\n{run.stdout}"


@pytest.mark.parametrize(
    ("page", "least"),
    [
        *(("solids.md", 13), ("localization.md", 1), ("fabs.md", 4)),
        *(("certify.md", 1), ("verify.md", 1), ("panels.md", 1)),
    ],
)
def test_every_picture_is_there(page: str, least: int) -> None:
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", (DOCS / page).read_text(encoding="utf-8"))
    assert len(pictures) == len(set(pictures)) >= least
    for picture in pictures:
        assert (DOCS / picture).read_bytes().startswith(b"\x89PNG"), picture
