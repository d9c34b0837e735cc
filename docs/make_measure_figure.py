"""Makes the picture of docs/measure.md: a scan of a tape with faults, as the tests draw it.

Run: python docs/make_measure_figure.py
"""

from __future__ import annotations

import sys
import tempfile
from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.sense.inspect.inspection import inspect_with_views
from tactape_fab.sense.inspect.pictures import draw_deviations
from tests.scans import Scanner, assembled, scan

FIGURES = Path(__file__).parent / "figures"
SHARE = 0.6


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kit = make_kit(TapeSpec(sector=7, size_mm=(40.0, 30.0), models=False), folder / "tactape-s007")
        tape = Tape.load(kit.path)
        built = replace(assembled(tape, missing=2, seed=8), specks=[(22.65, 16.0, 0.16)])
        built.present[42], built.tombstoned[42] = False, True
        built.turn_deg[201] = 35.0
        built.dx_mm[111], built.dy_mm[111] = 0.24, -0.05
        path = folder / "scan.png"
        path.write_bytes(cv2.imencode(".png", scan(tape, built, Scanner()))[1].tobytes())
        found = inspect_with_views(path, kit.path)
    picture = draw_deviations(found.inspections[0], found.views[0])
    small = cv2.resize(picture, None, fx=SHARE, fy=SHARE, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(FIGURES / "measure-scan.png"), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
