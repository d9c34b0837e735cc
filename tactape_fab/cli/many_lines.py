"""Results of lists of tapes as lines of text and as JSON, for the command line to print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.kit.examine.tape_lists import Planned
from tactape_fab.make.many import FailedKit, MadeKit, PackedFilm

_NAMED = 3


class KitTable:
    """Kits as rows of a table, one by one: widths come from the list."""

    def __init__(self, tapes: Sequence[Planned]) -> None:
        self._name_width = max(len("kit"), *(len(tape.spec.name) for tape in tapes))
        self._size_width = max(len("size mm"), *(len(_size(tape.spec.size_mm)) for tape in tapes))

    def header(self) -> str:
        return self._row("kit", "sector", "size mm", "grid", "parts", "result")

    def row(self, kit: MadeKit | FailedKit, tape: Planned) -> str:
        if isinstance(kit, FailedKit):
            return self._row(kit.name, str(kit.sector), _size(tape.spec.size_mm), "", "", "failed")
        verified = f"{kit.checks} checks" if kit.checks else "not verified"
        grid = f"{kit.columns}x{kit.rows}"
        return self._row(kit.name, str(kit.sector), _size(kit.size_mm), grid, str(kit.parts), verified)

    def _row(self, name: str, sector: str, size: str, grid: str, parts: str, result: str) -> str:
        name, size = name.ljust(self._name_width), size.ljust(self._size_width)
        return f"{name}  {sector:>6}  {size}  {grid:>9}  {parts:>6}  {result}"


def _size(size_mm: Sequence[float]) -> str:
    return f"{size_mm[0]:g}x{size_mm[1]:g}"


def many_summary(made: int, count: int, folder: Path, seconds: float) -> str:
    """What became of a list, and how fast."""
    rate = f", {made / seconds:.2g} kits/s" if made and seconds > 0.0 else ""
    return f"made {made} of {_count(count, 'kit')} in {folder}; {seconds:.1f} s{rate}"


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def packed_lines(films: Sequence[PackedFilm]) -> list[str]:
    """Sheets of each film, their yield, and what lies on them."""
    lines = []
    for film in films:
        packing, panel = film.packing, film.fab.panel
        shares = _shares(film)
        lines.append(
            f"packed {_count(len(film.tapes), 'tape')} into {_count(packing.sheets, 'panel')} "
            f"of {_size(panel.largest_mm)} mm ({film.fab.name}, rails {panel.rail_mm:g} mm, gaps {panel.gap_mm:g} mm): "
            f"{np.mean(shares):.1%} of the area is tape"
        )
        for sheet, share in enumerate(shares):
            names = [film.tapes[i].spec.name for i in np.flatnonzero(packing.sheet == sheet)]
            turned = int(packing.turned[packing.sheet == sheet].sum())
            said = ", ".join(names) if len(names) <= _NAMED else f"{names[0]} ... {names[-1]}"
            lines.append(
                f"  panel {sheet + 1}: {_count(len(names), 'tape')}{f', {turned} turned' * (turned > 0)}, {share:.1%}: {said}"
            )
    return lines


def _shares(film: PackedFilm) -> list[float]:
    """Share of each panel's area that is tape."""
    width_mm, height_mm = film.fab.panel.largest_mm
    return [float(area) / (width_mm * height_mm) for area in film.packing.tape_area_mm2()]


def packed_json(films: Sequence[PackedFilm]) -> list[dict[str, Any]]:
    """Sheets with the places of their tapes, in the frame of the panel: its lower left corner, rails included."""
    found = []
    for film in films:
        packing, panel = film.packing, film.fab.panel
        offsets_mm = packing.offset_mm + panel.rail_mm + panel.gap_mm
        sheets = [
            {
                "share": round(share, 6),
                "tapes": [
                    {
                        "name": film.tapes[i].spec.name,
                        "offset_mm": [round(float(v), 6) for v in offsets_mm[i]],
                        "rotation_deg": 90.0 if packing.turned[i] else 0.0,
                    }
                    for i in np.flatnonzero(packing.sheet == sheet).tolist()
                ],
            }
            for sheet, share in enumerate(_shares(film))
        ]
        share = sum(_shares(film)) / len(sheets)
        found.append({"fab": film.fab.name, "panel_mm": list(panel.largest_mm), "share": round(share, 6), "panels": sheets})
    return found


def made_json(kit: MadeKit) -> dict[str, Any]:
    return {
        "path": str(kit.path),
        "name": kit.name,
        "sector": kit.sector,
        "code": kit.code,
        "origin": list(kit.origin),
        "columns": kit.columns,
        "rows": kit.rows,
        "parts": kit.parts,
        "size_mm": list(kit.size_mm),
        "files": dict(kit.files),
        "checks": kit.checks,
    }


def failed_json(kit: FailedKit, status: int, lines: Sequence[str]) -> dict[str, Any]:
    return {"path": str(kit.path), "name": kit.name, "sector": kit.sector, "status": status, "errors": list(lines)}
