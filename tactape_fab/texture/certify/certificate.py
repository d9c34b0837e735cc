"""Certificate of a tape: the exact distances between its windows.

Distances are Hamming distances in symbols: the number of grid points at which two windows differ, over all pairs of whole
windows of a size and all four turns of one against the other. A turned window's symbols turn with it (N to W to S to E by 90
degrees counter-clockwise). A window is also compared with its own turns: one that equals itself turned gives its place, but
not its angle. Windows with a grid point without a part do not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tactape_fab.texture.certify.nearest import Pairs, near_pairs, plan_search
from tactape_fab.texture.code import get_code
from tactape_fab.texture.frames import IntArray
from tactape_fab.texture.tape import Tape, refuse_no_tape
from tactape_fab.texture.touch.patches import PatchDistance, patch_distances
from tactape_fab.texture.windows import Windows, windows_of

CERTIFICATE_FORMAT = "tactape-certificate/1"
SIDES = (4, 5, 6)
"""Sides of the windows that are certified, in grid points."""
LISTED = 20
"""Number of nearest pairs that are listed, row by row."""
LEAST_SIDE, MOST_SIDE = 3, 8
"""Sides of the squares tried as smallest contacts."""
CORRECTING = 3
"""Least Hamming distance at which one wrong symbol can be corrected."""
_STEPS = (0, 2, 4, 6, 8, 10, 12, 18, 25, 36, 49, 64)
"""Search radii, tried in order until pairs are found. Large tapes have equal small windows, which radius 0 finds in one sort; the
nearest 6x6 windows of a usual tape are 5 to 10 apart, and radius 12 takes ten times as long as 8."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closest:
    """The nearest windows of one size on one tape.

    windows: Number of whole windows.
    distance: Least number of differing symbols; None without windows.
    pairs: Number of pairs at that distance.
    first_rc, second_rc (k, 2): Row and column of the upper left grid points of the first `LISTED` of them.
    turn (k,): Quarter turns counter-clockwise of the second that make it like the first.
    """

    side: int
    windows: int
    distance: int | None
    pairs: int
    first_rc: IntArray
    second_rc: IntArray
    turn: IntArray

    @property
    def detects(self) -> int | None:
        """Largest number of wrong symbols that never turns a window into another one."""
        # at minimum distance d, d - 1 errors are detected and (d - 1) // 2 are corrected
        return None if self.distance is None else max(self.distance - 1, 0)

    @property
    def corrects(self) -> int | None:
        """Largest number of wrong symbols at which the true window is still the nearest one."""
        return None if self.distance is None else max((self.distance - 1) // 2, 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Certificate:
    """Distances between the windows of a tape.

    sizes: One for each of `SIDES`.
    distinct_side, correcting_side: Side of the smallest square, from 3 to 8, whose windows all differ by at least one symbol, and
        by three; None if even the largest do not, or if the tape has none of that size.
    patches: Bit distances of small patches, for codes that promise any; empty for codes of number sequences.
    """

    tape: Tape
    sizes: tuple[Closest, ...]
    distinct_side: int | None
    correcting_side: int | None
    patches: tuple[PatchDistance, ...] = ()

    def of_side(self, side: int) -> Closest:
        """The closest windows of so many grid points a side; ValueError for a side that is not in `SIDES`."""
        return self.sizes[SIDES.index(side)]

    def to_mapping(self) -> dict[str, Any]:
        """The content of the kit's certificate file, computed from the tape alone."""
        tape = self.tape
        number = np.cumsum(tape.placed.ravel(), dtype=np.int64)
        return {
            "format": CERTIFICATE_FORMAT,
            "name": tape.name,
            "code": tape.code,
            "sector": tape.sector,
            "origin": list(tape.origin),
            "columns": tape.columns,
            "rows": tape.rows,
            "parts": tape.part_count,
            "windows": [_size_mapping(size, number, tape.columns) for size in self.sizes],
            "smallest_contact": {"told_apart": self.distinct_side, "one_wrong_symbol": self.correcting_side},
            **({"open_turns_deg": list(tape.part.open_turns_deg)} if get_code(tape.code).half_turns else {}),
            **({"patches": [patch.to_mapping() for patch in self.patches]} if self.patches else {}),
        }


def _size_mapping(size: Closest, number: IntArray, columns: int) -> dict[str, Any]:
    def window(row: int, column: int) -> dict[str, Any]:
        return {"cell": [column, row], "designator": f"R{number[row * columns + column]}"}

    listed = zip(size.first_rc.tolist(), size.second_rc.tolist(), size.turn.tolist(), strict=True)
    return {
        "side": size.side,
        "count": size.windows,
        "distance": size.distance,
        "detects": size.detects,
        "corrects": size.corrects,
        "pairs": size.pairs,
        "nearest": [{"windows": [window(*a), window(*b)], "turn_deg": 90 * turn} for a, b, turn in listed],
    }


def pair_words(tape: Tape, size: Closest, i: int) -> str:
    """Description of the i-th nearest pair: designators and cells of the upper left parts, and the turn."""
    first, second = (window_words(tape, *rc.tolist()) for rc in (size.first_rc[i], size.second_rc[i]))
    return f"{first} and {second}{turn_words(int(size.turn[i]))}"


def window_words(tape: Tape, row: int, column: int) -> str:
    """Description of a window by its upper left part."""
    number = int(tape.placed.ravel()[: row * tape.columns + column + 1].sum())
    return f"R{number} (column {column}, row {row})"


def turn_words(turn: int) -> str:
    return f" turned by {90 * turn} deg" if turn else ""


def certify(tape: Tape) -> Certificate:
    """Certify a tape; distances are exact, and equal tapes give equal certificates.

    Parameters
    ----------
    tape : Tape

    Returns
    -------
    Certificate
        By window size: least distance in symbols, and what it detects and corrects.
    """
    refuse_no_tape(tape)
    sizes: tuple[Closest, ...] = ()
    for side in SIDES:
        sizes = (*sizes, closest(tape, side, (sizes[-1].distance or 0) if sizes else 0))
    return Certificate(
        tape=tape,
        sizes=sizes,
        distinct_side=_smallest(tape, sizes, 1),
        correcting_side=_smallest(tape, sizes, CORRECTING),
        patches=_patches(tape),
    )


def _patches(tape: Tape) -> tuple[PatchDistance, ...]:
    """Distances of small patches, for codes that promise any; codes of sequences do not."""
    code = get_code(tape.code)
    if code.sequences is not None:
        return ()
    found = patch_distances(tape.symbols, tape.present, tape.directions, half_turns=code.half_turns)
    return tuple(replace(patch, proven=code.proven.get(patch.shape)) for patch in found)


def proven_between(tapes: Sequence[Tape]) -> dict[str, int]:
    """Proven least distance in bits, by shape, between patches of any of these tapes at a known turn; empty if none is proven.

    Sectors of a code are parts of one plane, so that a distance proven for all places holds between tapes of different sectors.
    """
    codes, sectors = {tape.code for tape in tapes}, {tape.sector for tape in tapes}
    return dict(get_code(codes.pop()).proven) if len(codes) == 1 and len(sectors) == len(tapes) else {}


def _smallest(tape: Tape, known: tuple[Closest, ...], least: int) -> int | None:
    """The smallest side whose windows differ by at least `least`; the distance never decreases with the side."""
    distance = {size.side: size.distance for size in known}
    # larger squares only if 6x6 falls short, and 3x3 only if 4x4 reaches it: both searches take long
    for side in range(max(SIDES) + 1, MOST_SIDE + 1) if (distance[max(SIDES)] or 0) < least else ():
        distance[side] = closest(tape, side, distance[side - 1] or 0).distance
    # a 4x4 window contains 3x3 ones: if 4x4 does not reach the distance, 3x3 does not either
    if (distance[min(SIDES)] or 0) >= least:
        distance[LEAST_SIDE] = closest(tape, LEAST_SIDE).distance
    return min((side for side, apart in distance.items() if (apart or 0) >= least), default=None)


def closest(tape: Tape, side: int, at_least: int = 0) -> Closest:
    """The nearest windows of one size, whatever their distance; see `closest_windows`."""
    return closest_windows(windows_of(tape.symbols, tape.present, side, directions=tape.directions), at_least)


def closest_windows(windows: Windows, at_least: int = 0) -> Closest:
    """The nearest of given windows, whatever their distance.

    at_least: Known lower bound of the distance, such as that of smaller windows of the same tape: it only saves time.
    """
    found: list[Pairs] = []
    least = windows.side**2 + 1
    # the search radius grows until pairs are found, as small radii are fast; it starts at the known lower bound
    for most in (step for step in _STEPS if step >= min(at_least, windows.side**2)):
        search = plan_search(windows.side, windows.count, min(most, windows.side**2))
        pairs = 0
        for some in near_pairs(windows.words, search, bits=windows.bits) if windows.count else ():
            nearest = int(some.distance.min(initial=least + 1))
            if nearest < least:
                least, pairs, found = nearest, 0, []
            if nearest == least:
                alike = np.flatnonzero(some.distance == least)
                pairs += len(alike)
                found = [first_pairs([*found, some.taken(alike)])]
        # all pairs up to `most` were compared, so that a nearest one among them is the nearest of all
        if pairs or search.most >= windows.side**2:
            break
    listed = found[0] if found else None
    none = np.zeros((0, 2), dtype=np.int64)
    return Closest(
        side=windows.side,
        windows=windows.count,
        distance=least if listed is not None else None,
        pairs=pairs,
        first_rc=none if listed is None else windows.corner_rc[listed.first],
        second_rc=none if listed is None else windows.corner_rc[listed.second],
        turn=none[:, 0] if listed is None else listed.turn,
    )


def nearest_distances(tape: Tape, side: int, most: int) -> tuple[IntArray, IntArray]:
    """Upper left (row, column) of each window, shape (n, 2), and its distance in symbols to the nearest other, shape (n,).

    A distance beyond `most` is given as ``most + 1``.
    """
    windows = windows_of(tape.symbols, tape.present, side, directions=tape.directions)
    distance = np.full(windows.count, most + 1, dtype=np.int64)
    for pairs in near_pairs(windows.words, plan_search(side, windows.count, most), bits=windows.bits):
        for end in (pairs.first, pairs.second):
            # a window may be in several pairs: plain indexing would keep the last of them
            np.minimum.at(distance, end, pairs.distance)
    return windows.corner_rc, distance


def first_pairs(portions: list[Pairs]) -> Pairs:
    """The first `LISTED` of all pairs, in the order of their windows and turns."""
    first, second, turn, distance = (
        np.concatenate([getattr(p, name) for p in portions]) for name in ("first", "second", "turn", "distance")
    )
    return Pairs(first=first, second=second, turn=turn, distance=distance).taken(np.lexsort((turn, second, first))[:LISTED])
