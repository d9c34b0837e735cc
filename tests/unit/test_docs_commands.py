"""Every command and every script of docs/solids.md runs as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "solids.md"
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_solids_page_runs_from_top_to_bottom(tmp_path: Path) -> None:
    blocks = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    assert len(blocks) >= 6
    environment = {**os.environ, "PATH": os.pathsep.join([sysconfig.get_path("scripts"), os.environ["PATH"]])}
    for language, text in blocks:
        commands = [[sys.executable, "-c", text]] if language == "python" else [shlex.split(line) for line in text.splitlines()]
        for command in commands:
            run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
            assert run.returncode == 0, f"{' '.join(command)}\n{run.stdout}{run.stderr}"


def test_every_picture_is_there() -> None:
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", PAGE.read_text(encoding="utf-8"))
    assert len(pictures) == len(set(pictures)) >= 13
    for picture in pictures:
        assert (PAGE.parent / picture).read_bytes().startswith(b"\x89PNG"), picture
