"""Every path, module and name that CONTRIBUTING.md speaks of exists, and its map is that of the import contracts."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tactape_fab.base.templates import read_toml

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PATH = re.compile(r"(?<![\w/.<-])(?:tactape_fab|templates|tests|docs|\.ci)(?:[/.][\w.*-]+)*")
PLACEHOLDER = re.compile(r"\bNAME\b")
NAMED = re.compile(r"`([A-Z_]+)`\s+(?:of|in)\s+`((?:tactape_fab|tests)/[\w/]+\.py)`")


def exists(path: str) -> bool:
    """A file or folder, or a module by its dotted name; of a file to be written, its folder."""
    if PLACEHOLDER.search(path):
        return (ROOT / path).parent.is_dir()
    module = ROOT / path.replace(".", "/")
    return (ROOT / path).exists() or module.is_dir() or module.with_suffix(".py").is_file()


@pytest.mark.parametrize("path", sorted({found.rstrip(".") for found in PATH.findall(TEXT)}))
def test_what_is_named_exists(path: str) -> None:
    assert exists(path)


def test_a_name_that_is_gone_would_be_found() -> None:
    assert {"tactape_fab/kit/plan.py", "tests.golden.record", ".ci/run"} <= set(PATH.findall(TEXT))
    assert len(NAMED.findall(TEXT)) > 8
    assert not exists("tactape_fab/kit/door.py") and not exists("tactape_fab.kit.door") and not exists("templates/none/NAME.toml")


@pytest.mark.parametrize(("name", "module"), NAMED.findall(TEXT))
def test_a_table_is_where_it_is_said_to_be(name: str, module: str) -> None:
    assert re.search(rf"^{name}\b.*=", (ROOT / module).read_text(encoding="utf-8"), re.MULTILINE)


def test_the_map_has_the_packages_of_the_import_contracts() -> None:
    contracts = read_toml(ROOT / "pyproject.toml", "contracts")["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract.get("containers") == ["tactape_fab"])
    packages = [package.strip() for layer in layers for package in layer.split("|")]
    assert re.findall(r"^\| `tactape_fab/(\w+)` \|", TEXT, re.MULTILINE) == packages
    assert f"Ten packages in {({7: 'seven'})[len(layers)]} layers" in TEXT and len(packages) == 10


@pytest.mark.parametrize("life", ["TapeSpec", "depth map"])
def test_a_life_is_told_in_ten_steps_in_modules(life: str) -> None:
    (section,) = re.findall(rf"^## Life of a {life}\n(.*?)^## ", TEXT, re.MULTILINE | re.DOTALL)
    steps = re.findall(r"^(\d+)\. (.+)$", section, re.MULTILINE)
    assert [int(number) for number, _ in steps] == list(range(1, 11))
    assert all("`tactape_fab/" in step for _, step in steps)


def test_a_script_of_a_page_reads_its_arguments_before_it_writes() -> None:
    """`make_limits.py --help` measured for minutes, and wrote the page anew."""
    for script in (ROOT / "docs").glob("make_*.py"):
        assert ".parse_args()" in script.read_text(encoding="utf-8"), script.name
    page = (ROOT / "docs" / "limits.md").stat().st_mtime_ns
    asked = [sys.executable, str(ROOT / "docs" / "make_limits.py"), "--help"]
    assert subprocess.run(asked, capture_output=True, text=True, check=True).stdout.startswith("usage:")
    assert (ROOT / "docs" / "limits.md").stat().st_mtime_ns == page
