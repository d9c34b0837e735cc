"""The page on pose graphs: its table is what the example computes, and drift is bounded."""

from __future__ import annotations

import importlib
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

pytestmark = [
    pytest.mark.skipif(find_spec("gtsam") is None, reason='gtsam is not installed: pip install "tactape-fab[slam]"'),
    pytest.mark.skipif(find_spec("matplotlib") is None, reason="matplotlib is not installed"),
]
DOCS = Path(__file__).parents[2] / "docs"


def test_fixes_bound_the_drift_and_the_page_says_by_how_much(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(DOCS / "examples"), *sys.path])
    slam = importlib.import_module("slam")
    try:
        found = slam.run()
        page = (DOCS / "slam.md").read_text(encoding="utf-8")
        assert f"<!-- drift -->\n{slam.table(found)}<!-- /drift -->" in page, "run python docs/examples/slam.py"
    finally:
        for name in ("slam", "common"):
            sys.modules.pop(name, None)
    turn = found["alone"][:: round(360 / slam.STEP_DEG), 1]
    assert np.diff(turn) == pytest.approx(slam.DRIFT_DEG, abs=1.0)  # a turn's drift, again and again
    last = found["fused"][-1]
    assert last[0] < 0.02 and last[1] < 0.1
    assert (found["at"].max(axis=0) < np.multiply(1.5, found["own"].max(axis=0))).all()  # a fix brings all down to its own error
    angle_deg = slam.STEP_DEG * np.arange(len(found["fused"]))
    seen = (angle_deg < slam.BARE_DEG[0]) | (angle_deg > slam.BARE_DEG[1] + 40)
    assert found["fused"][seen, 1].max() < 0.7 and found["alone"][-1, 1] > 6
    assert 0.5 < np.mean(found["nees"]) < 2.0
