"""A PNG whose chunks say more than the file holds is told before it is unpacked."""

from __future__ import annotations

import resource
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.image_file import chunks_fit
from tactape_fab.sense.raw.image_files import read_picture

PNG = cv2.imencode(".png", np.arange(96, dtype=np.uint16).reshape(8, 12))[1].tobytes()


def test_chunks_of_a_whole_file_fit() -> None:
    assert chunks_fit(PNG) and chunks_fit(PNG + b"more") and chunks_fit(b"") and chunks_fit(b"\xff\xd8")


@pytest.mark.parametrize("end", range(8, len(PNG)))
def test_a_file_that_is_cut_off_is_told(end: int) -> None:
    assert not chunks_fit(PNG[:end])


def test_a_length_of_4_gb_costs_nothing(tmp_path: Path) -> None:
    at = PNG.index(b"IDAT") - 4
    (tmp_path / "a.png").write_bytes(PNG[:at] + b"\xff\x7f\xff\xff" + PNG[at + 4 :])  # found by fuzzing: 4.3 GB
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SpecError, match="it is damaged and cannot be unpacked"):
        read_picture(tmp_path / "a.png")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000
