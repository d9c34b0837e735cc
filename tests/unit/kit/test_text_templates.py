"""Compiled templates: kept beside their source, taken from there, never stale, and never needed."""

from __future__ import annotations

import sys
from importlib.util import cache_from_source
from pathlib import Path

import jinja2
import pytest

from tactape_fab.kit import text_templates
from tactape_fab.kit.text_templates import template_environment


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A template in a folder of data files of its own."""
    monkeypatch.setattr(text_templates, "templates_folder", lambda: tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    (tmp_path / "order").mkdir()
    path = tmp_path / "order" / "note.j2"
    path.write_text("{{ word }}\n", encoding="utf-8")
    return path


def printed(word: str = "one") -> str:
    template_environment.cache_clear()  # as in another process
    try:
        return str(template_environment("order", autoescape=False).get_template("note.j2").render(word=word))
    finally:
        template_environment.cache_clear()


def test_a_template_is_compiled_once(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert printed() == "one\n"
    assert [path.name for path in source.parent.iterdir() if path.is_dir()] == ["__pycache__"]
    assert [str(path) for path in (source.parent / "__pycache__").iterdir()] == [cache_from_source(str(source))]
    monkeypatch.setattr(jinja2.Environment, "compile", lambda *_, **__: pytest.fail("it was compiled again"))
    assert printed("two") == "two\n"


def test_a_changed_template_is_compiled_again(source: Path) -> None:
    printed()
    source.write_text("the {{ word }}\n", encoding="utf-8")
    assert printed() == "the one\n"


@pytest.mark.parametrize("left", [0, 5, 25, 60])
def test_a_damaged_one_is_compiled_again(source: Path, left: int) -> None:
    printed()
    compiled = Path(cache_from_source(str(source)))
    whole = compiled.read_bytes()
    compiled.write_bytes(whole[:left])
    assert printed() == "one\n"
    assert compiled.read_bytes() == whole


def test_nothing_is_written_where_python_writes_no_modules(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert printed() == "one\n"
    assert list(source.parent.iterdir()) == [source]


def test_a_folder_that_cannot_be_written_is_no_error(source: Path) -> None:
    (source.parent / "__pycache__").write_bytes(b"")  # root may write anywhere: a file stands in the way
    assert printed() == "one\n"
