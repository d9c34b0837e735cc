"""The sizes of a kit of domes stay within their bounds; those of a panel of six where all is tried."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.sizes import BOUNDS_MB, measure
from tests.thorough import THOROUGH


@pytest.mark.parametrize("kit", BOUNDS_MB if THOROUGH else ["domes"])
def test_sizes_stay_within_their_bounds(kit: str, tmp_path: Path) -> None:
    found = measure(kit, tmp_path)
    assert {ending: size for ending, size in found.items() if size > BOUNDS_MB[kit].get(ending, size)} == {}
