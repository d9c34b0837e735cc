"""Inheritance of fab profiles: a profile with ``extends`` inherits every key that it does not give itself."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.templates import profile_names, profile_table, read_toml, templates_folder

MOST_ANCESTORS = 8
"""Longest chain of profiles."""
_TABLES_DEEP = 2
"""Greatest depth of nested tables: ``limits.pad-pad.value_mm`` is two tables deep."""


def fab_table(name: str) -> Fields:
    """The table of a fab profile, by name or by the path of a TOML file, with what it inherits.

    Tables are merged key by key; any other value, including a list, replaces the inherited one. The name is not inherited: a
    profile that extends another and gives no name is named after its file.

    Raises SpecError: a file that cannot be read, an unknown profile, a cycle, or more than `MOST_ANCESTORS` of them.
    """
    table = profile_table("fabs", "fab", name)
    path = Path(name) if name.endswith(".toml") else _built_in(name)
    if "extends" not in table.values:
        return table
    # resolved: a cycle may pass through links
    values, seen = {"name": path.stem, **table.values}, [path.resolve()]
    while "extends" in values:
        path = _parent(path, values.pop("extends"), table.where)
        inherited = read_toml(path, f"{table.where}extends")
        if path.resolve() in seen:
            hint = "extend a profile of the package, such as 'generic-fpc'"
            raise _refusal(table.where, f"leads back to {path.name}; {hint}")
        if len(seen) > MOST_ANCESTORS:
            hint = "extend one that is nearer to the last"
            raise _refusal(table.where, f"passes through more than {MOST_ANCESTORS} profiles; {hint}")
        seen.append(path.resolve())
        values = _merged(values, inherited, _TABLES_DEEP)
    return Fields(values, table.where)


def _built_in(name: str) -> Path:
    return templates_folder() / "fabs" / f"{name}.toml"


def _parent(child: Path, name: object, where: str) -> Path:
    """File of the profile that `child` extends: one of the package by name, or a file by its path from the child's folder."""
    known = profile_names("fabs")
    if isinstance(name, str) and name in known:
        return _built_in(name)
    if isinstance(name, str) and name.endswith(".toml"):
        return child.parent / name
    near = difflib.get_close_matches(name, known, n=1) if isinstance(name, str) else []
    hint = f"did you mean '{near[0]}'?" if near else "give one of them"
    raise _refusal(where, f"= {shown(name)} is none of: {', '.join(known)}, nor the path of a .toml file; {hint}")


def _refusal(where: str, message: str) -> SpecError:
    return SpecError(Problem(f"{where}extends", f"{where}extends {message}"))


def _merged(own: Mapping[str, Any], inherited: Mapping[str, Any], deep: int) -> dict[str, Any]:
    """Merge of `inherited` with the values of `own`, which take precedence."""
    merged = {**inherited, **own}
    for key in own.keys() & inherited.keys():
        if deep > 0 and isinstance(own[key], dict) and isinstance(inherited[key], dict):
            merged[key] = _merged(own[key], inherited[key], deep - 1)
    return merged
