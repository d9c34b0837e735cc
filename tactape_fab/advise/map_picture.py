"""The map of `advise --map` as SVG: for each part a panel with the smallest contact over the pitch, and a curve per code."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from html import escape
from itertools import groupby
from math import ceil

from tactape_fab.advise.answer import LOCATED, Advice
from tactape_fab.advise.map import MapPoint

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8a6d00", "#56b4e9", "#000000")
"""Colours by Okabe and Ito, which colour-blind readers can distinguish as well."""
_PANEL, _MARGIN, _LEFT, _TOP = (400, 250), 34, 62, 86
_TICKS_MM = 0.2
TITLE = "Smallest round contact of which"
"""Beginning of a map's title, by which a file is recognised as one."""
_INK, _PALE, _REFUSED = "#222222", "#e3e3e3", "#f1efe9"


def draw_map(advice: Advice, points: Sequence[MapPoint]) -> bytes:
    """The picture, with two panels side by side, and a ring at the recommended design."""
    parts = [list(group) for _, group in groupby(points, key=lambda p: (p.part, p.body_mm))]
    across, (width, height) = min(2, len(parts)), _PANEL
    below = 82 if any(p.each is not None for p in points) else 46
    step_x, step_y = _LEFT + width + _MARGIN, height + below + _MARGIN
    whole = (across * step_x, _TOP + ceil(len(parts) / across) * step_y + 16)
    sizes = [size for p in points for size in p.least_mm.values() if size is not None]
    low = float(int(min(sizes, default=2.0)))
    # at least 1, even if all sizes are the same integer
    high = max(float(ceil(max(sizes, default=10.0))), low + 1.0)
    asked = advice.question
    registered = "1 registered tape" if asked.tapes == 1 else f"{asked.tapes} registered tapes"
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{whole[0]}" height="{whole[1]}" viewBox="0 0 {whole[0]} {whole[1]}" '
        f'font-family="Helvetica, Arial, sans-serif" font-size="12" fill="{_INK}">',
        f'<rect width="{whole[0]}" height="{whole[1]}" fill="#ffffff"/>',
        _text(_LEFT, 26, f"{TITLE} {LOCATED:.0%} are located, by pitch W, part and code", size=16),
        _text(
            _LEFT,
            46,
            f"{asked.sensor.name}, {registered} of {asked.size_mm[0]:g} x {asked.size_mm[1]:g} mm by "
            f"{asked.making.name}; at each W the best Δ that no rule refuses",
        ),
    ]
    same = _alike(points)
    for k, of_part in enumerate(parts):
        x, y = _LEFT + k % across * step_x, _TOP + k // across * step_y
        lines.append(f'<g transform="translate({x} {y})">')
        lines += _panel(advice, of_part, same, low, high)
        lines.append("</g>")
    right = float(_LEFT)
    for colour, names in zip(_COLOURS, same, strict=False):
        named = ", ".join(names)
        lines += [
            f'<path d="M{right:.0f} {whole[1] - 20}h26" stroke="{colour}" stroke-width="3"/>',
            _text(right + 32, whole[1] - 16, named),
        ]
        right += 56 + 6.6 * len(named)
    return "\n".join([*lines, "</svg>\n"]).encode()


def _alike(points: Sequence[MapPoint]) -> list[tuple[str, ...]]:
    """Codes in the order of the points, grouped if their curves are equal for every part."""
    curves: dict[tuple[float | None, ...], list[str]] = {}
    for name in dict.fromkeys(name for p in points for name in p.least_mm):
        curves.setdefault(tuple(p.least_mm.get(name) for p in points), []).append(name)
    return [tuple(names) for names in curves.values()]


def _panel(advice: Advice, points: Sequence[MapPoint], same: Sequence[tuple[str, ...]], low: float, high: float) -> Iterator[str]:
    width, height = _PANEL
    first, last = points[0].pitch_mm, points[-1].pitch_mm
    legal = [p for p in points if p.least_mm]

    def at(pitch_mm: float, size_mm: float) -> tuple[float, float]:
        return (pitch_mm - first) / (last - first) * width, (high - size_mm) / (high - low) * height

    body = "x".join(f"{side:g}" for side in points[0].body_mm)
    yield _text(0, -8, f"{points[0].part}, {body} mm", size=13)
    yield f'<rect width="{width}" height="{height}" fill="#ffffff" stroke="{_INK}"/>'
    refused = at(legal[0].pitch_mm if legal else last, low)[0]
    if refused > 0:
        yield f'<rect width="{refused:.1f}" height="{height}" fill="{_REFUSED}" stroke="none"/>'
        yield _text(refused / 2, height / 2, "rules refuse", anchor="middle", turned=True)
    for size in range(int(low), int(high) + 1):
        y = at(first, size)[1]
        yield f'<path d="M0 {y:.1f}h{width}" stroke="{_PALE}"/>' + _text(-8, y + 4, f"{size}", anchor="end")
    yield _text(-42, height / 2, "contact, mm", anchor="middle", turned=True)
    currency = advice.currency if any(p.each is not None for p in legal) else None
    ticks = [p for p in points if round(p.pitch_mm / _TICKS_MM, 6).is_integer()]
    for p in ticks:
        x = at(p.pitch_mm, low)[0]
        yield f'<path d="M{x:.1f} {height}v5" stroke="{_INK}"/>' + _text(x, height + 19, f"{p.pitch_mm:g}", anchor="middle")
        if p.parts:
            yield _text(x, height + 37, f"{p.parts}", anchor="middle")
        if p.each is not None:
            yield _text(x, height + 55, f"{p.each:.1f}", anchor="middle")
    rows = ["W, mm", "parts", *([] if currency is None else [f"{currency}"])]
    for k, row in enumerate(rows):
        yield _text(-12, height + 19 + 18 * k, row, anchor="end")
    if currency is not None:
        once = next(p.once for p in legal if p.once is not None)
        yield _text(
            0, height + 74, f"assembly of one tape, estimated; an order adds {once:.0f} {currency}, the board is not in it"
        )
    for k, (colour, names) in reversed([*enumerate(zip(_COLOURS, same, strict=False))]):
        yield from _curve([(p.pitch_mm, p.least_mm.get(names[0])) for p in points], at, colour, 2.0 + 0.7 * k)
    asked_mm = advice.question.contact_mm
    if low <= asked_mm <= high:
        y = at(first, asked_mm)[1]
        yield f'<path d="M0 {y:.1f}h{width}" stroke="{_INK}" stroke-dasharray="6 4"/>'
        yield _text(width - 6, y - 5, f"asked: {asked_mm:g} mm", anchor="end")
    best = advice.lines[0]
    of_part = (best.design.part, tuple(best.design.body_mm)) == (points[0].part, tuple(points[0].body_mm))
    if of_part and best.least_mm is not None and first <= best.design.pitch_mm <= last:
        x, y = at(best.design.pitch_mm, best.least_mm)
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="none" stroke="{_INK}" stroke-width="2"/>'
        yield _text(x + 10, y + 16, f"recommended: W {best.design.pitch_mm:g}, {best.code.name}")


def _curve(
    sizes: Sequence[tuple[float, float | None]], at: Callable[[float, float], tuple[float, float]], colour: str, width: float
) -> Iterator[str]:
    """The pieces of a curve for which sizes exist."""
    for there, group in groupby(sizes, key=lambda one: one[1] is not None):
        if there:
            places = [at(pitch_mm, size_mm) for pitch_mm, size_mm in group if size_mm is not None]
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
            yield f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width:.1f}"/>'


def _text(x: float, y: float, text: str, *, anchor: str = "start", size: int = 0, turned: bool = False) -> str:
    more = (f' font-size="{size}"' if size else "") + (f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turned else "")
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{escape(text)}</text>'
