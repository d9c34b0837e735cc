"""What mkdocs adds to the pages of docs/: the README as the first page, and the changes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

TOP = Path(__file__).parents[2]
PAGES = {"index.md": "README.md", "changelog.md": "CHANGELOG.md"}


def as_page(text: str) -> str:
    """A file of the top folder, with links as they are among the pages."""
    for page, source in PAGES.items():
        text = text.replace(f"]({source})", f"]({page})")
    return re.sub(r"\]\(docs/", "](", text)


def on_files(files: Files, config: Any) -> Files:
    for page, source in PAGES.items():
        files.append(File.generated(config, page, content=as_page((TOP / source).read_text(encoding="utf-8"))))
    return files
