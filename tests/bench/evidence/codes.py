"""What the codes themselves can and cannot tell: rotations, wrong symbols, range, and how far apart windows of tapes are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from tactape_fab.kit.examine.code_tapes import default_tapes
from tactape_fab.texture.certify.certificate import closest
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.frames import IntArray, SymbolArray
from tactape_fab.texture.plane import encode, locate_windows
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.localization_rows import SEED

SECTION = "codes"
CODES = ("microdots-4x4", "debruijn-4x4")
SIDES = (4, 5, 6)
PATCH, WRONG = 200, 8000
"""Grid points along a side, and windows with a wrong symbol."""


def jobs(size: Size) -> list[Job]:
    """Windows of both codes, and the tapes of some sectors."""
    windows = [Job(section=SECTION, name=f"windows of {code}", measure=measure_windows, options={"code": code}) for code in CODES]
    tapes = [
        Job(section=SECTION, name=f"tapes, {side}x{side}", measure=measure_tapes, options={"side": side, "sectors": size.sectors})
        for side in SIDES
    ]
    return [*windows, *tapes]


def measure_windows(code: str) -> Result:
    """Error-free windows in all four rotations, and windows with one wrong symbol."""
    rng, plane = np.random.default_rng(SEED), get_plane(code)
    sector = int(rng.integers(plane.sectors))
    column, row = (int(v) for v in rng.integers(0, plane.range - PATCH, 2))
    symbols = encode(plane, sector, (column, row), (PATCH, PATCH))
    valid = np.ones((PATCH - 3, PATCH - 3), dtype=bool)
    for turns in range(4):
        valid &= np.rot90(locate_windows(plane, quarter_turned(symbols, turns)).valid, -turns)
    windows = np.lib.stride_tricks.sliding_window_view(symbols, (4, 4)).reshape(-1, 16).copy()
    places = np.arange(len(windows))
    which = rng.integers(16, size=len(windows))
    windows[places, which] = (windows[places, which] + rng.integers(1, 4, len(windows))) % 4
    some = windows[:: max(len(windows) // WRONG, 1)].reshape(-1, 4, 4)
    side_by_side = some.transpose(1, 0, 2).reshape(4, -1)
    unnoticed = locate_windows(plane, side_by_side).valid[0, ::4]
    return {
        "range": plane.range,
        "windows": int(valid.size),
        "valid in all rotations": int(valid.sum()),
        "windows with a wrong symbol": len(unnoticed),
        "unnoticed": int(unnoticed.sum()),
    }


def quarter_turned(symbols: SymbolArray, turns: int) -> SymbolArray:
    """A patch turned counter-clockwise: places turn, and so do directions."""
    from tactape_fab.sense.decode.paper.windows_read import quarter_turned as turned

    values: IntArray = symbols.astype(np.int64)
    return turned(values, turns).astype(np.uint8)


def measure_tapes(side: int, sectors: int) -> Result:
    """Least distance of two windows of one tape, all rotations, 62 x 32 points at the default origins of some sectors."""
    tapes = default_tapes("microdots-4x4")[:: 256 // sectors]
    counts = Counter(closest(tape, side).distance for tape in tapes)
    return {"tapes": len(tapes), "distances": {str(distance): count for distance, count in sorted(counts.items(), key=str)}}


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    out = [
        "## What the code itself can tell",
        "",
        "| code | range per axis | error-free 4x4 windows that read validly in all four rotations | one wrong symbol unnoticed |",
        "|---|---|---|---|",
    ]
    for code in CODES:
        one = results[f"windows of {code}"]
        unnoticed = one["unnoticed"] / one["windows with a wrong symbol"]
        whole = f"{one['valid in all rotations']} of {one['windows']}"
        out.append(f"| `{code}` | {one['range']} | {whole} | {100 * unnoticed:.1f} % of {one['windows with a wrong symbol']} |")
    out += [
        "",
        "The paper gives a range of 4096, and lets a rotation be told by the one that reads validly. Tapes of 62x32 points,",
        "`microdots-4x4` at default origins, by the fewest symbols in which two of their windows differ, turns included:",
        "",
    ]
    found = {side: results[f"tapes, {side}x{side}"] for side in SIDES}
    distances = sorted({int(d) for one in found.values() for d in one["distances"]})
    out += [f"| windows | tapes | {' | '.join(map(str, distances))} |", "|---" * (len(distances) + 2) + "|"]
    for side, one in found.items():
        counts = [str(one["distances"].get(str(d), 0)) for d in distances]
        out.append(f"| {side}x{side} | {one['tapes']} | {' | '.join(counts)} |")
    return [*out, ""]
