"""Writes the picture of docs/panels.md: the preview of a panel as `make` draws it, smaller."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from tactape_fab.kit.examine.order import ExaminedPanel, examine_order
from tactape_fab.make.panel import make_panel

FIGURES = Path(__file__).parent / "figures"
SHARE = 0.4


def main() -> None:
    examined, _ = examine_order({"sector": 30, "panel": "2x3", "size_mm": [60.0, 30.0], "models": False})
    assert isinstance(examined, ExaminedPanel)
    with TemporaryDirectory() as folder:
        panel = make_panel(examined, Path(folder) / "panel")
        picture = cv2.imread(str(panel.path / panel.files["preview-png"]))
    small = cv2.resize(picture, None, fx=SHARE, fy=SHARE, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(FIGURES / "panel.png"), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
