"""One thread while small systems are solved, and as many as before afterwards."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pytest

from tactape_fab.base.blas import one_thread, thread_counts
from tactape_fab.sense import calibrate_sensor
from tactape_fab.sense.calibrate import calibration
from tests.contacts import TAPE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="libraries of a process are looked up on Linux alone")


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = counts()
    for _, put in thread_counts():
        put(2)
    yield
    for (_, put), count in zip(thread_counts(), before, strict=True):
        put(count)


def counts() -> list[int]:
    return [get() for get, _ in thread_counts()]


def test_numpy_has_one_thread_within_and_as_many_as_before_afterwards(two_threads: None) -> None:
    assert np.linalg.inv(np.eye(2)).any()
    before = counts()
    assert 2 in before  # older OpenCV brings an OpenBLAS that was built for one thread
    with pytest.raises(RuntimeError), one_thread():
        assert set(counts()) == {1}
        raise RuntimeError
    assert counts() == before


def test_a_calibration_takes_one(two_threads: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads took 15 times as long as one where two other programs kept two processors busy."""

    def looked(_: object) -> None:
        raise RuntimeError(str(set(counts())))

    monkeypatch.setattr(calibration, "as_tapes", looked)
    with pytest.raises(RuntimeError, match=r"^\{1\}$"):
        calibrate_sensor([], TAPE)
