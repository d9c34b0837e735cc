"""Makes the pictures of README and docs. Run: python docs/make_figures.py"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2

from tactape_fab import TapeSpec, make_kit

FIGURES = Path(__file__).parent / "figures"
WIDTH_PX = 1300


def tape() -> None:
    """The default tape, from the preview of its kit."""
    with tempfile.TemporaryDirectory() as folder:
        kit = make_kit(TapeSpec(sector=7), Path(folder) / "tactape-s007")
        image = cv2.imread(str(kit.path / kit.files["preview-png"]))
    assert image is not None
    height_px = round(image.shape[0] * WIDTH_PX / image.shape[1])
    small = cv2.resize(image, (WIDTH_PX, height_px), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(FIGURES / "tape.png"), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    tape()
