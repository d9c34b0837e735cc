"""Every command and every script of the pages in docs/ runs as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from click.testing import CliRunner

from tactape_fab.cli import main
from tactape_fab.verify.trip import coverage
from tests.thorough import only_thorough

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"^```(sh|python|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


FENCE = re.compile(r"^```(?:sh|shell|bash|zsh|python|py|toml)\b", re.MULTILINE)
PAGES = sorted(page.name for page in DOCS.glob("*.md") if FENCE.search(page.read_text(encoding="utf-8")))
RUN_ELSEWHERE = {"order-jlc.md", "raw-images.md", "tutorial.md"}
"""By test_order_jlc.py; with images that test_reconstruct.py makes; by .ci/run, installation and all, in a clean clone."""


def test_pages_with_commands_are_found() -> None:
    assert {"tutorial.md", "fabs.md", "reference.md", "choose.md"} < set(PAGES)
    assert set(PAGES) > RUN_ELSEWHERE
    assert '-c "$(tutorial)"' in (DOCS.parent / ".ci" / "run").read_text(encoding="utf-8")


@only_thorough
@pytest.mark.parametrize("page", sorted(set(PAGES) - RUN_ELSEWHERE))
def test_page_runs_from_top_to_bottom(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package's own commands run in this process, which spares their start; scripts in one of their own.

    Maps are of few places, for the time they take.
    """
    monkeypatch.setattr(coverage, "_PLACES", 50)
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = BLOCK.findall(text)
    assert len(blocks) == len(FENCE.findall(text))
    monkeypatch.chdir(tmp_path)
    environment = {**os.environ, "PATH": os.pathsep.join([sysconfig.get_path("scripts"), os.environ["PATH"]])}
    for language, text in blocks:
        if language == "toml":  # a file, which its first line names
            name = text.split("\n", maxsplit=1)[0].removeprefix("# ").partition(":")[0]
            (tmp_path / name).write_text(text, encoding="utf-8")
            continue
        commands = [[sys.executable, "-c", text]] if language == "python" else [shlex.split(line) for line in text.splitlines()]
        for command in commands:
            if command[0] == "tactape-fab":
                done = CliRunner().invoke(main, command[1:], prog_name="tactape-fab")
                assert done.exit_code == 0, f"{' '.join(command)}\n{done.output}"
                assert "decode" not in command or "located 0 of" not in done.stderr, f"{' '.join(command)}\n{done.output}"
                continue
            run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, encoding="utf-8", check=False)
            assert run.returncode == 0, f"{' '.join(command)}\n{run.stdout}{run.stderr}"


@pytest.mark.parametrize(
    ("page", "least"),
    [
        *(("solids.md", 13), ("localization.md", 1), ("fabs.md", 4)),
        *(
            ("certify.md", 1),
            ("verify.md", 1),
            ("panels.md", 1),
            ("frames.md", 1),
            ("calibrate.md", 2),
            ("tutorial.md", 2),
            ("applications.md", 4),
        ),
    ],
)
def test_every_picture_is_there(page: str, least: int) -> None:
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", (DOCS / page).read_text(encoding="utf-8"))
    assert len(pictures) == len(set(pictures)) >= least
    for picture in pictures:
        assert (DOCS / picture).read_bytes().startswith(b"\x89PNG"), picture
