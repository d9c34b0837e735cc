"""Registry of tapes without duplicates, and the weight of unregistered ones (open or closed world)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.decode.search.built_places import Built, built_of
from tactape_fab.sense.decode.search.families import Family, families
from tactape_fab.texture.as_built import AsBuilt
from tactape_fab.texture.code import get_code
from tactape_fab.texture.tape import Tape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registry:
    """Tapes that may be touched.

    tapes: Registered ones without duplicates.
    families: The same by code, with the unregistered tapes of each.
    unregistered_share: Prior weight of all unregistered tapes together; 0 in a closed world.
    built: What was measured of each tape; empty where nothing was of any.
    boards_differ: Tapes whose equal ones lie elsewhere on their boards, so that no touch tells the place on the board.
    """

    tapes: tuple[Tape, ...]
    families: tuple[Family, ...]
    unregistered_share: float
    built: tuple[Built | None, ...] = ()
    boards_differ: frozenset[int] = frozenset()


def register(tapes: Sequence[Tape], *, unregistered_share: float) -> Registry:
    """A registry of tapes; a closed world if `unregistered_share` is 0.

    Raises SpecError for two tapes that an answer cannot name apart.
    """
    kept = distinct(tapes)
    _refuse_one_place(kept)
    return Registry(
        tapes=tuple(kept),
        families=tuple(families(kept, open_world=unregistered_share > 0.0)),
        unregistered_share=unregistered_share,
        built=tuple(map(built_of, kept)) if any(tape.as_built is not None for tape in kept) else (),
        boards_differ=_boards_differ(tapes),
    )


def distinct(tapes: Sequence[Tape]) -> list[Tape]:
    """Registered tapes, equal ones once: the union of their grids under the first one's name."""
    kept: dict[tuple[object, ...], Tape] = {}
    for tape in tapes:
        key = _texture_of(tape)
        kept[key] = _union(kept[key], tape) if key in kept else tape
    return list(kept.values())


def _texture_of(tape: Tape) -> tuple[object, ...]:
    return (*tape.texture_key, tape.pitch_mm, tape.displacement_mm, tape.directions)


def _boards_differ(tapes: Sequence[Tape]) -> frozenset[int]:
    """`Registry.boards_differ`; numbers are those in `distinct`."""
    places: dict[tuple[object, ...], set[object]] = {}
    for tape in tapes:
        places.setdefault(_texture_of(tape), set()).add(tape.board.texture_origin_mm if tape.surface is None else None)
    return frozenset(i for i, found in enumerate(places.values()) if len(found) > 1)


def _refuse_one_place(tapes: Sequence[Tape]) -> None:
    """Refuse textures of one code that have name, sector and origin in common, which is all that an answer says of its tape.

    Tapes of two codes may have them in common: those of one sector have by default, and who mixes codes knows which is where.
    Raises SpecError.
    """
    first: dict[tuple[str, str, int, tuple[int, int]], Tape] = {}
    for tape in tapes:
        if first.setdefault((tape.code, tape.name, tape.sector, tape.origin), tape) is not tape:
            message = (
                f"two tapes of code '{tape.code}' and different texture have the name {tape.name}, sector {tape.sector} and one "
            )
            remedy = "make one of them with another name, or leave it out"
            raise SpecError(Problem("tape", f"{message}origin, by which an answer names its tape; {remedy}"))


def _measured_alike(first: AsBuilt | None, other: AsBuilt | None) -> bool:
    """Whether two tapes of one texture have the same measured places, as those of a kit that was read twice."""
    if first is None or other is None:
        return first is other
    return first is other or first.to_mapping() == other.to_mapping()


def _union(first: Tape, other: Tape) -> Tape:
    """The first tape with the grid points of both."""
    if not _measured_alike(first.as_built, other.as_built):
        message = (
            f"{first.name} and {other.name} have one texture, so a touch cannot tell which of them was measured; "
            "give only the one that is touched (of a packed registry, pack the others alone), or read both with as_built='none'"
        )
        raise SpecError(Problem("as-built", message))
    columns, rows = max(first.columns, other.columns), max(first.rows, other.rows)
    placed = np.zeros((rows, columns), dtype=bool)
    for tape in (first, other):
        placed[: tape.rows, : tape.columns] |= tape.placed
    symbols = get_code(first.code).extended(first.symbols, first.sector, first.origin, (rows, columns))
    return replace(
        first,
        columns=columns,
        rows=rows,
        symbols=symbols,
        omitted=np.argwhere(~placed)[:, ::-1].astype(np.int64),
    )
