"""How long the design rules take: two thousand parts, fifty thousand, and a whole `check`."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.rules.film_rules import film_findings
from tactape_fab.kit.rules.spacing import check


def best_of(runs: int, work: Callable[[], object]) -> float:
    """Least processor time of some runs: what else runs on the machine is not the work."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def rules(examined: Examined) -> object:
    spec, fab = examined.spec, examined.fab
    return check(examined.layout, fab, spec) + film_findings(examined.layout, spec, fab)


@pytest.mark.parametrize("anchor", ["none", "spur"])
def test_rules_of_2112_parts(anchor: str) -> None:
    examined = examine(TapeSpec(sector=7, size_mm=(103.5, 50.5), tag="none", models=False, anchor=anchor))
    assert examined.tape.part_count >= 2112
    took_s = best_of(7, lambda: rules(examined))
    print(f"\nrules of {examined.tape.part_count} parts, anchor {anchor}: {took_s:.3f} s")
    assert took_s < 0.2


def test_check_of_the_default_tape_after_start_up() -> None:
    """With plan and drawing, as `check` does it once everything is imported."""
    spec = TapeSpec(sector=7)
    examine(spec)
    took_s = best_of(7, lambda: examine(spec))
    print(f"\ncheck of the default tape: {took_s:.3f} s")
    assert took_s <= 0.2


def test_check_of_50000_parts() -> None:
    spec = TapeSpec(sector=7, size_mm=(500.0, 240.0), tag="none", models=False)
    examined = examine(spec)
    assert examined.tape.part_count >= 50_000
    took_s = best_of(3, lambda: examine(spec))
    print(f"\ncheck of {examined.tape.part_count} parts: {took_s:.3f} s")
    assert took_s <= 3.0
