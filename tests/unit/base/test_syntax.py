"""The package is written in the syntax of the oldest Python that it is for, whichever runs the tests."""

from __future__ import annotations

import ast
from pathlib import Path

import tactape_fab
from tactape_fab.base.templates import read_toml

PACKAGE = Path(tactape_fab.__file__).parent
OLDEST = (3, 10)


def test_every_file_is_read_by_the_oldest_python() -> None:
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 100
    for path in files:
        ast.parse(path.read_text(encoding="utf-8"), filename=str(path), feature_version=OLDEST)


def test_the_oldest_python_is_the_one_that_is_asked_for() -> None:
    project = PACKAGE.parent / "pyproject.toml"
    if project.is_file():
        assert read_toml(project, "pyproject")["project"]["requires-python"] == f">={OLDEST[0]}.{OLDEST[1]}"
