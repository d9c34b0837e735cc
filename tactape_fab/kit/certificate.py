"""The certificate of a tape, worked out once for tapes that show the same: making a kit and verifying it ask for the same one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

from tactape_fab.texture.certify import Certificate, certify
from tactape_fab.texture.tape import Tape


def certificate_of(tape: Tape) -> Certificate:
    """The certificate as `certify` works it out."""
    grid = _Grid(columns=tape.columns, code=tape.code, symbols=tape.symbols.tobytes(), placed=tape.placed.tobytes(), tape=tape)
    return replace(_certified(grid), tape=tape)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Grid:
    """All that windows are made of: grids are equal where no window of them differs."""

    columns: int
    code: str
    symbols: bytes
    placed: bytes
    tape: Tape = field(compare=False)


@lru_cache(maxsize=8)
def _certified(grid: _Grid) -> Certificate:
    return certify(grid.tape)
