"""Search for the origin in the code plane that maximises the distances between a tape's windows, and from existing tapes.

The search tries a fixed number of origins in a fixed order, without a time limit: equal inputs give equal results.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.texture.certify.certificate import closest_windows
from tactape_fab.texture.certify.nearest import near_pairs, plan_search
from tactape_fab.texture.certify.pairs import BEYOND, joined
from tactape_fab.texture.code import default_origin
from tactape_fab.texture.frames import BoolArray
from tactape_fab.texture.plane import Plane, encode
from tactape_fab.texture.tape import Tape
from tactape_fab.texture.windows import Windows, windows_of

MOST_CANDIDATES = 160
MOST_BESIDE_OTHERS = 48
"""Most origins, or sectors, that are compared with existing tapes."""
_WINDOWS = 300_000
"""Most windows of all candidates together, so that a large tape is tried at fewer origins."""
_SIDE, _NEXT_SIDE = 4, 5
_STEP_XY = (0.7548776662466927, 0.5698402909980532)
"""Steps of the R2 low-discrepancy sequence: 1/p and 1/p^2, p being the plastic number (Roberts 2018)."""

Origin = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Result of a search for an origin.

    candidates: Number of origins tried.
    distance: Least number of differing symbols between 4x4 windows of the tape, at that origin.
    default_distance: The same at the sector's default origin; None if the tape exceeds the code's range there.
    from_others: Least distance of its 4x4 windows from those of the tapes to avoid, `BEYOND` for at least that; None without such
        tapes.
    """

    origin: Origin
    candidates: int
    distance: int
    default_distance: int | None
    from_others: int | None


def choose_origin(code: Plane, sector: int, placed: BoolArray, avoid: Sequence[Tape] = ()) -> Choice:
    """The origin at which a tape's 4x4 windows are farthest from those of the tapes to avoid, then farthest from each other.

    Ties are decided by the largest distance of 5x5 windows, then the fewest nearest pairs of 4x4, then the order of trial;
    the sector's default origin is tried first.

    placed (rows, columns): Whether a grid point carries a part.
    Raises SpecError if every candidate overlaps a tape to avoid.
    """
    rows, columns = placed.shape
    limit = MOST_BESIDE_OTHERS if avoid else MOST_CANDIDATES
    count = max(2, min(limit, _WINDOWS // placed.size))
    origins = [o for o in _origins(code, sector, placed.shape, count) if not _occupied(o, code, sector, placed.shape, avoid)]
    if not origins:
        raise SpecError(
            Problem(
                "origin",
                f"sector {sector} of {code.name} has no room for {columns} x {rows} grid points beside the tapes to avoid at any "
                f"of {count} origins; use another --sector, or leave it out",
            )
        )
    looked_at = len(origins)
    # distance from other tapes comes before that within the tape, as it is worse to report the wrong tape
    others: int | None = None
    if avoid:
        cut = [windows_of(encode(code, sector, o, placed.shape), placed, _SIDE, turns=4) for o in origins]
        farthest, others = _farthest(cut, avoid)
        origins = [origins[i] for i in farthest]
    best: tuple[int, int, int] | None = None
    chosen = origins[0]
    for origin in origins:
        merit = _origin_score(code, sector, origin, placed, None if best is None else best[0])
        if merit is not None and (best is None or merit > best):
            best, chosen = merit, origin
    assert best is not None
    default = default_origin(code.name, sector)
    fits = _fits(default, code, placed.shape)
    nearest = closest_windows(_windows(code, sector, default, placed, _SIDE)).distance or 0 if fits else None
    return Choice(
        origin=chosen,
        candidates=looked_at,
        distance=best[0],
        default_distance=nearest,
        from_others=others,
    )


def choose_sector(code: Plane, placed: BoolArray, avoid: Sequence[Tape]) -> int:
    """The sector whose 4x4 windows, at its default origin, are farthest from those of the tapes to avoid.

    Sectors and tag ids of these tapes are excluded, and only the first `MOST_BESIDE_OTHERS` others are tried.

    Raises SpecError if no sector is free.
    """
    used = {t.sector for t in avoid if t.code == code.name} | {t.tag.id for t in avoid if t.tag is not None}
    free = (s for s in range(code.sectors) if s not in used and _fits(default_origin(code.name, s), code, placed.shape))
    sectors = [s for s, _ in zip(free, range(MOST_BESIDE_OTHERS), strict=False)]
    if not sectors:
        raise SpecError(
            Problem(
                "sector",
                f"the tapes to avoid leave no sector of {code.name} free for {placed.shape[1]} x {placed.shape[0]} grid points; "
                "give --sector, which may be one of theirs elsewhere in the code plane, or use --code anoto-6x6",
            )
        )
    cut = [windows_of(encode(code, s, default_origin(code.name, s), placed.shape), placed, _SIDE, turns=4) for s in sectors]
    return sectors[_farthest(cut, avoid)[0][0]]


def _fits(origin: Origin, code: Plane, shape: tuple[int, ...]) -> bool:
    return origin[0] + shape[1] <= code.range and origin[1] + shape[0] <= code.range


def _origins(code: Plane, sector: int, shape: tuple[int, ...], count: int) -> list[Origin]:
    """Origins in the order of trial: the default one, then others spread over the plane.

    Places that overlap a default tape of that size, of any sector, are left out where possible: sectors at one place are nearly
    shifts of each other, and a touch cannot tell a part of the sector's default tape from that tape.
    """
    default = default_origin(code.name, sector)
    # each sector uses its own section of the sequence, so that two tapes do not try the same origins
    number = 1.0 + sector * MOST_CANDIDATES + np.arange(count - 1)
    room = np.array([code.range - shape[1] + 1, code.range - shape[0] + 1])
    # scaled to the plane less the tape, so that it always fits
    spread = np.floor(np.outer(number, _STEP_XY) % 1.0 * room).astype(np.int64)
    sectors = np.array([default_origin(code.name, s) for s in range(code.sectors)])
    # two rectangles of one size do not overlap if their corners are at least a side apart along either axis
    apart = (np.abs(spread[:, None] - sectors) >= (shape[1], shape[0])).any(axis=2).all(axis=1)
    origins = [(int(c), int(r)) for c, r in (spread[apart] if apart.any() else spread)]
    return ([default] if _fits(default, code, shape) else []) + origins


def _occupied(origin: Origin, code: Plane, sector: int, shape: tuple[int, ...], avoid: Sequence[Tape]) -> bool:
    """Whether a tape to avoid covers some of the same places."""
    return any(
        t.code == code.name
        and t.sector == sector
        and origin[0] < t.origin[0] + t.columns
        and t.origin[0] < origin[0] + shape[1]
        and origin[1] < t.origin[1] + t.rows
        and t.origin[1] < origin[1] + shape[0]
        for t in avoid
    )


def _farthest(cut: Sequence[Windows], avoid: Sequence[Tape]) -> tuple[list[int], int]:
    """Indices of the candidates farthest from the tapes to avoid, with fewest pairs at that distance; and that distance."""
    words, tape_of, _ = joined([*cut, *(windows_of(t.symbols, t.placed, _SIDE, turns=4) for t in avoid)])
    queries = sum(w.count for w in cut)
    left = np.arange(len(cut))
    for most in range(BEYOND):
        # windows of rejected candidates need no search; the windows to avoid come after those of all candidates
        kept = np.flatnonzero(np.isin(tape_of, left) | (np.arange(len(tape_of)) >= queries))
        mine = int((kept < queries).sum())
        near = np.zeros(len(cut), dtype=np.int64)
        search = plan_search(_SIDE, len(kept), most)
        for pairs in near_pairs(tuple(w[:, kept] for w in words), search, queries=mine):
            near += np.bincount(tape_of[kept[pairs.first[pairs.distance <= most]]], minlength=len(cut))
        # every remaining candidate has pairs at this distance, so none is farther
        if (near[left] > 0).all():
            fewest = near[left].min()
            return [int(i) for i in left[near[left] == fewest]], most
        left = left[near[left] == 0]
    return [int(i) for i in left], BEYOND


def _windows(code: Plane, sector: int, origin: Origin, placed: BoolArray, side: int) -> Windows:
    return windows_of(encode(code, sector, origin, placed.shape), placed, side)


def _origin_score(code: Plane, sector: int, origin: Origin, placed: BoolArray, least: int | None) -> tuple[int, int, int] | None:
    """Score of an origin as a tuple, larger is better; None if 4x4 windows are nearer than `least`."""
    windows = _windows(code, sector, origin, placed, _SIDE)
    # most origins are worse than the best so far, which a search for nearer pairs shows sooner than one for the nearest pairs.
    # With few windows that search compares all pairs, and so returns farther ones as well
    if least:
        search = plan_search(_SIDE, windows.count, least - 1)
        if any((pairs.distance < least).any() for pairs in near_pairs(windows.words, search)):
            return None
    nearest = closest_windows(windows, least or 0)
    # a 5x5 window contains a 4x4 one, and differs in at least as many symbols
    further = closest_windows(_windows(code, sector, origin, placed, _NEXT_SIDE), nearest.distance or 0)
    return nearest.distance or 0, further.distance or 0, -nearest.pairs
