"""Size codes of chip parts: imperial 0201 is metric 0603, while imperial 0603 is a part of nearly three times the size."""

from __future__ import annotations

import re
from collections.abc import Sequence

INCH_SIZES_MM = {
    "008004": (0.25, 0.125),
    "01005": (0.4, 0.2),
    "0201": (0.6, 0.3),
    "0402": (1.0, 0.5),
    "0603": (1.6, 0.8),
    "0805": (2.0, 1.25),
    "1206": (3.2, 1.6),
}
METRIC_SIZES_MM = {
    "0201": (0.25, 0.125),
    "0402": (0.4, 0.2),
    "0603": (0.6, 0.3),
    "1005": (1.0, 0.5),
    "1608": (1.6, 0.8),
    "2012": (2.0, 1.25),
    "3216": (3.2, 1.6),
}
"""Nominal length and width (IEC 60115-8 and EIA names)."""

# four to six digits that are not part of a longer or decimal number, optionally followed by "metric" or "M"
_CODE = re.compile(r"(?<![0-9.])([0-9]{4,6})(?:[ _-]?(metric|M))?(?![0-9A-Z]|\.[0-9])", re.IGNORECASE)
_TOLERANCE = 0.2


def chip_code_problem(text: str, body_mm: Sequence[float]) -> str | None:
    """The problem of the chip size codes in a text; None if each one matches the size of the body.

    A code is imperial unless "metric" or "M" follows it. Numbers that are not size codes are ignored.
    """
    for code, metric in _CODE.findall(text):
        size_mm = (METRIC_SIZES_MM if metric else INCH_SIZES_MM).get(code)
        if size_mm is None or _fits(body_mm, size_mm):
            continue
        right = [name for name, size in INCH_SIZES_MM.items() if _fits(body_mm, size)]
        return (
            f"names a chip of {size_mm[0]:g} x {size_mm[1]:g} mm ({code} {'metric' if metric else 'in inches'}), but the body is "
            f"{body_mm[0]:g} x {body_mm[1]:g} mm; {'write ' + right[0] if right else 'leave the code out'}, or put Metric behind "
            "a metric code"
        )
    return None


def _fits(body_mm: Sequence[float], size_mm: Sequence[float]) -> bool:
    # within a fifth of the nominal size: imperial and metric 0603 differ by a factor of 2.7
    return all(abs(a - b) <= _TOLERANCE * b for a, b in zip(body_mm[:2], size_mm, strict=True))
