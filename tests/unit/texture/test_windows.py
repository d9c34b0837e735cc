"""Bits of words are counted alike with and without numpy's own function, which numpy 1.26 does not have."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.texture.windows import bit_count


def test_bits_are_counted_without_numpys_own_function(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    words = np.append(rng.integers(0, 2**64, 1000, dtype=np.uint64), np.array([0, 1, 2**63, 2**64 - 1], dtype=np.uint64))
    expected = [int(word).bit_count() for word in words]
    assert bit_count(words).tolist() == expected
    monkeypatch.delattr(np, "bitwise_count", raising=False)
    assert bit_count(words).tolist() == expected
