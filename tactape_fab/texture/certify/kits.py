"""Certificates of several tapes: distances between windows, within each tape and across all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.pool import Workers, mapped
from tactape_fab.texture.certify.certificate import SIDES, Certificate, certify, proven_between
from tactape_fab.texture.certify.pairs import BEYOND, Across, Conflict, across, conflicts
from tactape_fab.texture.registry import Registered, labels, read_registered, taken_once
from tactape_fab.texture.tape import Tape

MOST_IN_MATRIX = 256
"""Most tapes for which a registry's JSON lists the distance of every pair of tapes."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Certified:
    """Certificates of tapes, their names, and window distances between tapes; `across` is empty for one tape."""

    names: tuple[str, ...]
    certificates: tuple[Certificate, ...]
    across: tuple[Across, ...]

    @property
    def tapes(self) -> list[Tape]:
        return [c.tape for c in self.certificates]

    def to_mapping(self) -> dict[str, Any]:
        return {
            "tapes": [c.to_mapping() for c in self.certificates],
            "across": [across_mapping(a, self.names) for a in self.across],
            **_proven_mapping(self.tapes),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registry:
    """The tapes that a robot may touch, their names, distances and conflicts; and notes about kits that were given again."""

    entries: tuple[Registered, ...]
    names: tuple[str, ...]
    across: tuple[Across, ...]
    conflicts: tuple[Conflict, ...]
    again: tuple[str, ...] = ()

    @property
    def tapes(self) -> list[Tape]:
        return [e.tape for e in self.entries]

    def to_mapping(self) -> dict[str, Any]:
        with_matrix = len(self.entries) <= MOST_IN_MATRIX
        return {
            "tapes": [entry_mapping(e) for e in self.entries],
            "conflicts": [
                {"kind": c.kind, "tapes": [self.names[i] for i in c.tapes], "message": c.message} for c in self.conflicts
            ],
            "across": [{**across_mapping(a, self.names), "distances": a.rows() if with_matrix else None} for a in self.across],
            **_proven_mapping(self.tapes),
        }


def _proven_mapping(tapes: Sequence[Tape]) -> dict[str, Any]:
    proven = proven_between(tapes) if len(tapes) > 1 else {}
    return {"across_patches": [{"shape": shape, "bits": bits} for shape, bits in proven.items()]} if proven else {}


def entry_mapping(entry: Registered) -> dict[str, Any]:
    tape = entry.tape
    return {
        "name": tape.name,
        "path": str(entry.path),
        "sector": tape.sector,
        "code": tape.code,
        "origin": list(tape.origin),
        "columns": tape.columns,
        "rows": tape.rows,
        "size_mm": list(tape.board.size_mm),
        "pitch_mm": tape.pitch_mm,
        "displacement_mm": tape.displacement_mm,
        **({} if tape.points_in.usual else {"directions": tape.directions}),
        "tag": None if tape.tag is None else tape.tag.id,
        "fab": entry.fab,
    }


def across_mapping(windows: Across, names: Sequence[str]) -> dict[str, Any]:
    """JSON entry of one window size: the least distance between tapes, and the first of the nearest pairs."""

    def place(window: Sequence[int]) -> dict[str, Any]:
        tape, row, column = window
        return {"tape": names[tape], "cell": [column, row]}

    listed = zip(windows.first.tolist(), windows.second.tolist(), windows.turn.tolist(), strict=True)
    return {
        "side": windows.side,
        "distance": windows.distance,
        "at_least": windows.distance == BEYOND,
        "pairs": windows.pairs,
        "nearest": [{"windows": [place(a), place(b)], "turn_deg": 90 * turn} for a, b, turn in listed],
    }


def certified(
    tapes: Sequence[Tape],
    names: Sequence[str] | None = None,
    progress: Progress = lambda *_: None,
    *,
    workers: Workers = 1,
) -> Certified:
    """Certify each tape, and compare the windows of every two.

    names: Names of the tapes in the result; None for the tapes' own names.
    progress: Called with a text, the number done and the total.
    workers: Number of processes, or the address of a Dask scheduler.
    """
    certificates = []
    for i, certificate in enumerate(mapped(certify, tapes, workers)):
        certificates.append(certificate)
        if len(tapes) > 1:
            progress("tapes", i + 1, len(tapes))
    return Certified(
        names=tuple(t.name for t in tapes) if names is None else tuple(names),
        certificates=tuple(certificates),
        across=_across_all(tapes, progress, workers) if len(tapes) > 1 else (),
    )


def registry(paths: Sequence[str | Path], progress: Progress = lambda *_: None, *, workers: Workers = 1) -> Registry:
    """Read the kits at the given paths, and compare every two; `workers` as for `certified`.

    Raises SpecError with every problem of the paths.
    """
    entries, again = taken_once(read_registered(paths))
    tapes, names = [e.tape for e in entries], labels(entries)
    windows = _across_all(tapes, progress, workers)
    found = conflicts(tapes, names, windows[0])
    return Registry(entries=tuple(entries), names=names, across=windows, conflicts=tuple(found), again=tuple(again))


def _across_all(tapes: Sequence[Tape], progress: Progress, workers: Workers) -> tuple[Across, ...]:
    found = []
    for i, windows in enumerate(mapped(partial(across, tapes), SIDES, workers)):
        found.append(windows)
        if len(tapes) > 1:
            progress("window sizes", i + 1, len(SIDES))
    return tuple(found)


def nearest_tapes(windows: Across, count: int) -> list[tuple[int, int, int]]:
    """The `count` nearest pairs of tapes as (index, index, distance), nearest first."""
    a, b = np.nonzero(np.triu(windows.matrix <= BEYOND, 1))
    distance = windows.matrix[a, b]
    order = np.lexsort((b, a, distance))[:count]
    return [(int(a[i]), int(b[i]), int(distance[i])) for i in order]
