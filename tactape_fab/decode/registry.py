"""Registered tapes: equal ones once, and the family of tapes that nobody registered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tactape_fab.decode.rivals import Family, build_family
from tactape_fab.texture.code import encode, get_code
from tactape_fab.texture.tape import Tape


def distinct(tapes: Sequence[Tape]) -> list[Tape]:
    """Registered tapes, equal ones once: the union of their grids under the first one's name."""
    kept: dict[tuple[object, ...], Tape] = {}
    for tape in tapes:
        key = (tape.code, tape.sector, tape.origin, tape.pitch_mm, tape.displacement_mm)
        kept[key] = _union(kept[key], tape) if key in kept else tape
    return list(kept.values())


def _union(first: Tape, other: Tape) -> Tape:
    """The first tape with the grid points of both."""
    columns, rows = max(first.columns, other.columns), max(first.rows, other.rows)
    placed = np.zeros((rows, columns), dtype=bool)
    for tape in (first, other):
        placed[: tape.rows, : tape.columns] |= tape.placed
    return replace(
        first,
        columns=columns,
        rows=rows,
        symbols=encode(get_code(first.code), first.sector, first.origin, (rows, columns)),
        omitted=np.argwhere(~placed)[:, ::-1].astype(np.int64),
    )


def families(tapes: Sequence[Tape], pad: int) -> dict[str, Family]:
    of_code: dict[str, list[tuple[int, tuple[int, int], int, int]]] = {}
    for tape in tapes:
        of_code.setdefault(tape.code, []).append((tape.sector, tape.origin, tape.columns, tape.rows))
    return {name: build_family(get_code(name), rows, pad) for name, rows in of_code.items()}
