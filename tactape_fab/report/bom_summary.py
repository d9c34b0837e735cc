"""Summary of a bill of materials for a report: rows that differ only in their designators are joined."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tactape_fab.kit.profiles.assembly import FORMATS
from tactape_fab.kit.read.readback import csv_lines


def bom_lines(data: bytes, manifest: Mapping[str, Any]) -> list[list[str]]:
    """The header, and a row for each kind of part.

    A file has at most 200 designators per row. Rows of one part are joined: designators are concatenated, quantities added.

    data: The bytes of the file.
    manifest: Its ``assembly`` gives the format.
    """
    head, *rows = csv_lines(data.decode("utf-8-sig"))
    table = FORMATS[str(manifest["assembly"]["format"])].bom
    kinds = [kind for _, kind in table.columns]
    if len(head) != len(kinds) or any(len(row) != len(kinds) for row in rows):
        return [head, *rows]
    groups: dict[tuple[str, ...], list[list[str]]] = {}
    for row in rows:
        same = tuple(cell for cell, kind in zip(row, kinds, strict=True) if kind not in ("item", "designator", "quantity"))
        groups.setdefault(same, []).append(row)
    return [head, *(_joined(group, kinds) for group in groups.values())]


def _joined(rows: list[list[str]], kinds: list[str]) -> list[str]:
    joined = list(rows[0])
    for at, kind in enumerate(kinds):
        cells = [row[at] for row in rows]
        if kind == "designator":
            joined[at] = ",".join(cells)
        elif kind == "quantity" and all(cell.isdigit() for cell in cells):
            joined[at] = str(sum(map(int, cells)))
    return joined
