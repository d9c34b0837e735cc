"""Options of a panel, read from untrusted values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tactape_fab.base.errors import Problem, tried
from tactape_fab.base.fields import Fields, shown
from tactape_fab.kit.spec.sectors import read_sectors_of
from tactape_fab.texture.code import DEFAULT_CODE

PANEL_KEYS = ("panel", "sectors", "same_sector", "tabs")
TAB_SIDES = ("auto", "x", "y", "xy")
MOST_ALONG = 100
"""Most tapes along a side of a panel."""
_ARRANGEMENT = re.compile(r"(\d{1,3})x(\d{1,3})")


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelRequest:
    """Checked options of a panel.

    mode {"auto", "none", "given"}: None if not given, which leaves it to the fab profile.
    arrangement: Columns and rows, if given.
    sectors: Sectors of the tapes, if given.
    same_sector: Whether every tape shows the same sector.
    tabs: Sides of a tape with tabs, one of TAB_SIDES.
    """

    mode: str | None
    arrangement: tuple[int, int] | None
    sectors: tuple[int, ...] | None
    same_sector: bool
    tabs: str

    @property
    def asked_for(self) -> bool:
        """Whether a panel was asked for explicitly."""
        return self.mode in ("auto", "given")


def read_panel_request(values: Mapping[str, Any], *, films: bool = True) -> tuple[PanelRequest, list[Problem]]:
    """Read the keys of a panel from untrusted values; every problem is listed.

    films: Whether the tapes are films. Only films are put on panels, so that remedies for others do not name one.
    """
    table = Fields({key: values[key] for key in (*PANEL_KEYS, "code") if values.get(key) is not None})
    mode, arrangement = _mode(table)
    sectors = None
    if "sectors" in table.values:
        code = table.values.get("code", DEFAULT_CODE)
        sectors = tried(lambda: read_sectors_of(table.values["sectors"], code), table.problems)
    same_sector = table.flag("same_sector") if "same_sector" in table.values else False
    tabs = table.choice("tabs", TAB_SIDES)
    if sectors is not None and values.get("sector") is not None:
        table.problem(
            "sectors", f"sectors = {shown(values['sectors'])} and sector = {shown(values['sector'])} are given; give one of them"
        )
    if sectors is not None and same_sector:
        message = f"same_sector contradicts sectors = {shown(values['sectors'])}, one for each tape"
        table.problem("same_sector", f"{message}; give --sector N in their place")
    if mode == "none":
        for key in (k for k in PANEL_KEYS[1:] if table.values.get(k, False) is not False):
            option = f"--{key.replace('_', '-')}"
            other = ", or use --panel auto" if films else ""
            table.problem(key, f"{key} is of a panel, but panel = 'none'; leave out {option}{other}")
    request = PanelRequest(mode=mode, arrangement=arrangement, sectors=sectors, same_sector=same_sector, tabs=tabs)
    return request, table.problems


def _mode(table: Fields) -> tuple[str | None, tuple[int, int] | None]:
    if "panel" not in table.values:
        return None, None
    value = table.values["panel"]
    if value in ("auto", "none"):
        return str(value), None
    found = _ARRANGEMENT.fullmatch(value.replace("×", "x").replace("X", "x")) if isinstance(value, str) else None
    if found is None:
        table.problem("panel", f"panel = {shown(value)} is no arrangement; give columns x rows, such as 2x3, or auto, or none")
        return None, None
    columns, rows = int(found[1]), int(found[2])
    if not (1 <= columns <= MOST_ALONG and 1 <= rows <= MOST_ALONG):
        table.problem("panel", f"panel = {value} has {columns} columns and {rows} rows; give 1 to {MOST_ALONG} of each")
        return None, None
    return "given", (columns, rows)
