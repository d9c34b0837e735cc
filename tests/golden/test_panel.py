"""What a panel adds to its tapes, letter by letter: outline and slots, holes, marks, its place in the manifest, its notes.

A difference is a change of output that CHANGELOG.md must name. `pytest tests/golden --update-golden` writes the files anew.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.golden.test_order_notes import FOLDER, compare
from tests.panels import panel_of


def test_a_panel_is_the_golden_one(tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")  # 2026-01-01
    values = {
        "sectors": [5, 9],
        "panel": "2x1",
        "size_mm": [28.0, 58.0],
        "pitch_mm": 4.0,
        "tag": "none",
        "name": "p",
        "models": False,
    }
    made = panel_of(values, tmp_path / "p")
    for role in ("profile", "drill-npth", "copper-top", "coverlay-top", "order-notes"):
        compare(FOLDER / "panel" / Path(made.files[role]).name, (made.path / made.files[role]).read_bytes(), request)
    manifest = json.loads((made.path / "manifest.json").read_bytes())
    for row in manifest["tapes"]:  # of pictures, which differ between releases of OpenCV
        del row["sha256"]
    text = json.dumps({key: manifest[key] for key in ("format", "name", "panel", "tapes")}, indent=1) + "\n"
    compare(FOLDER / "panel" / "manifest.json", text.encode("ascii"), request)
