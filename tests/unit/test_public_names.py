"""Public names: what pages and examples import, exported once, typed, and documented as numpydoc asks."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
import textwrap
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import tactape_fab

ROOT = Path(__file__).parents[2]
PACKAGES = ("tactape_fab", "tactape_fab.sense", "tactape_fab.solids")
BLOCK = re.compile(r"^( *)```(?:python|py)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)


def exported() -> list[tuple[str, str]]:
    return [(package, name) for package in PACKAGES for name in importlib.import_module(package).__all__ if name[0] != "_"]


NAMES = exported()
NAMED = [pytest.param(package, name, id=f"{package}.{name}") for package, name in NAMES]


@pytest.mark.parametrize("package", PACKAGES)
def test_dir_shows_the_public_names_alone(package: str) -> None:
    module = importlib.import_module(package)
    assert {name for name in dir(module) if not name.startswith("__")} == {name for name in module.__all__ if name[0] != "_"}
    assert {"__all__", "__doc__", "__name__"} <= set(dir(module))


# What is imported


def imports_of(code: str) -> Iterator[tuple[str, str]]:
    """Modules of this package that some code imports from, and the names that it takes."""
    for node in ast.walk(ast.parse(textwrap.dedent(code))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] == "tactape_fab":
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((a.name, "") for a in node.names if a.name.partition(".")[0] == "tactape_fab")


def shown_code() -> list[tuple[str, str]]:
    """Code that users read: blocks of the pages and of the README, and the examples."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    blocks = [(page.name, match[2]) for page in pages for match in BLOCK.finditer(page.read_text(encoding="utf-8"))]
    scripts = sorted((ROOT / "docs" / "examples").glob("*.py"))
    return blocks + [(script.name, script.read_text(encoding="utf-8")) for script in scripts]


def test_pages_and_examples_import_public_names_only() -> None:
    found = [(where, *taken) for where, code in shown_code() for taken in imports_of(code)]
    assert len(found) > 40
    assert [entry for entry in found if entry[1:] not in NAMES and entry[1:] not in {(p, "") for p in PACKAGES}] == []


def test_the_page_of_the_api_has_every_public_name_once() -> None:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^::: (\S+)$", page, re.MULTILINE)) == sorted(f"{package}.{name}" for package, name in NAMES)


# How it is exported


def test_every_name_is_exported_once() -> None:
    names = [name for _, name in NAMES]
    assert sorted(names) == sorted(set(names))
    objects = [id(getattr(importlib.import_module(package), name)) for package, name in NAMES]
    assert len(set(objects)) == len(objects)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_shows_its_names_and_says_them_to_type_checkers(package: str) -> None:
    module = importlib.import_module(package)
    assert set(module.__all__) <= set(dir(module))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        module.nothing  # noqa: B018
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    branch = next(node for node in tree.body if isinstance(node, ast.If))
    stated = {alias.asname for node in branch.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert stated == {name for name in module.__all__ if name[0] != "_"}


def test_to_import_a_package_is_to_load_nothing_of_weight() -> None:
    program = f"import sys, {', '.join(PACKAGES)}; print(*sorted({{m.partition('.')[0] for m in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, encoding="utf-8", check=True)
    assert not {"numpy", "numba", "cv2", "scipy", "shapely", "click", "build123d"} & set(done.stdout.split())


def test_solids_are_found_without_a_cad_kernel() -> None:
    program = "import sys; from tactape_fab.solids import texture_part; print('build123d' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("old", "name", "new"),
    [
        *(("tactape_fab.decode", name, "tactape_fab") for name in ("Localizer", "Localization", "Prior")),
        *(
            ("tactape_fab.decode", name, "tactape_fab.sense")
            for name in ("Reconstruction", "load_network", "make_reconstruction")
        ),
        *(
            ("tactape_fab.simulate", name, "tactape_fab.sense")
            for name in ("Frame", "Frames", "Parts", "Scene", "draw_poses", "iterate_frames", "parts_from_cpl", "simulate")
        ),
        ("tactape_fab.simulate", "simulate_frames", "tactape_fab.sense"),
    ],
)
def test_an_old_path_works_with_a_warning(old: str, name: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"import {name} from {re.escape(new)};") as caught:
        found = getattr(importlib.import_module(old), name)
    assert found is getattr(importlib.import_module(new), name)
    assert [entry.filename for entry in caught] == [__file__]


def test_an_old_module_has_its_own_names_only() -> None:
    with warnings.catch_warnings(), pytest.raises(AttributeError, match=r"tactape_fab\.decode"):
        warnings.simplefilter("error")
        importlib.import_module("tactape_fab.decode").Tape  # noqa: B018


# Types and docstrings


def sections(docstring: str) -> dict[str, str]:
    """Text of a numpydoc docstring by section; its beginning under the empty name."""
    parts = SECTION.split(inspect.cleandoc(docstring))
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def documented(text: str) -> set[str]:
    """Names that a section's entries stand for."""
    heads = [line.partition(" :")[0] for line in text.splitlines() if line and not line.startswith(" ")]
    return {name.strip().lstrip("*") for head in heads for name in head.split(",")}


def said_badly(where: str, function: Any, docstring: str | None) -> list[str]:
    """What a function's annotations and docstring lack."""
    signature = inspect.signature(function)
    taken = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
    lacking = [f"{where}: {p.name} has no type" for p in taken if p.annotation is p.empty]
    if signature.return_annotation is signature.empty:
        lacking.append(f"{where}: what it returns has no type")
    if not docstring:
        return [*lacking, f"{where}: no docstring"]
    part = sections(docstring)
    if not part[""].splitlines()[0].strip():
        lacking.append(f"{where}: no summary line")
    lacking += [
        f"{where}: {p.name} is not among its Parameters" for p in taken if p.name not in documented(part.get("Parameters", ""))
    ]
    gives = str(signature.return_annotation)
    short = "." in where and not taken  # a method without parameters may say in its summary what it gives
    if gives != "None" and not short and not where.endswith("__init__") and not {"Returns", "Yields"} & part.keys():
        lacking.append(f"{where}: no Returns")
    if re.search(r"^\s*raise \w+Error", inspect.getsource(function), re.MULTILINE) and "Raises" not in part:
        lacking.append(f"{where}: no Raises")
    return lacking


def said_badly_of_class(where: str, kind: type) -> list[str]:
    docstring = kind.__doc__
    if not docstring:
        return [f"{where}: no docstring"]
    part = sections(docstring)
    stated = documented(part.get("Attributes", "")) | documented(part.get("Parameters", ""))
    if issubclass(kind, Exception):
        return []
    lacking = []
    if dataclasses.is_dataclass(kind):
        fields = [field.name for field in dataclasses.fields(kind) if not field.name.startswith("_")]
        lacking += [f"{where}: {name} is not among its Attributes" for name in fields if name not in stated]
    else:
        lacking += [line for line in said_badly(f"{where}.__init__", kind.__init__, docstring) if "no Returns" not in line]
    for name, member in vars(kind).items():
        if name.startswith("_"):
            continue
        if isinstance(member, property):
            lacking += [] if member.__doc__ else [f"{where}.{name}: no docstring"]
        elif inspect.isfunction(member) or isinstance(member, classmethod | staticmethod):
            function = member if inspect.isfunction(member) else member.__func__
            lacking += said_badly(f"{where}.{name}", function, function.__doc__)
    return lacking


@pytest.mark.parametrize(("package", "name"), NAMED)
def test_a_public_name_is_typed_and_documented(package: str, name: str) -> None:
    thing = getattr(importlib.import_module(package), name)
    assert inspect.isclass(thing) or inspect.isfunction(thing)
    if inspect.isclass(thing):
        assert said_badly_of_class(name, thing) == []
    else:
        assert said_badly(name, thing, thing.__doc__) == []


def test_no_docstring_opens_with_what() -> None:
    """It names the thing instead: "The shapes of a Gerber file", not "What a Gerber file draws"."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    paths = Path(tactape_fab.__file__).parent.rglob("*.py")
    nodes = [(path.name, node) for path in paths for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, kinds)]
    assert len(nodes) > 3000
    assert [name for name, node in nodes if (ast.get_docstring(node) or "").startswith("What")] == []


def test_the_version_is_public() -> None:
    assert "__version__" in tactape_fab.__all__
