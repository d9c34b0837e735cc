"""The k-th smallest is what sorting says, and the values are divided at it; the median is numpy's."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.decode.dots import clip, kth

# compiled, they have no entry from Python: other kernels call them
select, median, clip_ = (getattr(one, "py_func", one) for one in (kth.select, kth.median, clip.clip))


@pytest.mark.parametrize("count", [1, 2, 3, 7, 20])
@pytest.mark.parametrize("ties", [False, True])
def test_the_kth_smallest_divides_the_values(count: int, ties: bool) -> None:
    random = np.random.default_rng(count)
    for k in range(count):
        values = random.integers(0, 4, count).astype(np.float64) if ties else random.permutation(count).astype(np.float64)
        expected = np.sort(values)
        assert select(values, k) == expected[k] == values[k]
        assert (values[:k] <= values[k]).all() and (values[k:] >= values[k]).all()
        assert np.array_equal(np.sort(values), expected)


def test_it_does_not_sort_all() -> None:
    """The parts that do not hold k stay undivided: values far above the k-th keep their disorder."""
    values = np.random.default_rng(3).permutation(200).astype(np.float64)
    select(values, 5)
    assert (np.diff(values[50:]) < 0).any() and (np.diff(values[120:]) < 0).any()


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7, 20])
def test_the_median_is_that_of_numpy(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kth, "select", select)
    monkeypatch.setattr(kth, "clip", clip_)
    for seed in range(5):
        values = np.random.default_rng(seed).normal(size=count)
        expected = np.median(values)
        assert median(values) == pytest.approx(expected, abs=1e-15)


def test_no_values_have_no_median() -> None:
    assert np.isnan(median(np.empty(0)))
