"""Parts that a contact should have shown: amid dots, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.survey.contacts import _unseen, ground_of
from tests.tapes import tape_at

TAPE = tape_at(7, (6, 5))
GRID = {(x, y) for x in range(6) for y in range(5)}


@pytest.mark.parametrize(
    ("gone", "omitted", "expected"),
    [
        ([], [], []),
        ([(2, 2)], [], [(2, 2)]),
        # a contact's rim has three or more that show none
        ([(2, 1), (2, 2)], [], [(2, 1), (2, 2)]),
        ([(2, 1), (2, 2), (2, 3)], [], [(2, 1), (2, 3)]),
        ([(1, 1), (3, 1), (2, 2)], [], [(1, 1), (3, 1)]),
        ([(0, 0), (1, 1), (2, 2)], [], [(2, 2)]),
        # at the tape's edge five neighbours are all there are, in its corner three are too few
        ([(2, 0)], [], [(2, 0)]),
        ([(0, 3)], [], [(0, 3)]),
        ([(5, 4)], [], []),
        ([(2, 0), (3, 0)], [], []),
        # where the tape has no part none is missed, and none is missing
        ([(2, 2)], [(2, 2)], []),
        ([(2, 1), (2, 2), (2, 3)], [(2, 1), (2, 3)], [(2, 2)]),
    ],
)
def test_parts_amid_dots_are_expected(
    gone: list[tuple[int, int]], omitted: list[tuple[int, int]], expected: list[tuple[int, int]]
) -> None:

    tape = replace(TAPE, omitted=np.array(omitted, dtype=np.int64).reshape(-1, 2))
    ground = ground_of(tape)
    cells = np.array([*sorted(GRID - set(gone)), (-1, -1)])
    assert _unseen(cells, ground).tolist() == sorted(ground.part_at[y, x] for x, y in expected)


def test_the_ground_has_each_part_at_its_design_s_place() -> None:
    ground = ground_of(TAPE)
    for number, (column, row) in enumerate(TAPE.cells().tolist()):
        assert ground.part_at[row, column] == number
        assert np.hypot(*(ground.nominal_mm[number] - np.array([column, row]) * 1.5)) == pytest.approx(0.25)
