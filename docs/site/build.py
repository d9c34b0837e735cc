"""Builds the site of all pages: python docs/site/build.py FOLDER (with the extra docs). Any warning ends it with status 1."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

SITE = Path(__file__).parent
DOCS = SITE.parent
PAGES = {
    "index.md": "README.md",
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
    "security.md": "SECURITY.md",
}
"""Pages that are files of the top folder."""


def as_page(text: str) -> str:
    """A file of the top folder, with links as they are among the pages."""
    for page, source in PAGES.items():
        text = text.replace(f"]({source})", f"]({page})")
    return re.sub(r"\]\(docs/", "](", text)


def gather(pages: Path) -> None:
    """Everything that the site shows, in one folder: pages and what they link, without the scripts that made them."""
    shutil.copytree(DOCS, pages, ignore=shutil.ignore_patterns("*.py", "site", "__pycache__"))
    shutil.copy(SITE / "extra.css", pages)
    for page, source in PAGES.items():
        (pages / page).write_text(as_page((DOCS.parent / source).read_text(encoding="utf-8")), encoding="utf-8")


def build(target: Path) -> int:
    """Build into `target`; the exit status."""
    with tempfile.TemporaryDirectory() as scratch:
        gather(Path(scratch, "pages"))
        config = shutil.copy(SITE / "zensical.toml", scratch)
        done = subprocess.run([sys.executable, "-m", "zensical", "build", "--strict", "-f", config], cwd=DOCS.parent, check=False)
        if done.returncode == 0:
            shutil.copytree(Path(scratch, "site"), target, dirs_exist_ok=True)
    return done.returncode


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/docs"))
    sys.exit(build(parser.parse_args().folder))
