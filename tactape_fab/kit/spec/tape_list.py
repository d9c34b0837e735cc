"""Lists of tapes: sector ranges and spec files with several tapes, expanded to one set of values per tape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.base.templates import is_profile_file
from tactape_fab.kit.spec.sectors import MOST_TAPES, read_sectors_of
from tactape_fab.kit.spec.tape_spec import PROFILE_KEYS, read_spec_file
from tactape_fab.texture.code import DEFAULT_CODE

_OF_ONE = ("sector", "sectors", "name")
"""Keys that must differ between the tapes of a list."""
_OF_A_PANEL = ("panel", "same_sector", "tabs")
"""Panel options other than sectors, which a list of tapes must not have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TapeEntry:
    """One tape of a list: its values, still untrusted, and its name in messages.

    ``where`` is the table it comes from (``""`` or ``"tapes[3]: "``), ``of_sector`` distinguishes it from the others of that
    table (``""`` or ``"sector 7: "``).
    """

    where: str
    of_sector: str = ""
    values: Mapping[str, Any]


def is_list(values: Mapping[str, Any], options: Mapping[str, Any]) -> bool:
    """Whether a spec file's values, with the options that override them, describe several tapes."""
    return "tapes" in values or "sectors" in options or ("sectors" in values and "sector" not in options)


def read_list_file(path: Path) -> dict[str, Any]:
    """The values of a spec TOML, of one tape or of several; profile paths in it are relative to the file.

    Raises SpecError if the file cannot be read as TOML.
    """
    values = read_spec_file(path)
    tapes = values.get("tapes")
    for tape in tapes if isinstance(tapes, list) else ():
        for key in PROFILE_KEYS:
            name = tape.get(key) if isinstance(tape, dict) else None
            if isinstance(name, str) and is_profile_file(name):
                tape[key] = str(path.parent / name)
    return values


def read_list(values: Mapping[str, Any], options: Mapping[str, Any]) -> tuple[list[TapeEntry], list[Problem]]:
    """One entry per tape, from the values of a spec file and from options, which override them.

    The problems are those of the list itself; those of a tape are found when its spec is built. If sectors are refused they are
    replaced by sector 0, so that everything else can be checked.
    """
    problems = _contradictions(values, options) + _of_panels({**values, **options})
    options = {key: value for key, value in options.items() if key not in _OF_A_PANEL}
    shared = {key: value for key, value in values.items() if key not in ("tapes", *_OF_A_PANEL)}
    entries: list[TapeEntry] = []
    if "tapes" not in values and "sectors" not in {**shared, **options}:
        problems.append(Problem("sectors", 'sectors is missing; give sectors = "0-9", or a list of tapes'))
    elif "tapes" not in values:
        entries = _of_sectors({**shared, **options}, "", problems)
    elif not isinstance(values["tapes"], list) or not values["tapes"]:
        given = shown(values["tapes"])
        problems.append(Problem("tapes", f"tapes = {given} is no list of tapes; give each a table of its own, [[tapes]]"))
    elif len(values["tapes"]) > MOST_TAPES:
        message = f"tapes = {len(values['tapes'])} tables, more than {MOST_TAPES}; make them in several runs"
        return [], [*problems, Problem("tapes", message)]
    else:
        overriding = {key: value for key, value in options.items() if key not in _OF_ONE}
        common = {key: value for key, value in shared.items() if key not in _OF_ONE}
        for i, tape in enumerate(values["tapes"]):
            where = f"tapes[{i}]: "
            if isinstance(tape, dict):
                problems += _of_panels(tape, where)
                own = {key: value for key, value in tape.items() if key not in _OF_A_PANEL}
                entries += _of_table({**common, **own, **overriding}, where, problems)
            else:
                problems.append(Problem("tapes", f"{where}{shown(tape)} is no table; give it as [[tapes]]"))
            # checked while reading, as a range may have thousands of sectors
            if len(entries) > MOST_TAPES:
                break
    if len(entries) > MOST_TAPES:
        message = f"these are at least {len(entries)}, more than {MOST_TAPES} tapes; make them in several runs"
        return [], [*problems, Problem("tapes", message)]
    return entries, problems


def _contradictions(values: Mapping[str, Any], options: Mapping[str, Any]) -> list[Problem]:
    """Problems of keys that would apply to several tapes although they must differ."""
    several = "tapes" in values
    found = []
    for source in (options, values):
        if "sector" in source and "sectors" in source:
            message = f"sector = {shown(source['sector'])} contradicts sectors = {shown(source['sectors'])}; give one of them"
            found.append(Problem("sector", message))
        for key in _OF_ONE if several else ("name",):
            if key in source:
                why = "each of [[tapes]] has its own" if several else "each tape is named for its sector"
                found.append(Problem(key, f"{key} = {shown(source[key])} cannot be that of all tapes: {why}; leave it out"))
    return found


def _of_panels(values: Mapping[str, Any], where: str = "") -> list[Problem]:
    """Problems of panel options in a list, whose tapes are made without a panel."""
    return [
        Problem(key, f"{where}{key} = {shown(values[key])} is of a panel, and these tapes are made one by one; leave it out")
        for key in _OF_A_PANEL
        if values.get(key) not in (None, False)
    ]


def _of_table(values: Mapping[str, Any], where: str, problems: list[Problem]) -> list[TapeEntry]:
    if "sector" in values and "sectors" in values:
        message = f"sector = {shown(values['sector'])} contradicts sectors = {shown(values['sectors'])}; give one of them"
        problems.append(Problem("sector", where + message))
    elif "sectors" in values:
        if "name" in values:
            message = f"{where}name = {shown(values['name'])} cannot be that of all sectors; leave it out"
            problems.append(Problem("name", message))
        return _of_sectors(values, where, problems)
    elif "sector" not in values:
        problems.append(Problem("sector", f'{where}sector is missing; give sector = N, or sectors = "0-9"'))
    return [TapeEntry(where=where, values={"sector": 0, **{k: v for k, v in values.items() if k != "sectors"}})]


def _of_sectors(values: Mapping[str, Any], where: str, problems: list[Problem]) -> list[TapeEntry]:
    try:
        sectors = read_sectors_of(values["sectors"], values.get("code", DEFAULT_CODE))
    except SpecError as error:
        problems += [Problem(p.key, where + p.message) for p in error.problems]
        sectors = (0,)
    rest = {key: value for key, value in values.items() if key not in _OF_ONE}
    return [TapeEntry(where=where, of_sector=f"sector {sector}: ", values={**rest, "sector": sector}) for sector in sectors]
