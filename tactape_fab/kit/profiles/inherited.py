"""Inheritance of fab profiles: a profile with ``extends`` inherits every key that it does not give itself."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.templates import is_profile_file, profile_names, profile_table, read_toml, templates_folder

MOST_ANCESTORS = 8
"""Most profiles in a chain of ``extends``."""
_TABLES_DEEP = 2
"""Greatest depth of nested tables: ``limits.pad-pad.value_mm`` is two tables deep."""


def fab_table(name: str) -> Fields:
    """The table of a fab profile, by name or by the path of a TOML file, merged with those that it extends.

    Tables are merged key by key; any other value, including a list, replaces the inherited one. The name is not inherited: a
    profile without a name is named after its file. An inherited ``warn_mm`` is dropped if the new ``value_mm`` of its limit
    reaches it.

    Raises SpecError: a file that cannot be read, an unknown profile, a cycle, or more than `MOST_ANCESTORS` of them.
    """
    table = profile_table("fabs", "fab", name)
    path = Path(name) if is_profile_file(name) else _built_in(name)
    if "extends" not in table.values:
        return table
    # resolved, as a cycle may pass through links
    values, seen = {"name": path.stem, **table.values}, [path.resolve()]
    reached: set[str] = set()
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
        reached.update(_reached_warnings(values, inherited))
        values = _merged(values, _without_warnings(inherited, reached), _TABLES_DEEP)
    return Fields(values, table.where)


def _built_in(name: str) -> Path:
    return templates_folder() / "fabs" / f"{name}.toml"


def _parent(child: Path, name: object, where: str) -> Path:
    """File of the profile that `child` extends: one of the package by name, or a file by its path from the child's folder."""
    known = profile_names("fabs")
    if isinstance(name, str) and name in known:
        return _built_in(name)
    if isinstance(name, str) and is_profile_file(name):
        return child.parent / name
    near = difflib.get_close_matches(name, known, n=1) if isinstance(name, str) else []
    hint = f"did you mean '{near[0]}'?" if near else "give one of them"
    raise _refusal(where, f"= {shown(name)} is none of: {', '.join(known)}, nor the path of a .toml file; {hint}")


def _refusal(where: str, message: str) -> SpecError:
    return SpecError(Problem(f"{where}extends", f"{where}extends {message}"))


def _reached_warnings(own: Mapping[str, Any], inherited: Mapping[str, Any]) -> Iterator[str]:
    """Limits whose own ``value_mm`` reaches the inherited ``warn_mm``, so that no value is left for a warning."""
    for rule, limit in _limits(own).items():
        value_mm, warn_mm = limit.get("value_mm"), _limits(inherited).get(rule, {}).get("warn_mm")
        if "warn_mm" in limit or not (isinstance(value_mm, int | float) and isinstance(warn_mm, int | float)):
            continue
        if value_mm >= warn_mm:
            yield rule


def _without_warnings(values: Mapping[str, Any], rules: Collection[str]) -> Mapping[str, Any]:
    """The values without the ``warn_mm`` of some limits."""
    without = {
        rule: {key: value for key, value in limit.items() if key != "warn_mm"}
        for rule, limit in _limits(values).items()
        if rule in rules
    }
    return {**values, "limits": {**values["limits"], **without}} if without else values


def _limits(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Those of a profile's limits that are tables, as they all should be."""
    limits = values.get("limits")
    return {rule: limit for rule, limit in limits.items() if isinstance(limit, dict)} if isinstance(limits, dict) else {}


def _merged(own: Mapping[str, Any], inherited: Mapping[str, Any], deep: int) -> dict[str, Any]:
    """Merge two tables; values of `own` take precedence."""
    merged = {**inherited, **own}
    for key in own.keys() & inherited.keys():
        if deep > 0 and isinstance(own[key], dict) and isinstance(inherited[key], dict):
            merged[key] = _merged(own[key], inherited[key], deep - 1)
    return merged
