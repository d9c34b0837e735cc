"""Accuracy and time of `inspect` on scans that the tests draw. Run: python -m tests.bench.inspect_scans [--full]"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import cv2
import numpy as np

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.sense import inspect_scans
from tests.scans import Scanner, assembled, scan

SMALL_MM, FULL_MM = (40.0, 30.0), (100.0, 50.0)
HEADER = "tape mm   dpi   placed um  parts  missing found/invented  rms um x, y  largest  NEES  processor s"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One scan inspected: errors in micrometres, against the true places, nothing taken out."""

    parts: int
    missing: int
    found: int
    invented: int
    rms_um: tuple[float, float]
    largest_um: float
    nees: float
    seconds: float

    @property
    def pooled_um(self) -> float:
        return float(np.sqrt((self.rms_um[0] ** 2 + self.rms_um[1] ** 2) / 2))


def measured(size_mm: tuple[float, float], dpi: float, sigma_mm: float, *, missing: int, seed: int = 0) -> Row:
    """Draw a scan of a tape with so much scatter, and inspect it."""
    with tempfile.TemporaryDirectory() as name:
        kit = make_kit(TapeSpec(sector=7, size_mm=size_mm, models=False), Path(name) / "tactape-s007")
        tape = Tape.load(kit.path)
        built = assembled(tape, sigma_mm=sigma_mm, missing=missing, seed=seed)
        path = Path(name) / "scan.png"
        picture = scan(tape, built, Scanner(dpi=dpi), seed=seed)
        path.write_bytes(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
        start = process_time()
        (one,) = inspect_scans(path, kit.path)
        seconds = process_time() - start
    seen = built.present & one.present & ~one.covered
    error = 1000 * (one.shift_mm - np.stack([built.dx_mm, built.dy_mm], axis=1))[seen]
    x, y = np.sqrt((error**2).mean(axis=0)).tolist()
    return Row(
        parts=tape.part_count,
        missing=missing,
        found=int((~built.present & ~one.present).sum()),
        invented=int((built.present & ~one.present).sum() + (one.covered | one.tombstoned).sum() + len(one.foreign_mm)),
        rms_um=(x, y),
        largest_um=float(np.abs(error).max()),
        nees=float((error**2 / (1000 * one.sigma_mm[seen][:, None]) ** 2).mean()),
        seconds=seconds,
    )


def main() -> None:
    full = "--full" in sys.argv
    cases = [(SMALL_MM, dpi, sigma) for dpi in (600.0, 1200.0, 2400.0) for sigma in (0.05, 0.1)]
    cases += [(FULL_MM, dpi, 0.05) for dpi in (1200.0, 2400.0)] if full else []
    print(HEADER)
    for size, dpi, sigma in cases:
        row = measured(size, dpi, sigma, missing=20 if size == FULL_MM else 5)
        counts = f"{row.parts:8d}  {row.missing:3d} {row.found:3d}/{row.invented}"
        errors = f"{row.rms_um[0]:12.1f} {row.rms_um[1]:4.1f}  {row.largest_um:8.1f}  {row.nees:6.2f}  {row.seconds:6.1f}"
        print(f"{size[0]:.0f}x{size[1]:.0f}  {dpi:5.0f}  {1000 * sigma:5.0f}  {counts}  {errors}", flush=True)


if __name__ == "__main__":
    main()
