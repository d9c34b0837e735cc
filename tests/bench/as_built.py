"""What measured places of parts bring: `python -m tests.bench.as_built [--count N] [--page docs/measure.md]`.

For contacts of several sizes on tapes whose parts stand off the design, by how much a fab may place them, and with parts missing:
how many are located, how far off, and how honest the covariance is, by the design's places and by measured ones. The parts drawn
are the true ones; what the decoder has are these with the error of a measurement.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from tactape_fab import Localizer, Tape, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Frame, Scene, iterate_frames
from tests.bench.localization_measure import error_of, is_right
from tests.bench.marks import write_between
from tests.measured import measured

SIZES = ((6.5, 6.5), (8.0, 8.0), (11.0, 9.0), (14.0, 12.0))
TAPES = ((0.05, 0.0), (0.1, 0.0), (0.05, 0.3))
ERROR_MM = 0.003
KINDS = (("nominal", "dots"), ("as-built", "dots"), ("as-built", "pixels"))
SEED = 41


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Figures of one decoder on one row; errors are of right answers, rms along one axis. None where there are none."""

    contact: str
    placement_mm: float
    missing: float
    places: str
    refine: str
    frames: int
    right: int
    wrong: int
    by_measured: int
    position_um: float | None
    theta_deg: float | None
    nees: float | None
    median_ms: float


@cache
def design() -> Tape:
    return examine(TapeSpec(sector=7)).tape


def figures_of(size: tuple[float, float], placement_mm: float, missing: float, count: int) -> Iterator[Figures]:
    """Figures of the decoders on a row, by the design and by measured places, with dots and with pixels."""
    tape, parts = measured(design(), placement_mm, missing=missing, error_mm=ERROR_MM, seed=SEED)
    decoders = [
        (places, refine, Localizer(known, refine=refine))
        for places, known in (("nominal", design()), ("as-built", tape))
        for refine in ("dots", "pixels")
    ]
    frames = list(iterate_frames(design(), count, SEED, scene=Scene(contact_mm=size), parts=parts))
    for places, refine, decoder in decoders:
        yield _figures(frames, decoder, contact=f"{size[0]:g}x{size[1]:g}", placement_mm=placement_mm, missing=missing,
                       places=places, refine=refine)  # fmt: skip


def _figures(frames: list[Frame], decoder: Localizer, **row: Any) -> Figures:
    errors, nees, wrong, by_measured, times = [], [], 0, 0, []
    for frame in frames:
        start = process_time()
        fix = decoder.locate(frame.depth)
        times.append(1000.0 * (process_time() - start))
        if not fix.located:
            continue
        by_measured += fix.places == "as-built"
        if not is_right(fix, frame, design()):
            wrong += 1
            continue
        error = error_of(fix, frame)
        assert fix.covariance is not None
        errors.append(error)
        nees.append(float(error @ np.linalg.solve(fix.covariance, error)) / 3)
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else None
    return Figures(
        **row,
        frames=len(frames),
        right=len(errors),
        wrong=wrong,
        by_measured=by_measured,
        position_um=None if rms is None else float(np.hypot(*rms[:2]) / np.sqrt(2) * 1000),
        theta_deg=None if rms is None else float(np.degrees(rms[2])),
        nees=float(np.mean(nees)) if nees else None,
        median_ms=float(np.median(times)),
    )


def table_of(found: list[Figures]) -> str:
    """The table of docs/measure.md, and what it was made of."""
    rows = {(row.contact, row.placement_mm, row.missing, row.places, row.refine): row for row in found}
    lines = [
        f"{found[0].frames} simulated contacts for each row, by the noise of a GelSight Mini, with places measured to "
        f"{1000 * ERROR_MM:g} µm; {sum(row.wrong for row in found)} are located wrongly.",
        "",
        "| contact, mm | placement, mm | missing | located, %: design | measured | position, µm rms: design | measured "
        "| and pixels | angle, ° rms: design | measured | NEES/3: measured | ms: design | measured |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for placement_mm, missing in TAPES:
        for u, v in SIZES:
            key = (f"{u:g}x{v:g}", placement_mm, missing)
            design, built, pixels = (rows[(*key, *kind)] for kind in KINDS)
            values = [
                *(f"{100 * row.right / row.frames:.1f}" for row in (design, built)),
                *(_said(row.position_um, 2) for row in (design, built, pixels)),
                *(_said(row.theta_deg, 3) for row in (design, built)),
                _said(built.nees, 2),
                *(_said(row.median_ms, 1) for row in (design, built)),
            ]
            lines.append(" | ".join([f"| {key[0]}", f"{placement_mm:g}", f"{missing:.0%}", *values]) + " |")
    return "\n".join(lines) + "\n"


def _said(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.as_built", description=__doc__)
    parser.add_argument("--count", type=int, default=400, metavar="N", help="contacts of each row; 400 unless said")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the figures as JSON, too")
    parser.add_argument(
        "--page", type=Path, metavar="FILE.md", help="write the table between the marks of a page, docs/measure.md"
    )
    chosen = parser.parse_args()
    found = []
    for placement_mm, missing in TAPES:
        for size in SIZES:
            for row in figures_of(size, placement_mm, missing, chosen.count):
                print(row, flush=True)
                found.append(row)
    print(table_of(found))
    if chosen.json is not None:
        chosen.json.write_text(json.dumps([asdict(row) for row in found], indent=1) + "\n", encoding="utf-8")
    if chosen.page is not None:
        write_between(chosen.page, "measured", table_of(found))


if __name__ == "__main__":
    main()
