"""The label of the strip in a stroke font: text lines and an arrow as polylines (mm, board frame)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations, pairwise

import numpy as np

from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import rotate

_CAP_UNITS = 21.0
"""Capital height of the Hershey simplex fonts in font units: cap line -12 to base line 9 (y down)."""
_BASE_LINE = 9.0
_DELTA = (
    (np.array([(9.0, 21.0), (1.0, 0.0)]), np.array([(9.0, 21.0), (17.0, 0.0)]), np.array([(1.0, 0.0), (17.0, 0.0)])),
    18.0,
)
"""Strokes and advance of Δ, copied from the Hershey Greek simplex font, which takes long to load."""

LINE_PITCH = 1.65
"""Line spacing in cap heights: a capital, a descender (a third of it), the ink's width and a gap."""
ARROW_MM = 3.0
ARROW_GAP_MM = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Text:
    """Strokes of one line of text, whose base line starts at the origin, and its width."""

    strokes_mm: tuple[FloatArray, ...]
    width_mm: float


@cache
def _font():  # type: ignore[no-untyped-def]
    from HersheyFonts import HersheyFonts

    class Simplex(HersheyFonts):  # type: ignore[misc]
        default_font_names = ("futural",)  # listing all fonts would unpack their archive once more

    font = Simplex()
    font.load_default_font(*Simplex.default_font_names)
    return font


@cache
def _glyph(character: str) -> tuple[tuple[FloatArray, ...], float]:
    """Strokes in font units, y up from the base line, and the advance."""
    if character == "Δ":
        return _DELTA
    # Hershey's y runs down and its glyphs begin at the left offset; here y runs up from the base line and x from 0
    glyph = _font().all_glyphs[character]
    left = glyph.left_offset
    strokes = ([(x - left, _BASE_LINE - y) for x, y in stroke] for stroke in glyph.strokes if stroke)
    return tuple(np.array(stroke, dtype=np.float64) for stroke in strokes), float(glyph.char_width)


def stroke_text(text: str, cap_height_mm: float) -> Text:
    """A line of text in the Hershey simplex font (Greek simplex for the letter Delta).

    text: ASCII characters and ``Δ``.
    cap_height_mm: Height of a capital letter.
    """
    scale = cap_height_mm / _CAP_UNITS
    strokes: list[FloatArray] = []
    x = 0.0
    for character in text:
        glyph, advance = _glyph(character)
        right = np.array((x, 0.0))
        strokes += [(stroke + right) * scale for stroke in glyph]
        x += advance
    return Text(strokes_mm=tuple(strokes), width_mm=x * scale)


def _width_mm(text: str, cap_height_mm: float) -> float:
    """Width of `stroke_text`."""
    return sum(_glyph(character)[1] for character in text) * (cap_height_mm / _CAP_UNITS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """Strokes of a whole label in the board frame, and the names of texts that did not fit."""

    strokes_mm: tuple[FloatArray, ...]
    left_out: tuple[str, ...]


def _placed(strokes_mm: tuple[FloatArray, ...], at_mm: tuple[float, float], rotation_deg: float) -> list[FloatArray]:
    """Strokes rotated counter-clockwise about their origin, then moved to `at_mm`."""
    return [rotate(stroke, rotation_deg) + at_mm for stroke in strokes_mm]


def _arrow() -> tuple[FloatArray, ...]:
    """Strokes of an arrow that points up from the origin."""
    head = 0.3 * ARROW_MM
    return (
        np.array([(0.0, 0.0), (0.0, ARROW_MM)]),
        np.array([(-0.7 * head, ARROW_MM - head), (0.0, ARROW_MM), (0.7 * head, ARROW_MM - head)]),
    )


def _pack(fields: Sequence[str], lines: int, length_mm: float, cap_mm: float) -> tuple[list[str], list[str]]:
    """Break fields into lines such that the longest is as short as possible; the last fields are dropped until they fit."""
    # at most four fields, so that all line breaks can be tried
    for kept in range(len(fields) if lines > 0 else 0, 0, -1):
        splits = combinations(range(1, kept), min(lines, kept) - 1)
        spread = [["  ".join(fields[i:j]) for i, j in pairwise((0, *split, kept))] for split in splits]
        best = min(spread, key=lambda texts: max(_width_mm(text, cap_mm) for text in texts))
        if all(_width_mm(text, cap_mm) <= length_mm for text in best):
            return best, list(fields[kept:])
    return [], list(fields)


def compose_label(fields: Sequence[str], *, x_mm: tuple[float, float], y_mm: tuple[float, float], cap_mm: float) -> Label:
    """Text that reads upward, and above it an arrow that points to board +y.

    If there is not enough space for both, at most one field of text is left out for the arrow.

    fields: Texts to print, most important first.
    x_mm, y_mm: Available area: (left, right) and (low, high).
    cap_mm: Height of a capital letter.
    """
    line_mm = LINE_PITCH * cap_mm
    # n lines take (n - 1) pitches and one cap height; 1e-9 for a strip that they fill exactly. Below 1 in a narrower strip
    lines = int((x_mm[1] - x_mm[0] - cap_mm) / line_mm + 1e-9) + 1
    low, high = y_mm
    beside_arrow = _pack(fields, lines, high - low - ARROW_MM - ARROW_GAP_MM, cap_mm)
    alone = _pack(fields, lines, high - low, cap_mm)
    has_arrow = lines > 0 and len(beside_arrow[1]) <= len(alone[1]) + 1 and high - low >= ARROW_MM
    packed, left_out = beside_arrow if has_arrow else alone
    strokes: list[FloatArray] = []
    middle = (x_mm[0] + x_mm[1]) / 2
    if has_arrow:
        name = stroke_text("+y", cap_mm)
        # the arrow's head is 0.7 * 0.3 * 2 = 0.42 arrow lengths wide: its tip stays half of that off the strip's end
        at = (min(middle + 0.8 * cap_mm, x_mm[1] - 0.21 * ARROW_MM), high - ARROW_MM)
        strokes += _placed(_arrow(), at, 0.0)
        name_left = at[0] - 0.28 * ARROW_MM - name.width_mm
        if name_left >= x_mm[0]:
            strokes += _placed(name.strokes_mm, (name_left, high - (ARROW_MM + cap_mm) / 2), 0.0)
    # turned by 90 degrees a capital extends to -x from its base line, so the block is centred by half a cap height
    first = middle - (len(packed) - 1) * line_mm / 2 + cap_mm / 2
    for i, text in enumerate(packed):
        strokes += _placed(stroke_text(text, cap_mm).strokes_mm, (first + i * line_mm, low), 90.0)
    missing = [f"'{field}'" for field in left_out] + ([] if has_arrow else ["the arrow for board +y"])
    return Label(strokes_mm=tuple(strokes), left_out=tuple(missing))
