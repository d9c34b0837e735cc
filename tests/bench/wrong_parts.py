"""What p_false says where parts are missing or at wrong places: `python -m tests.bench.wrong_parts [--page docs/trust.md]`.

Contacts of 2.2 to 4 mm radius on the default tape, known alone in a closed world, whose dots are drawn: each part is where
its symbol has it, scattered by 0.03 mm, or it is missing, anywhere in its cell, or at the place of another symbol, at random. All
limits but a `max_p_tape` of 0.3 are off, so that small contacts say their p_false; those at most 1e-4 are located by default.
"""

from __future__ import annotations

import argparse
from math import cos, pi, sin
from pathlib import Path

import numpy as np

from tactape_fab import Localizer
from tactape_fab.sense import load_sensor
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray
from tests.bench.localization_rows import registered_tape
from tests.bench.marks import command, write_between
from tests.bench.place_chance import Unlimited

KINDS = ("all right", "missing", "anywhere", "wrong symbol")
ROWS = (("all right", 0.0), ("missing", 0.2), ("anywhere", 0.2), *(("wrong symbol", share) for share in (0.05, 0.1, 0.15, 0.2)))
RADII_MM, SCATTER_MM, EDGE_MM = (2.2, 4.0), 0.03, 4.0
NEAR_MM, NEAR_DEG = 0.5, 5.0
"""An answer is right within these."""
DECADES = ((1e-3, 1e-2), (1e-4, 1e-3), (0.0, 1e-4))
SEED = 11


def answers(kind: str, share: float, contacts: int, seed: int = SEED) -> FloatArray:
    """p_false of each answer, and whether it is wrong; (n, 2)."""
    rng = np.random.default_rng([seed, KINDS.index(kind), round(1000 * share)])
    tape, sensor = registered_tape(), load_sensor("gelsight-mini")
    localizer = Localizer(tape, sensor, world="closed")
    localizer._limits = Unlimited(max_p_false=1.0, max_p_tape=0.3, kappa=1.0)
    row, column = np.indices(tape.symbols.shape).reshape(2, -1)
    points_mm = tape.pitch_mm * np.stack([column, row], axis=1)
    out = []
    for _ in range(contacts):
        at_mm = rng.uniform(EDGE_MM, points_mm.max(axis=0) - EDGE_MM)
        theta, radius_mm = rng.uniform(-pi, pi), rng.uniform(*RADII_MM)
        near = np.flatnonzero(np.hypot(*(points_mm - at_mm).T) < radius_mm)
        symbol, wrong = tape.symbols[row[near], column[near]].astype(np.int64), rng.random(len(near)) < share
        if kind == "wrong symbol":
            symbol = np.where(wrong, (symbol + rng.integers(1, 4, len(near))) % 4, symbol)
        off_mm = tape.displacement_mm * DIRECTIONS_XY[symbol] + rng.normal(0.0, SCATTER_MM, (len(near), 2))
        if kind == "anywhere":
            off_mm[wrong] = rng.uniform(-tape.pitch_mm / 2, tape.pitch_mm / 2, (int(wrong.sum()), 2))
        seen_mm = (points_mm[near] + off_mm - at_mm)[~wrong if kind == "missing" else slice(None)]
        # T = S + R(theta) p / px_per_mm (paper, Eq. 12), the other way round
        turn = np.array([[cos(theta), -sin(theta)], [sin(theta), cos(theta)]])
        fix = localizer.locate_dots(seen_mm @ turn.T * sensor.px_per_mm + sensor.centre_px)
        if fix.located:
            assert fix.position_mm is not None and fix.theta_deg is not None and fix.p_false is not None
            off_deg = abs((fix.theta_deg - np.degrees(theta) + 180.0) % 360.0 - 180.0)
            out.append((fix.p_false, float(np.hypot(*(fix.position_mm - at_mm)) > NEAR_MM or off_deg > NEAR_DEG)))
    return np.array(out).reshape(-1, 2)


def lines_of(contacts: int) -> list[str]:
    """The table."""
    heads = [
        f"{'at most' if low == 0.0 else f'{low:g} to'} {high:g}: answers | wrong, said | wrong, happened" for low, high in DECADES
    ]
    lines = [f"| parts | {' | '.join(heads)} |", "|---|" + "---|" * (3 * len(DECADES))]
    for kind, share in ROWS:
        p, wrong = answers(kind, share, contacts).T
        cells = []
        for low, high in DECADES:
            of = (p >= low) & (p < high)
            cells.append(f"{of.sum():,} | {p[of].sum():.2g} | {int(wrong[of].sum())}")
        lines.append(f"| {kind if share == 0.0 else f'{100 * share:g} % {kind}'} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.wrong_parts", description=__doc__)
    parser.add_argument("--contacts", type=int, default=15_000, metavar="N", help="of each row; 15,000 take two minutes")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the table between the marks of a page, docs/trust.md")
    chosen = parser.parse_args()
    lines = [f"{chosen.contacts:,} contacts for each row ({command('tests.bench.wrong_parts')}).", "", *lines_of(chosen.contacts)]
    if chosen.page is not None:
        write_between(chosen.page, "wrong-parts", "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
