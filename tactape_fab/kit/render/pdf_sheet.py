"""A PDF page (ISO 32000-1) with lines, outlines, texts, dimensions and tables in millimetres, by ReportLab.

Fonts are embedded and dates fixed, so that equal drawings have equal bytes.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import atan2, cos, degrees, hypot, sin
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.build_date import build_date
from tactape_fab.texture.frames import FloatArray

POINTS_PER_MM = 72.0 / 25.4
TEXT_MM = 2.5
"""Height of ordinary text; ISO 3098 has 2.5 mm as its second smallest size."""
ARROW_MM = 1.8
_EXTENSION_MM = 1.0
REGULAR, BOLD = "TactapeSans", "TactapeSans-Bold"
_BASELINE = 0.35
"""Half the cap height, as a fraction of the font size."""

Point = tuple[float, float]
Grey = float | tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """Mapping of a part of the board to the sheet.

    scale: Millimetres on paper for each millimetre of the board.
    at_mm (x, y): Place of the board's point `origin_mm` on the sheet.
    """

    scale: float
    at_mm: Point
    origin_mm: Point = (0.0, 0.0)

    def __call__(self, xy_mm: FloatArray | Sequence[float]) -> FloatArray:
        """Board frame -> sheet, mm; shape (..., 2)."""
        return (np.asarray(xy_mm, dtype=float) - self.origin_mm) * self.scale + self.at_mm


class Sheet:
    """One landscape page; coordinates are mm from the lower left corner, y up."""

    def __init__(self, size_mm: Point, title: str) -> None:
        from reportlab.pdfgen.canvas import Canvas

        _register_fonts()
        self._bytes = io.BytesIO()
        self.size_mm = size_mm
        width, height = (side * POINTS_PER_MM for side in size_mm)
        # invariant: no date and no random identifier of ReportLab's own
        self._canvas: Any = Canvas(self._bytes, pagesize=(width, height), invariant=1, pageCompression=1, initialFontName=REGULAR)
        date = build_date()  # ReportLab would use the environment's, also in the file's ID, even if a kit is reproduced
        self._canvas._doc.signature = hashlib.md5(title.encode(), usedforsecurity=False)
        self._canvas.setDateFormatter(lambda *_: f"D:{date:%Y%m%d%H%M%S}+00'00'")
        self._canvas.setTitle(title)
        self._canvas.setCreator("tactape-fab")
        # from here on a unit of the canvas is a millimetre; PDF's is 1/72 inch
        self._canvas.scale(POINTS_PER_MM, POINTS_PER_MM)
        self._canvas.setLineJoin(1)

    def pdf(self) -> bytes:
        """The bytes of the file, its page deflated; nothing can be drawn afterwards."""
        from reportlab import rl_config

        self._canvas.showPage()
        others, rl_config.useA85 = rl_config.useA85, 0
        try:
            self._canvas.save()
        finally:
            rl_config.useA85 = others
        return self._bytes.getvalue()

    def line(
        self,
        start: Point | FloatArray,
        end: Point | FloatArray,
        width_mm: float = 0.18,
        *,
        dash: Sequence[float] = (),
        stroke: Grey = 0.0,
    ) -> None:
        """A straight line."""
        self._stroke(stroke, width_mm, dash)
        self._canvas.line(float(start[0]), float(start[1]), float(end[0]), float(end[1]))

    def outlines(
        self,
        outlines_mm: Sequence[FloatArray] | FloatArray,
        *,
        fill: Grey | None = None,
        stroke: Grey | None = 0.0,
        width_mm: float = 0.18,
        dash: Sequence[float] = (),
    ) -> None:
        """Closed polygons as one path, each of shape (k, 2)."""
        self._paint(fill, stroke, width_mm, dash)
        self._path(outlines_mm, " h", stroke=stroke is not None, fill=fill is not None)

    def strokes(self, strokes_mm: Sequence[FloatArray], width_mm: float) -> None:
        """Open polylines as one path, each of shape (k, 2), with round ends."""
        self._stroke(0.0, width_mm, ())
        self._canvas.setLineCap(1)
        self._path(strokes_mm, "", stroke=True, fill=False)
        self._canvas.setLineCap(0)

    def _path(self, lines_mm: Sequence[FloatArray] | FloatArray, end: str, *, stroke: bool, fill: bool) -> None:
        """One path of polylines, written at once, as ReportLab's own methods take 7 us per point.

        The path's list of operators is not part of ReportLab's public interface, so pyproject.toml bounds its version.
        """
        path = self._canvas.beginPath()
        if len(lines_mm):
            points = np.concatenate([np.asarray(line, dtype=float) for line in lines_mm])
            # m moves, l draws a line, h closes the polyline (ISO 32000-1, path construction operators)
            form = " ".join("%.4f %.4f m" + " %.4f %.4f l" * (len(line) - 1) + end for line in lines_mm)
            path._code.append("n " + form % tuple(points.ravel().tolist()))
        self._canvas.drawPath(path, stroke=int(stroke), fill=int(fill))

    def box(
        self,
        low: Point | FloatArray,
        high: Point | FloatArray,
        *,
        fill: Grey | None = None,
        stroke: Grey | None = 0.0,
        width_mm: float = 0.18,
        dash: Sequence[float] = (),
    ) -> None:
        """An upright rectangle."""
        corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])], dtype=float)
        self.outlines([corners], fill=fill, stroke=stroke, width_mm=width_mm, dash=dash)

    def circle(self, centre: Point | FloatArray, radius_mm: float, *, fill: Grey | None = None, width_mm: float = 0.18) -> None:
        """A circle."""
        self._paint(fill, 0.0, width_mm, ())
        self._canvas.circle(float(centre[0]), float(centre[1]), radius_mm, stroke=1, fill=int(fill is not None))

    def text(
        self,
        at: Point | FloatArray,
        words: str,
        *,
        size_mm: float = TEXT_MM,
        bold: bool = False,
        align: str = "left",
        turn_deg: float = 0.0,
    ) -> None:
        """One line of text; `at` is its left end, middle or right end, at half the cap height."""
        self._canvas.saveState()
        self._canvas.translate(float(at[0]), float(at[1]))
        self._canvas.rotate(turn_deg)
        self._canvas.setFillGray(0.0)
        self._canvas.setFont(BOLD if bold else REGULAR, size_mm)
        put: Callable[..., None] = {
            "left": self._canvas.drawString,
            "middle": self._canvas.drawCentredString,
            "right": self._canvas.drawRightString,
        }[align]
        put(0.0, -_BASELINE * size_mm, written(words))
        self._canvas.restoreState()

    def lines_of_text(self, at: Point, words: Sequence[str], *, size_mm: float, width_mm: float) -> float:
        """Paragraphs wrapped at `width_mm` and set from `at` downward; returns y of the next line, mm."""
        from reportlab.lib.utils import simpleSplit

        y = at[1]
        for paragraph in words:
            for line in simpleSplit(written(paragraph), REGULAR, size_mm, width_mm):
                self.text((at[0], y), line, size_mm=size_mm)
                y -= 1.45 * size_mm
        return y

    def arrow(self, tip: Point | FloatArray, direction_rad: float) -> None:
        """A filled arrowhead that points in `direction_rad`."""
        spread = 0.16
        # arms 0.16 rad to each side: an arrowhead about a third as wide as long
        ends = [(cos(direction_rad + side) * ARROW_MM, sin(direction_rad + side) * ARROW_MM) for side in (-spread, spread)]
        self.outlines([np.array([tip, *[(tip[0] - dx, tip[1] - dy) for dx, dy in ends]], dtype=float)], fill=0.0, stroke=None)

    def dimension(self, start: FloatArray, end: FloatArray, words: str, *, away_mm: float, size_mm: float = TEXT_MM) -> None:
        """A dimension from `start` to `end` whose line is `away_mm` to the left of that direction (ISO 129-1)."""
        along = np.asarray(end, dtype=float) - start
        length = hypot(*along)
        unit = along / length
        # to the left: the direction turned by 90 degrees
        across = np.array([-unit[1], unit[0]])
        first, second = start + across * away_mm, end + across * away_mm
        # extension lines begin off the object and end beyond the dimension line
        reach = across * np.sign(away_mm) * _EXTENSION_MM
        for point, tip in ((start, first), (end, second)):
            self.line(point + reach * 0.8, tip + reach, 0.1)
        # if two arrowheads do not fit between the extension lines they are outside and point inward
        outside = length < 2.6 * ARROW_MM
        angle = atan2(unit[1], unit[0])
        self.arrow(first, angle if outside else angle + np.pi)
        self.arrow(second, angle + np.pi if outside else angle)
        stretch = unit * 2 * ARROW_MM if outside else np.zeros(2)
        self.line(first - stretch, second + stretch, 0.1)
        turn = degrees(angle)
        # readable from below or from the right: angles in (-90, 90]
        turn = turn - 180.0 if turn > 90.0 + 1e-9 else turn + 180.0 if turn <= -90.0 + 1e-9 else turn
        upward = np.array([-sin(np.radians(turn)), cos(np.radians(turn))])
        self.text((first + second) / 2 + upward * 0.75 * size_mm, words, size_mm=size_mm, align="middle", turn_deg=turn)

    def table(self, at: Point, rows: Sequence[Sequence[str]], widths_mm: Sequence[float], *, size_mm: float = TEXT_MM) -> float:
        """A ruled table from `at` (upper left corner) downward, with wrapped cells; returns y of its lower edge, mm."""
        from reportlab.lib.utils import simpleSplit

        y, right = at[1], at[0] + sum(widths_mm)
        self.line((at[0], y), (right, y), 0.18)
        for row in rows:
            cells = [
                simpleSplit(written(cell), REGULAR, size_mm, width - 2.0) for cell, width in zip(row, widths_mm, strict=True)
            ]
            height = max(len(lines) for lines in cells) * 1.35 * size_mm + 0.6 * size_mm
            x = at[0]
            for lines, width in zip(cells, widths_mm, strict=True):
                for number, line in enumerate(lines):
                    self.text((x + 1.0, y - (0.95 + 1.35 * number) * size_mm), line, size_mm=size_mm)
                x += width
            y -= height
            self.line((at[0], y), (right, y), 0.1)
        return y

    def _paint(self, fill: Grey | None, stroke: Grey | None, width_mm: float, dash: Sequence[float]) -> None:
        if fill is not None:
            self._canvas.setFillColorRGB(*(fill if isinstance(fill, tuple) else (fill,) * 3))
        if stroke is not None:
            self._stroke(stroke, width_mm, dash)

    def _stroke(self, grey: Grey, width_mm: float, dash: Sequence[float]) -> None:
        self._canvas.setStrokeColorRGB(*(grey if isinstance(grey, tuple) else (grey,) * 3))
        self._canvas.setLineWidth(width_mm)
        self._canvas.setDash(list(dash))


def written(words: str) -> str:
    """Text in characters of the embedded font: the Greek capital delta is replaced by the increment sign (U+2206)."""
    _register_fonts()
    known = _font_characters()
    return "".join(c if ord(c) in known else "?" for c in words.replace("Δ", "∆"))


@cache
def _font_characters() -> frozenset[int]:
    from reportlab.pdfbase.pdfmetrics import getFont

    return frozenset(getFont(REGULAR).face.charToGlyph)


@cache
def _register_fonts() -> None:
    """Register Bitstream Vera, which comes with ReportLab and may be embedded in any document."""
    import reportlab
    from reportlab.pdfbase.pdfmetrics import registerFont
    from reportlab.pdfbase.ttfonts import TTFont

    for name, file in ((REGULAR, "Vera.ttf"), (BOLD, "VeraBd.ttf")):  # by path, as it first tries a name as a URL
        registerFont(TTFont(name, str(Path(reportlab.__file__).parent / "fonts" / file)))
