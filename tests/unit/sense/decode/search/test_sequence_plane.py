"""A contact in the plane of a code of sequences: what all other places weigh."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest

from tactape_fab.sense.decode.search.evidence import columns_by_symbol
from tactape_fab.sense.decode.search.sequence_plane import SequencePlane
from tactape_fab.texture.code import get_code
from tactape_fab.texture.plane import PlaneCode, encode


@pytest.mark.parametrize("side", [6, 7, 8])
def test_all_other_places_weigh_no_less_than_the_next_best(side: int) -> None:
    code = get_code("microdots-4x4")
    assert isinstance(code, PlaneCode)
    symbols = encode(code, 77, (1000, 2000), (side, side))
    row, column = np.indices(symbols.shape).reshape(2, -1)
    q = np.full((len(row), 4), 0.03)
    q[np.arange(len(row)), columns_by_symbol(4)[0, symbols[row, column]]] = 0.91
    found = SequencePlane(code, side).search(np.stack([column, row], axis=1), q)
    assert found is not None and (found.sector, found.cells[0].tolist()) == (77, [1000, 2000])
    assert exp(-found.lead) * 0.999 <= found.others < 0.01
