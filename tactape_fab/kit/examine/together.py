"""Comparison of tapes that are made or ordered together, before anything is written: shared places, windows and tag ids."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from tactape_fab.base.errors import Finding, tried
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.certify.pairs import Conflict, across, conflicts
from tactape_fab.texture.code import default_origin, get_code
from tactape_fab.texture.tape import Tape

MOST_POINTS = 200_000
"""Most grid points of tapes that are compared before they are made, which takes some seconds; `registry` compares more."""
_SIDE = 4
_NAMED = 3
"""Most conflicts that a message names; the others are counted."""
_TRIES = 64
"""Most sectors that are tried as a replacement for one that conflicts."""


def together_findings(
    tapes: Sequence[Tape], remedy: Callable[[Sequence[Conflict]], str], *, new: int | None = None, copies: bool = False
) -> tuple[Finding, ...]:
    """The finding of all conflicts between tapes; empty if there are none.

    remedy: Gives the options to type for these conflicts, or "".
    new: Number of new tapes, which come first; conflicts among the others are not reported.
    copies: Whether equal tapes are left out, as they are intended or reported elsewhere.
    """
    if len(tapes) < 2:
        return ()
    if sum(tape.columns * tape.rows for tape in tapes) > MOST_POINTS:
        return (too_many(len(tapes)),)
    found = [c for c in _conflicts(tapes, copies) if new is None or c.tapes[0] < new]
    if not found:
        return ()
    text = "; ".join(c.message for c in found[:_NAMED])
    more = f" and {len(found) - _NAMED} more conflicts" if len(found) > _NAMED else ""
    by_id = all(c.kind == "tag" and _of_given_id([tapes[i] for i in c.tapes], new) for c in found)
    way = "leave out --tag-id, or tag_id in the TOML file" if by_id else remedy(found)
    message = f"{text}{more}" + (f"; {way}" if way else "")
    return (Finding(rule="together", level="warn", passed=False, unit="", message=message),)


def _of_given_id(pair: Sequence[Tape], new: int | None) -> bool:
    """Whether two tapes have the same tag id because one was given; beside existing tapes only that of the new tape counts."""
    given = [tape.tag is not None and tape.tag.id != tape.sector for tape in (pair if new is None else pair[:1])]
    return any(given) and pair[0].sector != pair[1].sector


def too_many(count: int) -> Finding:
    """The remark that there are too many tapes to compare."""
    message = f"{count} tapes are too many to be compared before they are made; run registry on their folder afterwards"
    return Finding(rule="together", level="info", passed=False, unit="", message=message)


def _conflicts(tapes: Sequence[Tape], copies: bool) -> list[Conflict]:
    found = conflicts(tapes, [tape.name for tape in tapes], across(tapes, _SIDE))
    same = {c.tapes for c in found if c.kind == "same-tape"}
    return [c for c in found if not (copies and c.tapes in same)]


def apart(tapes: Sequence[Tape]) -> bool:
    """Whether no two tapes conflict."""
    return not _conflicts(tapes, copies=False)


def other_sectors(
    tapes: Sequence[Tape], found: Sequence[Conflict], moved_to: Callable[[int, int], Tape | None], tries: int = _TRIES
) -> list[int]:
    """Sectors at which the tapes do not conflict; of every two that conflict, the second gets another sector.

    moved_to: Gives the tape at an index with another sector; None if it cannot be made.
    tries: Most sectors that are tried for each tape.
    Returns: Sectors in the order of the tapes; empty if none were found.
    """
    # the first of a conflicting pair keeps its sector, as it may exist already
    moved = {c.tapes[1] for c in found}
    kept = [tape for i, tape in enumerate(tapes) if i not in moved]
    sectors = {i: tape.sector for i, tape in enumerate(tapes)}
    # each is compared with all tapes that keep their sector or have got another one
    for i in sorted(moved):
        for tape in _others(i, set(sectors.values()), moved_to, tries):
            if apart([tape, *kept]):
                kept.append(tape)
                sectors[i] = tape.sector
                break
        else:
            return []
    return list(sectors.values())


def of_sector(spec: TapeSpec, plan: Callable[[TapeSpec], Tape], sector: int) -> Tape | None:
    """The tape with another sector; a default origin or tag id becomes that of the new sector. None if it cannot be made."""
    if sector >= get_code(spec.code).sectors:
        return None
    followed = spec.origin == default_origin(spec.code, spec.sector)
    other = spec.with_values(
        sector=sector,
        origin=default_origin(spec.code, sector) if followed else spec.origin,
        tag_id=sector if spec.tag_id == spec.sector else spec.tag_id,
    )
    return tried(lambda: plan(other), [])


def _others(i: int, used: set[int], moved_to: Callable[[int, int], Tape | None], tries: int) -> Iterator[Tape]:
    free = [sector for sector in range(max(used) + tries + 1) if sector not in used]
    # sectors above the largest used one first, then free ones below it
    for sector in sorted(free, key=lambda s: (s < max(used), s))[:tries]:
        tape = moved_to(i, sector)
        if tape is not None:
            yield tape


def sector_words(sectors: Sequence[int]) -> str:
    """Sectors in the syntax of --sectors, with runs of three or more as ranges: ``0-2,7``."""
    runs: list[list[int]] = []
    for sector in sectors:
        if runs and sector == runs[-1][-1] + 1:
            runs[-1].append(sector)
        else:
            runs.append([sector])
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 2 else ",".join(map(str, run)) for run in runs)
