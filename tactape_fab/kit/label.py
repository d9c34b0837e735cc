"""The label of the strip in a stroke font: text lines and an arrow as polylines (mm, board frame)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from tactape_fab.kit.shapes import rotate
from tactape_fab.texture.frames import FloatArray

_CAP_UNITS = 21.0
"""Capital height of the Hershey simplex fonts in font units: cap line -12 to base line 9 (y down)."""
_BASE_LINE = 9.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Text:
    """Strokes of one line of text, start of its base line at the origin, and its width."""

    strokes_mm: tuple[FloatArray, ...]
    width_mm: float


@cache
def _font(name: str):  # type: ignore[no-untyped-def]
    from HersheyFonts import HersheyFonts

    font = HersheyFonts()
    font.load_default_font(name)
    return font


def _glyph(character: str) -> tuple[list[FloatArray], float]:
    """Strokes in font units, y up from the base line, and the advance."""
    font, key = ("greeks", "D") if character == "Δ" else ("futural", character)
    glyph = _font(font).all_glyphs[key]
    left = glyph.left_offset
    strokes = [np.array([(x - left, _BASE_LINE - y) for x, y in stroke], dtype=np.float64) for stroke in glyph.strokes if stroke]
    return strokes, float(glyph.char_width)


def stroke_text(text: str, cap_height_mm: float) -> Text:
    """A line of text in the Hershey simplex font (Greek simplex for the letter Delta).

    Parameters
    ----------
    text : str
        ASCII characters and ``Δ``.
    cap_height_mm : float
        Height of a capital letter.
    """
    scale = cap_height_mm / _CAP_UNITS
    strokes: list[FloatArray] = []
    x = 0.0
    for character in text:
        glyph, advance = _glyph(character)
        strokes += [(stroke + np.array((x, 0.0))) * scale for stroke in glyph]
        x += advance
    return Text(strokes_mm=tuple(strokes), width_mm=x * scale)


def placed(strokes_mm: tuple[FloatArray, ...], at_mm: tuple[float, float], rotation_deg: float) -> list[FloatArray]:
    """Strokes turned counter-clockwise about their origin, then moved to `at_mm`."""
    return [rotate(stroke, rotation_deg) + at_mm for stroke in strokes_mm]


def arrow(length_mm: float) -> tuple[FloatArray, ...]:
    """Strokes of an arrow that points up from the origin."""
    head = 0.3 * length_mm
    return (
        np.array([(0.0, 0.0), (0.0, length_mm)]),
        np.array([(-0.7 * head, length_mm - head), (0.0, length_mm), (0.7 * head, length_mm - head)]),
    )
