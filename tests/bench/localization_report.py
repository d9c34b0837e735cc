"""Figures of the localization benchmark as a table and as JSON."""

from __future__ import annotations

import json
import os
import platform
from pathlib import Path
from typing import Any

from tests.bench.false_tally import Tally
from tests.bench.localization_measure import Figures
from tests.bench.localization_rows import COUNT, SEED, Row

_HEAD = (
    f"{'row':<22}{'method':<8}{'right %':>8}{'limit %':>9}{'wrong':>6}{'not':>6}"
    f"{'rms um':>8}{'deg':>7}{'nees/3':>8}{'p50':>7}{'p95':>7}{'p99 ms':>7}  lost"
)


class Report:
    """Collects what the tests show; written where TACTAPE_BENCH_JSON says."""

    def __init__(self) -> None:
        self.content: dict[str, Any] = {
            "frames": COUNT,
            "seed": SEED,
            "machine": platform.platform(),
            "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
            "rows": {},
            "figures": {},
        }
        self._headed = False

    def row(self, row: Row, figures: dict[str, Figures]) -> None:
        """Keep a row and print it."""
        self.content["rows"][row.name] = {name: value.to_mapping() for name, value in figures.items()}
        if not self._headed:
            print(f"\n{_HEAD}", end="")
            self._headed = True
        for name, value in figures.items():
            print("\n" + line(row.name, name, value), end="", flush=True)

    def figure(self, name: str, value: Any) -> None:
        """Keep another figure and print it."""
        self.content["figures"][name] = value
        print(f"\n{name}: {value}", end="", flush=True)

    def tally(self, name: str, tally: Tally) -> None:
        """Keep a count of false accepts and print it."""
        self.content["figures"][name] = tally.to_mapping()
        print(f"\n{name}: {tally}", end="", flush=True)

    def write(self) -> None:
        """Write everything, if a path was given."""
        path = os.environ.get("TACTAPE_BENCH_JSON")
        if path:
            Path(path).write_text(json.dumps(self.content, indent=1) + "\n")


def line(row: str, method: str, value: Figures) -> str:
    """One line of the table."""

    def number(figure: float | None, digits: int) -> str:
        return "-" if figure is None else f"{figure:.{digits}f}"

    limit = None if value.limit is None else 100 * value.limit_rate
    lost = ", ".join(f"{reason} {count}" for reason, count in (value.lost or {}).items())
    return (
        f"{row:<22}{method:<8}{100 * value.rate:>8.2f}{number(limit, 2):>9}{value.wrong:>6}"
        f"{value.frames - value.right - value.wrong:>6}{number(value.position_um, 1):>8}{number(value.theta_deg, 3):>7}"
        f"{number(value.nees, 2):>8}{value.p50_ms:>7.2f}{value.p95_ms:>7.2f}{value.p99_ms:>7.2f}  {lost}"
    )
