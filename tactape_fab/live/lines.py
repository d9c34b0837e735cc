"""What `watch` says: a line while it runs, and the lines at its end."""

from __future__ import annotations

from tactape_fab.live.tally import Tally


def status_line(tally: Tally) -> str:
    """How it is going, and the last answer."""
    parts = [
        f"{tally.answered} frames",
        f"{tally.hz:.1f} Hz",
        f"located {tally.located}",
        f"dropped {tally.dropped}",
        *([f"unusable {tally.unusable}"] if tally.unusable else []),
        _latency(tally),
    ]
    fix = tally.last
    if fix is not None and not fix.located:
        parts.append(f"not located: {fix.reason}")
    elif fix is not None:
        place = fix.position_mm or fix.plane_mm or (float("nan"), float("nan"))
        turn = "" if fix.theta_deg is None else f" {fix.theta_deg:.1f} deg"
        parts.append(f"{fix.tape or f'sector {fix.sector}'} x {place[0]:.2f} y {place[1]:.2f} mm{turn}")
    return "; ".join(part for part in parts if part)


def end_lines(tally: Tally) -> list[str]:
    """What it came to."""
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
