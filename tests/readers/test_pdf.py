"""The fab drawing, drawn by Poppler."""

from __future__ import annotations

import subprocess
from pathlib import Path

import cv2
import numpy as np

from tactape_fab import Kit

DPI = 100


def test_poppler_draws_the_sheet(small_kit: Kit, tmp_path: Path, pdftoppm: str) -> None:
    drawing = small_kit.path / small_kit.files["fab-drawing"]
    done = subprocess.run(
        [pdftoppm, "-r", str(DPI), "-png", "-singlefile", str(drawing), str(tmp_path / "sheet")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    picture = cv2.imread(str(tmp_path / "sheet.png"))
    assert picture is not None
    height, width = picture.shape[:2]
    np.testing.assert_allclose((width, height), np.array((297.0, 210.0)) * DPI / 25.4, atol=1.5)
    dark = float((picture.max(axis=2) < 120).mean())
    assert 0.01 < dark < 0.2  # lines and texts, neither an empty page nor a black one
