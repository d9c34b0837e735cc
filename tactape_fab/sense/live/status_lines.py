"""Lines printed by `watch`: the status line while it runs, and the summary."""

from __future__ import annotations

from tactape_fab.sense.live.counts import Tally


def status_line(tally: Tally) -> str:
    """The last answer, and how it is going: what matters most is first, where a narrow terminal shows it."""
    fix = tally.last
    if fix is None:
        last = "waiting for frames"
    elif not fix.located:
        last = f"not located: {fix.reason}"
    else:
        place = fix.position_mm or fix.plane_mm or (float("nan"), float("nan"))
        turn = "" if fix.theta_deg is None else f" {fix.theta_deg:.1f} deg"
        last = f"{fix.tape or f'sector {fix.sector}'} x {place[0]:.2f} y {place[1]:.2f} mm{turn}"
    count = f"{tally.located} of {tally.answered} located"
    unusable = f"unusable {tally.unusable}" if tally.unusable else ""
    parts = (last, count, f"{tally.hz:.1f} Hz", f"dropped {tally.dropped}", unusable, _latency(tally))
    return "; ".join(part for part in parts if part)


def end_lines(tally: Tally) -> list[str]:
    """The summary at the end."""
    count = tally.answered
    first = f"located {tally.located} of {count} frame{'s' * (count != 1)}"
    if count > 1:
        first += f" at {tally.overall_hz:.1f} Hz"
    latency = _latency(tally)
    lines = [f"{first}; {latency}" if latency else first]
    if tally.dropped:
        lines.append(f"dropped {tally.dropped}, each for a later one that came before its turn; --no-drop lets them wait")
    return [*lines, *(f"{kind}: {times} time{'s' * (times != 1)}" for kind, times in tally.troubles.items())]


def _latency(tally: Tally) -> str:
    if tally.latencies.count == 0:
        return ""
    return f"latency p50 {tally.latencies.percentile_ms(50):.1f} ms, p99 {tally.latencies.percentile_ms(99):.1f} ms"
