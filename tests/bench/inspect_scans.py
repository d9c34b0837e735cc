"""Accuracy and time of `inspect` on scans that the tests draw: `python -m tests.bench.inspect_scans [--page docs/measure.md]`."""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numpy as np

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.sense import inspect_scans
from tactape_fab.sense.inspect.scan_files import read_scan
from tests.bench.marks import command, write_between
from tests.scans import Scanner, assembled, scan

SMALL_MM, FULL_MM = (40.0, 30.0), (100.0, 50.0)
_LZW = 5
HEADER = """\
| tape, mm | parts | dpi | parts placed to, µm | rms along x, y, µm | of it all parts together, µm | largest, µm | NEES \
| missing found, parts invented | processor, s | of it reading | wall, s |
|---|---|---|---|---|---|---|---|---|---|---|---|
"""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One scan inspected: errors in micrometres, against the true places, nothing taken out."""

    parts: int
    missing: int
    found: int
    invented: int
    rms_um: tuple[float, float]
    together_um: tuple[float, float]
    largest_um: float
    nees: float
    seconds: float
    reading_seconds: float
    wall_seconds: float

    @property
    def pooled_um(self) -> float:
        return float(np.sqrt((self.rms_um[0] ** 2 + self.rms_um[1] ** 2) / 2))


def measured(size_mm: tuple[float, float], dpi: float, sigma_mm: float, *, missing: int, seed: int = 0) -> Row:
    """Draw a scan of a tape with so much scatter, and inspect it."""
    with tempfile.TemporaryDirectory() as name:
        kit = make_kit(TapeSpec(sector=7, size_mm=size_mm, models=False), Path(name) / "tactape-s007")
        tape = Tape.load(kit.path)
        built = assembled(tape, sigma_mm=sigma_mm, missing=missing, seed=seed)
        path = Path(name) / "scan.tif"
        picture = scan(tape, built, Scanner(dpi=dpi), seed=seed)
        path.write_bytes(cv2.imencode(".tif", picture, [cv2.IMWRITE_TIFF_COMPRESSION, _LZW])[1].tobytes())
        start, begin = process_time(), perf_counter()
        (one,) = inspect_scans(path, kit.path)
        seconds, wall = process_time() - start, perf_counter() - begin
        start = process_time()
        read_scan(path)
        reading = process_time() - start
    seen = built.present & one.present & ~one.covered
    error = 1000 * (one.shift_mm - np.stack([built.dx_mm, built.dy_mm], axis=1))[seen]
    x, y = np.sqrt((error**2).mean(axis=0)).tolist()
    mean_x, mean_y = error.mean(axis=0).tolist()
    return Row(
        parts=tape.part_count,
        missing=missing,
        found=int((~built.present & ~one.present).sum()),
        invented=int((built.present & ~one.present).sum() + (one.covered | one.tombstoned).sum() + len(one.foreign_mm)),
        rms_um=(x, y),
        together_um=(mean_x, mean_y),
        largest_um=float(np.abs(error).max()),
        nees=float((error**2 / (1000 * one.sigma_mm[seen][:, None]) ** 2).mean()),
        seconds=seconds,
        reading_seconds=reading,
        wall_seconds=wall,
    )


def line_of(size_mm: tuple[float, float], dpi: float, sigma_mm: float, row: Row) -> str:
    """A row of the table."""
    what = f"{size_mm[0]:g} x {size_mm[1]:g} | {row.parts} | {dpi:g} | {1000 * sigma_mm:g}"
    errors = f"{row.rms_um[0]:.1f}, {row.rms_um[1]:.1f} | {row.together_um[0]:+.1f}, {row.together_um[1]:+.1f}"
    rest = f"{row.largest_um:.0f} | {row.nees:.2f} | {row.found} of {row.missing}, {row.invented} | {row.seconds:.1f} "
    rest += f"| {row.reading_seconds / row.seconds:.0%} | {row.wall_seconds:.1f}"
    return f"| {what} | {errors} | {rest} |\n"


def about(seed: int) -> str:
    """What the table is of."""
    usual = Scanner()
    scale = 100 * max(abs(part - 1) for part in usual.scale)
    return (
        f"One scan for each row (`--seed {seed}`), against the true places, nothing taken out. Scans have blur, noise, shadow, "
        f"glare, jitter of {usual.jitter_um:g} µm, scale off by up to {scale:.1g} %, skew {usual.skew_deg:g}° "
        f"({command('tests.bench.inspect_scans')}).\n\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.inspect_scans", description=__doc__)
    parser.add_argument("--full", action="store_true", help="a tape of 2,000 parts, too")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of what is drawn; 0 unless said")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the table between marks of a page, docs/measure.md")
    given = parser.parse_args()
    cases = [(SMALL_MM, dpi, sigma) for dpi in (600.0, 1200.0, 2400.0) for sigma in (0.05, 0.1)]
    cases += [(FULL_MM, dpi, 0.05) for dpi in (1200.0, 2400.0)] if given.full else []
    table = HEADER
    print(HEADER, end="")
    for size, dpi, sigma in cases:
        row = measured(size, dpi, sigma, missing=20 if size == FULL_MM else 5, seed=given.seed)
        line = line_of(size, dpi, sigma, row)
        print(line, end="", flush=True)
        table += line
    if given.page is not None:
        write_between(given.page, "inspected", about(given.seed) + table)


if __name__ == "__main__":
    main()
