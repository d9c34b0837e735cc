"""Registered tapes by code, and the unregistered tapes of the same codes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.sense.decode.rule import LEAST_COLUMNS, LEAST_ROWS
from tactape_fab.sense.decode.search.evidence import Floats
from tactape_fab.sense.decode.search.matrices import Matrices, matrices_of
from tactape_fab.sense.decode.search.plane_sites import OVERHANG, Sites, sites_of
from tactape_fab.sense.decode.search.single_place import shown_by
from tactape_fab.texture.code import default_origin, get_code
from tactape_fab.texture.plane import PlaneCode
from tactape_fab.texture.tape import Tape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Family:
    """Tapes of one code.

    tapes: Registered tape of each site of `registered`.
    registered: Matrices for a code that is not made of sequences.
    unregistered: All sectors at their default origins and at those of registered tapes, without the registered tapes; None in a
        closed world, and for a code without sequences, whose tapes are independent of each other.
    beyond: The same, where dots may also hang over the edges of tapes at default origins.
    """

    code: str
    tapes: tuple[int, ...]
    registered: Sites | Matrices
    unregistered: Sites | None
    beyond: Sites | None

    @property
    def signs(self) -> Floats:
        """`Sites.signs`; none without sequences."""
        return self.registered.signs if isinstance(self.registered, Sites) else np.empty(0, dtype=np.float32)


def families(tapes: Sequence[Tape], *, open_world: bool) -> list[Family]:
    """The registered tapes by code, and the tapes beside them that may be touched in an open world."""
    found = []
    for name in dict.fromkeys(tape.code for tape in tapes):
        order = [k for k, tape in enumerate(tapes) if tape.code == name]
        # alike ones side by side: `sites_of` makes classes of runs, and those with holes have other kernels
        order.sort(key=lambda k: (not tapes[k].placed.all(), tapes[k].columns, tapes[k].rows))
        members = [tapes[k] for k in order]
        code = get_code(name).sequences
        if code is None:
            found.append(_matrix_family(name, members, order))
            continue
        largest = (max(LEAST_COLUMNS, *(t.columns for t in members)), max(LEAST_ROWS, *(t.rows for t in members)))
        sizes = sorted({largest, *((tape.columns, tape.rows) for tape in members)})
        registered = sites_of(
            code,
            sizes,
            origins=np.array([tape.origin for tape in members]),
            size_of=np.array([sizes.index((tape.columns, tape.rows)) for tape in members]),
            sectors=np.array([divmod(tape.sector, code.main.length) for tape in members]),
            placed=(tape.placed for tape in members),
            beside_many=open_world,
        )
        unregistered = _unregistered(code, sizes, members) if open_world else None
        beyond = None if unregistered is None else _over_all_edges(unregistered)
        found.append(Family(code=name, tapes=tuple(order), registered=registered, unregistered=unregistered, beyond=beyond))
    return found


def _matrix_family(name: str, tapes: Sequence[Tape], numbers: Sequence[int]) -> Family:
    """Tapes of a code that is not made of sequences, and their numbers among those registered."""
    order = sorted(range(len(tapes)), key=lambda k: (tapes[k].columns, tapes[k].rows))
    shown = tuple(shown_by(tapes[k]) for k in order)
    sizes = sorted({(tape.columns, tape.rows) for tape in tapes})
    return Family(
        code=name,
        tapes=tuple(numbers[k] for k in order),
        registered=matrices_of(shown, sizes, max(tape.directions for tape in tapes)),
        unregistered=None,
        beyond=None,
    )


def _unregistered(code: PlaneCode, sizes: list[tuple[int, int]], tapes: Sequence[Tape]) -> Sites:
    """Every other sector at its default origin, and all but the registered ones at each origin of a registered tape.

    Only at the latter may dots hang over an edge: there another sector is a shift of ours, and a contact over its edge looks
    like one over ours. Elsewhere in the plane a tape's edge looks like chance, and counts where chance may matter
    (`_over_all_edges`).

    A tape there of which a registered one shows a part is none of them: contacts on the registered one would never lead.
    """
    length = code.main.length
    largest = sizes.index((max(columns for columns, _ in sizes), max(rows for _, rows in sizes)))
    at_default = {tape.sector for tape in tapes if tape.origin == default_origin(code.name, tape.sector)}
    others = [sector for sector in range(code.sectors) if sector not in at_default]
    common: dict[tuple[int, int], list[Tape]] = {}
    for tape in tapes:
        common.setdefault(tape.origin, []).append(tape)
    # where all sectors are registered at an origin, nobody else's tape can be there
    there = [found for found in common.values() if len(found) < code.sectors]
    size_of = [_least_size(sizes, found) for found in there]
    shown = _sectors_at([found[0].origin for found in there], [sizes[k] for k in size_of], tapes)
    order = sorted(range(len(there)), key=lambda k: (size_of[k], len(shown[k])))
    barred = [(site, *divmod(sector, length)) for site, k in enumerate(order, len(others)) for sector in shown[k]]
    return sites_of(
        code,
        sizes,
        origins=np.array([*(default_origin(code.name, sector) for sector in others), *(there[k][0].origin for k in order)]),
        size_of=np.array([*([largest] * len(others)), *(size_of[k] for k in order)]),
        sectors=np.array([*(divmod(sector, length) for sector in others), *([(-1, -1)] * len(there))]),
        barred=np.array(barred, dtype=np.int64).reshape(-1, 3),
        overhang=False,
        beside_holes=not all(tape.placed.all() for tape in tapes),
    )


def _sectors_at(origins: Sequence[tuple[int, int]], sizes: Sequence[tuple[int, int]], tapes: Sequence[Tape]) -> list[list[int]]:
    """Sectors of the tapes that share places of the plane with each of some rectangles."""
    every = np.array(sorted((*t.origin, t.columns, t.rows, t.sector) for t in tapes))
    first, widest, found = every[:, 0], every[:, 2].max(), []
    for (column, row), (columns, rows) in zip(origins, sizes, strict=True):
        near = every[np.searchsorted(first, column - widest) : np.searchsorted(first, column + columns)]
        shared = (near[:, 0] + near[:, 2] > column) & (near[:, 1] + near[:, 3] > row) & (near[:, 1] < row + rows)
        found.append(np.unique(near[shared, 4]).tolist())
    return found


def _over_all_edges(sites: Sites) -> Sites:
    """The same sites, where dots may hang over the edges of all."""
    classes = sites.classes.copy()
    classes[:, OVERHANG] = 1
    return sites._replace(classes=classes)


def _least_size(sizes: list[tuple[int, int]], tapes: Sequence[Tape]) -> int:
    """The smallest of some sizes that holds all of some tapes."""
    columns, rows = max(tape.columns for tape in tapes), max(tape.rows for tape in tapes)
    fitting = [k for k, size in enumerate(sizes) if size[0] >= columns and size[1] >= rows]
    return min(fitting, key=lambda k: sizes[k][0] * sizes[k][1])
