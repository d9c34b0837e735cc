"""Window distances between every two of several tapes, and conflicts between tapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.base.fields import Fields
from tactape_fab.texture.certify.certificate import first_pairs
from tactape_fab.texture.certify.nearest import Pairs, near_pairs, plan_search
from tactape_fab.texture.code import get_code
from tactape_fab.texture.frames import IntArray
from tactape_fab.texture.tape import Tape, refuse_no_tapes
from tactape_fab.texture.windows import Windows, WordArray, windows_of

EXACT_TO = 4
"""Largest exact distance between tapes; beyond it a distance is only known to be larger."""
BEYOND = EXACT_TO + 1
"""Matrix value for "at least 5"."""
NO_WINDOWS = 255
"""Matrix value if one of the tapes has no whole window of the size."""
_STEPS = (0, 2, 3, EXACT_TO)


MOST_SIDE = 16
"""Largest side of windows that can be compared, in grid points."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Across:
    """Distances of one window size between tapes.

    matrix (tapes, tapes): Least number of differing symbols between windows of two different tapes, in any turn: 0 to `EXACT_TO`,
        `BEYOND` for more, `NO_WINDOWS`. On the diagonal `NO_WINDOWS`.
    shared (tapes, tapes): Number of pairs of equal windows of two different tapes, in any turn.
    distance: The least of the matrix: `BEYOND` means at least that; None where no two tapes have windows.
    pairs: Number of pairs of windows at that distance; 0 where it is `BEYOND`.
    first, second (k, 3): Tape, row and column of the upper left grid points of the first `LISTED` of them.
    turn (k,): Quarter turns counter-clockwise of the second that make it like the first.
    """

    side: int
    matrix: npt.NDArray[np.uint8]
    shared: IntArray
    distance: int | None
    pairs: int
    first: IntArray
    second: IntArray
    turn: IntArray

    def rows(self) -> list[list[int | None]]:
        """The matrix as lists, with None for `NO_WINDOWS`."""
        return [[None if d == NO_WINDOWS else d for d in row] for row in self.matrix.tolist()]


def joined(windows: Sequence[Windows]) -> tuple[tuple[WordArray, ...], IntArray, IntArray]:
    """Concatenated windows of several tapes: words, index of the tape, and (row, column) of the corner of each."""
    words = tuple(np.concatenate([w.words[i] for w in windows], axis=1) for i in range(len(windows[0].words)))
    tape = np.repeat(np.arange(len(windows)), [w.count for w in windows])
    return words, tape, np.concatenate([w.corner_rc for w in windows])


def across(tapes: Sequence[Tape], side: int) -> Across:
    """Window distances between every two tapes; memory grows with the number of windows, not of pairs.

    A distance is the least over all windows and turns. The search goes on with larger distances only among tapes that
    are not yet known to be near another.

    Parameters
    ----------
    tapes : sequence of Tape
    side : int
        Grid points along a side of a window.

    Returns
    -------
    Across
        ``matrix`` has the least distance of every two tapes, in symbols.

    Raises
    ------
    SpecError
        If there is no tape, or no such window.
    """
    refuse_no_tapes(tapes, "tapes")
    table = Fields({"side": side})
    side = table.integer("side", low=1, high=MOST_SIDE)
    refuse(table.problems)
    if len(tapes) == 0:
        raise SpecError(Problem("tapes", "tapes holds no tape; give at least one"))
    count = len(tapes)
    # tapes of four directions are compared with those of eight in symbols of three bits
    directions = max((t.directions for t in tapes), default=4)
    windows = [windows_of(t.symbols, t.present, side, directions=directions) for t in tapes]
    words, tape_of, corner_rc = joined(windows)
    matrix = np.full((count, count), NO_WINDOWS, dtype=np.uint8)
    have = np.unique(tape_of)
    matrix[np.ix_(have, have)] = BEYOND
    np.fill_diagonal(matrix, NO_WINDOWS)
    shared = np.zeros((count, count), dtype=np.int64)
    least, pairs, listed = BEYOND, 0, _no_pairs()
    for most in _STEPS:
        # tapes whose distance from every other one is known are left out of wider searches
        unknown = np.flatnonzero((matrix == BEYOND).any(axis=1))
        if len(unknown) == 0:
            break
        kept = np.flatnonzero(np.isin(tape_of, unknown))
        search = plan_search(side, len(kept), most)
        # pairs at the least distance are counted by the search that first finds it; wider searches leave tapes out
        settled = least < BEYOND
        for found in near_pairs(tuple(w[:, kept] for w in words), search, bits=windows[0].bits):
            some = _between_tapes(found, kept, tape_of)
            a, b = tape_of[some.first], tape_of[some.second]
            np.minimum.at(matrix, (a, b), np.minimum(some.distance, BEYOND))
            if most == 0:
                np.add.at(shared, (a[some.distance == 0], b[some.distance == 0]), 1)
            nearest = int(some.distance.min(initial=BEYOND))
            if settled or nearest > least or nearest >= BEYOND:
                continue
            if nearest < least:
                least, pairs, listed = nearest, 0, _no_pairs()
            at_least = np.flatnonzero(some.distance == least)
            pairs += len(at_least)
            listed = first_pairs([listed, some.taken(at_least)])
        # pairs list the earlier tape first, and so fill only the upper triangle
        matrix = np.minimum(matrix, matrix.T)
    return Across(
        side=side,
        matrix=matrix,
        shared=shared + shared.T,
        distance=least if len(have) > 1 else None,
        pairs=pairs,
        first=np.column_stack([tape_of[listed.first], corner_rc[listed.first]]),
        second=np.column_stack([tape_of[listed.second], corner_rc[listed.second]]),
        turn=listed.turn,
    )


def _no_pairs() -> Pairs:
    none = np.zeros(0, dtype=np.int64)
    return Pairs(first=none, second=none, turn=none, distance=none.astype(np.uint8))


def _between_tapes(found: Pairs, kept: IntArray, tape_of: IntArray) -> Pairs:
    """Pairs of windows on different tapes, by index into all windows, the window of the earlier tape first."""
    first, second = kept[found.first], kept[found.second]
    other = np.flatnonzero(tape_of[first] != tape_of[second])
    first, second, turn = first[other], second[other], found.turn[other]
    swapped = first > second  # exchanging the windows inverts the turn
    return Pairs(
        first=np.where(swapped, second, first),
        second=np.where(swapped, first, second),
        turn=np.where(swapped, (4 - turn) % 4, turn),
        distance=found.distance[other],
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conflict:
    """Something that two tapes have in common and should not.

    kind {"same-tape", "overlap", "windows", "tag"}: They show the same place of the code, fully or partly; they have equal 4x4
        windows; their tags have the same id.
    tapes: Their indices in the registry.
    """

    kind: str
    tapes: tuple[int, int]
    message: str


def conflicts(tapes: Sequence[Tape], names: Sequence[str], windows: Across) -> list[Conflict]:
    """Every conflict of a registry, by kind and tapes.

    names: Names of the tapes.
    windows: Distances of the smallest windows, those of `SIDES[0]`.
    """
    return [*_plane_conflicts(tapes, names), *_window_conflicts(names, windows), *_tag_conflicts(tapes, names)]


def _plane_conflicts(tapes: Sequence[Tape], names: Sequence[str]) -> list[Conflict]:
    found = []
    groups: dict[tuple[str, int], list[int]] = {}
    for i, tape in enumerate(tapes):
        for k in groups.setdefault((tape.code, tape.sector), []):
            other = tapes[k]
            if get_code(tape.code).plane is None:
                if tape.texture_key == other.texture_key:
                    message = f"{names[k]} and {names[i]}: both have the symbols of one design, and cannot be told apart"
                    found.append(Conflict(kind="same-tape", tapes=(k, i), message=message))
                continue
            low = [max(tape.origin[axis], other.origin[axis]) for axis in (0, 1)]
            high = [min(t.origin[axis] + (t.columns, t.rows)[axis] for t in (tape, other)) for axis in (0, 1)]
            wide, tall = high[0] - low[0], high[1] - low[1]
            where = f"{names[k]} and {names[i]}: both show sector {tape.sector} of {tape.code}"
            if (tape.origin, tape.columns, tape.rows) == (other.origin, other.columns, other.rows):
                message = f"{where} at origin {tape.origin[0]},{tape.origin[1]}: they are the same tape, and cannot be told apart"
                found.append(Conflict(kind="same-tape", tapes=(k, i), message=message))
            elif wide > 0 and tall > 0:
                message = f"{where}, and {wide} x {tall} grid points of it at {low[0]},{low[1]} are on both"
                found.append(Conflict(kind="overlap", tapes=(k, i), message=message))
        groups[tape.code, tape.sector].append(i)
    return sorted(found, key=lambda c: (c.kind != "same-tape", c.tapes))


def _window_conflicts(names: Sequence[str], windows: Across) -> list[Conflict]:
    found = []
    for a, b in np.argwhere(np.triu(windows.shared) > 0).tolist():
        count, size = int(windows.shared[a, b]), f"{windows.side}x{windows.side}"
        message = f"{names[a]} and {names[b]}: {count} pair{'s' * (count != 1)} of {size} windows read the same"
        found.append(Conflict(kind="windows", tapes=(a, b), message=message))
    return found


def _tag_conflicts(tapes: Sequence[Tape], names: Sequence[str]) -> list[Conflict]:
    found = []
    first: dict[int, int] = {}
    for i, tape in enumerate(tapes):
        if tape.tag is None:
            continue
        k = first.setdefault(tape.tag.id, i)
        if k != i:
            message = f"{names[k]} and {names[i]}: both tags have id {tape.tag.id}"
            found.append(Conflict(kind="tag", tapes=(k, i), message=message))
    return found
