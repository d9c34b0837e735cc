"""Windows and their distances against windows cut and compared symbol by symbol, in all turns."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import TURNED, SymbolArray
from tactape_fab.texture.windows import bit_count, symbol_distance, windows_of


def test_bits_are_counted_without_numpys_own_function(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    words = np.append(rng.integers(0, 2**64, 1000, dtype=np.uint64), np.array([0, 1, 2**63, 2**64 - 1], dtype=np.uint64))
    expected = [int(word).bit_count() for word in words]
    assert bit_count(words).tolist() == expected
    monkeypatch.delattr(np, "bitwise_count", raising=False)
    assert bit_count(words).tolist() == expected


def turned_by(window: SymbolArray, turns: int) -> SymbolArray:
    """A window turned counter-clockwise: its points, and the direction of each symbol."""
    for _ in range(turns):
        window = TURNED[np.rot90(window)]
    return window


@pytest.mark.parametrize("directions", [4, 8])
@pytest.mark.parametrize("side", [1, 4, 6])
def test_windows_are_those_without_a_gap_in_every_turn(side: int, directions: int) -> None:
    rng = np.random.default_rng(side)
    symbols = rng.integers(0, directions, (9, 11), dtype=np.uint8)
    placed = np.ones((9, 11), dtype=bool)
    placed[7, 9] = False
    found = windows_of(symbols, placed, side, directions=directions)
    corners = [(r, c) for r in range(10 - side) for c in range(12 - side) if placed[r : r + side, c : c + side].all()]
    assert (found.side, found.bits, found.count) == (side, {4: 2, 8: 3}[directions], len(corners))
    assert found.corner_rc.tolist() == [list(corner) for corner in corners]
    each = 64 // found.bits
    assert len(found.words) == (side**2 + each - 1) // each and found.words[0].shape == (3, len(corners))
    for turn in range(3):
        for n, (r, c) in enumerate(corners):
            wanted = DIRECTIONS[directions].gray_codes[turned_by(symbols[r : r + side, c : c + side], turn)].ravel()
            got = [
                int(found.words[i // each][turn, n]) >> found.bits * (i % each) & (1 << found.bits) - 1 for i in range(side**2)
            ]
            assert got == wanted.tolist()


@pytest.mark.parametrize("directions", [4, 8])
def test_a_distance_is_the_number_of_symbols_that_differ(directions: int) -> None:
    rng = np.random.default_rng(directions)
    symbols = rng.integers(0, directions, (7, 8), dtype=np.uint8)
    found = windows_of(symbols, np.ones((7, 8), dtype=bool), 6, turns=1, directions=directions)
    cut = [symbols[r : r + 6, c : c + 6] for r, c in found.corner_rc.tolist()]
    words = tuple(word[0] for word in found.words)
    each = tuple(word[:, None] for word in words)
    wanted = [[int((a != b).sum()) for b in cut] for a in cut]
    assert symbol_distance(each, words, found.bits).tolist() == wanted
    assert directions == 8 or symbol_distance(each, words).tolist() == wanted
    with pytest.raises(ValueError, match="shorter"):
        symbol_distance(words, words[:1], found.bits)


@pytest.mark.parametrize("side", [15, 16])
def test_the_largest_windows_may_differ_in_all_their_symbols(side: int) -> None:
    symbols = np.random.default_rng(0).integers(0, 4, (side, side), dtype=np.uint8)
    one, other = (windows_of(s, np.ones_like(s, dtype=bool), side, turns=1) for s in (symbols, (symbols + 1) % 4))
    assert symbol_distance(one.words, other.words).tolist() == [[side**2]]


@pytest.mark.parametrize("shape", [(4, 6), (6, 4), (5, 6), (6, 5), (5, 5)])
def test_a_grid_smaller_than_a_window_has_none(shape: tuple[int, int]) -> None:
    found = windows_of(np.zeros(shape, dtype=np.uint8), np.ones(shape, dtype=bool), 5, turns=2)
    wanted = max(shape[0] - 4, 0) * max(shape[1] - 4, 0)
    assert (found.count, found.corner_rc.shape) == (wanted, (wanted, 2))
    assert [word.shape for word in found.words] == [(2, wanted)]
