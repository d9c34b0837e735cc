"""Check of the fab drawing's words: in their order none may differ from the manifest, be missing, or be added."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from tactape_fab.base.fields import shown as quoted
from tactape_fab.solids.elements import reach_mm
from tactape_fab.texture.cpl import PLACEMENTS
from tactape_fab.texture.directions import USUAL_DIRECTIONS
from tactape_fab.verify.layers.kicad import Shown
from tactape_fab.verify.layers.kicad_drawn import Made
from tactape_fab.verify.layers.lands import between_lands_mm, opening_size_mm

_F = r"[-+.\de]{1,12}"
"""Pattern of a figure that the manifest does not contain."""
_HOLE = re.compile(rf"\? ({_F}) x ({_F}) y ({_F})")
_FIELD = re.compile(rf" ({_F}) field ({_F}) A ")
_THREE_DIGITS = 0.006
_MOST_HOLES = 8
_HOLE_MM = 6e-4
"""Tolerance of figures with three decimals."""


def in_ascii(text: str) -> str:
    """A text with '?' for non-ASCII characters, as the drawing's reader, which does not read the font, gives it."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)


def word_problems(words: str, expected: Shown, made: Made) -> list[str]:
    """Problems of the drawing's words: the first that differs from the manifest, and holes that differ."""
    at = 0
    for pattern in _pieces(expected, made, dashes=" Short dashes: " in words):
        found = re.compile(f" {pattern}(?= )").match(words, at)
        if found is None:
            return [f"it says {quoted(words[at : at + 80].strip())} where {quoted(_fixed(pattern))} should stand and go on"]
        at = found.end()
    drawn = np.array(_HOLE.findall(words), dtype=np.float64).reshape(-1, 3)[:, [1, 2, 0]]
    holes = np.array(expected.holes, dtype=np.float64).reshape(-1, 3)
    same = np.all(np.abs(drawn[:, None] - holes) <= _HOLE_MM, axis=2)
    # each row is a hole, and each of another one
    listed = same.any(axis=1).all() and np.count_nonzero(same.any(axis=0)) >= len(drawn)
    wrong = len(drawn) != min(len(holes), _MOST_HOLES) or not listed
    reach_x_mm, (x_mm, _) = reach_mm(made.tape.part)[0], expected.parts_xy_mm.T
    for left, length in _FIELD.findall(words):
        if float(left) > x_mm.min() - reach_x_mm or float(left) + float(length) < x_mm.max() + reach_x_mm:
            return [f"its field of {length} mm from {left} mm does not hold all parts"]
    drawn_mm, most_mm = re.search(rf" least spacing ({_F}) ", words), between_lands_mm(made.record.lands)
    if drawn_mm is not None and float(drawn_mm[1]) - most_mm > abs(most_mm) * _THREE_DIGITS:
        return [f"its least spacing of {drawn_mm[1]} mm is more than between the lands of a part"]
    return [*(["it says more than it should"] if words[at:] != " " else []), *(["its holes are not the kit's"] if wrong else [])]


def _fixed(pattern: str) -> str:
    """The fixed text that a pattern begins with; of alternatives the first."""
    text = re.sub(r"\(\?:([^|()]*)\|[^()]*\)", r"\1", pattern)
    return re.sub(r"\\(.)", r"\1", re.split(r"(?<!\\)[\[(]|\\d", text)[0]).strip()


def _opened(made: Made, window: str, each: str) -> str:
    """Pattern of words about the openings; tapes of a panel may differ in them."""
    return f"(?:{each}|{window})" if made.on_panel else window if made.record.film.mode == "gang" else each


def _pieces(expected: Shown, made: Made, *, dashes: bool) -> Iterator[str]:
    """Patterns of the words in their order, to be joined by blanks; only figures that are not recorded are free."""
    tape, pads, count = made.tape, made.record.lands.pads, len(expected.parts_xy_mm)
    opening = " x ".join(f"{side:g}" for side in opening_size_mm(made.record.lands))
    order, radius_mm = made.record.order, made.radius_mm
    length, width, height = (f"{side:g}" for side in tape.part.body_mm)
    # drawings before the first release called a solder mask coverlay as well
    mask = f"(?:{'solder mask' if order is None else re.escape(order.mask)}|coverlay)"
    tapes, (wide, high) = r"(?:\d+ )*?" * made.on_panel, expected.size_mm
    yield f"OUTLINE, seen from the parts' side {tapes}{wide:g} {high:g}"
    if not made.on_panel:
        yield rf"{_F} field {_F} A"
    if radius_mm > 0:
        yield rf"radius {radius_mm:g} \(4x\)"
    yield "Grey: the field of parts. Nothing may be added there." + " Short dashes: where a number may be printed." * dashes
    yield rf"A: the first parts, {_F}:1 W {tape.pitch_mm:.4g}(?: R\d+)*"
    ways = "N, S, E or W" if tape.directions == USUAL_DIRECTIONS else f"in one of {tape.directions} directions"
    yield rf"Circle: land 1. Each part stands {tape.displacement_mm:.4g} {ways} of its grid point: do not align them\."
    first_deg = float(expected.rotation_deg[0])
    yield rf"B: one part {f'{first_deg:g}[?] ' * (first_deg > 0)}1 {length}"
    openings = _opened(made, f"one window in the {mask} for all parts", f"{mask} opening {opening}")
    yield f"Body {length} x {width} x {height}; {openings};"
    yield rf"lands {pads.size_mm[0]:g} x {pads.size_mm[1]:g}, centres at \?{pads.offset_mm:g} from the part's\."
    angles = sorted(set(expected.rotation_deg.tolist()))
    turned = " or ".join(f"{angle:g}[?]" for angle in angles)
    yield f"{'All parts' if len(angles) == 1 else 'Parts, tape by tape,'} turned {turned} counter-clockwise."
    yield from _layers(count, mask, opening, height, made)
    if expected.holes:
        more = len(expected.holes) - _MOST_HOLES
        listed = "".join(rf" \? {_F} x {_F} y {_F}" for _ in expected.holes[:_MOST_HOLES])
        yield rf"HOLES, not plated \(mm from the lower left corner\){listed}" + f" and {more} more in the drill file" * (more > 0)
    yield from _notes(angles, mask, made, dashes=dashes)
    yield rf"Title {re.escape(made.name)}"
    grid = rf"W {tape.pitch_mm:.4g}, \? {tape.displacement_mm:.4g}"
    of = f"sector {tape.sector} of {tape.code}; {tape.columns} x {tape.rows} points, {grid}"
    texture = "[^;]{1,200}; W [^;]{1,200}" if made.on_panel else of
    yield f"Texture {texture} Fab profile [^;]{{1,100}}; assembly format {made.record.assembly.format}"
    yield rf"Scale outline (?:{_F}:1|1:{_F}), A {_F}:1; all dimensions in mm"
    yield r"Date, tool \d{4}-\d\d-\d\d, tactape-fab [^ ;]{1,40}; sheet 1 of 1, A4"


def _layers(count: int, mask: str, opening: str, height: str, made: Made) -> Iterator[str]:
    """Patterns of the table of layers, and of the words beside the cross-section."""
    order, backings, legend_mm = made.record.order, made.record.film.backings, made.record.legend
    line = _F if legend_mm is None else f"{legend_mm.line_mm:g}"

    def text(value: str | None) -> str:
        return "[^;]{1,200}" if value is None else re.escape(in_ascii(value))

    yield rf"LAYERS, from the top parts {count} x {text(made.record.assembly.footprint)}, height {height}"
    colour, legend, copper, finish, base, film = (
        (None,) * 6
        if order is None
        else (
            order.coverlay_colour,
            order.legend_colour,
            f"{order.copper_um:g}",
            order.finish,
            order.base,
            f"{order.thickness_mm:g}",
        )
    )
    ink = made.gerbers.get("legend-top")
    printed = f"{text(legend)}, lines of {line} or more"
    yield f"legend {f'(?:none|{printed})' if ink is None else printed if ink.areas_mm or ink.strokes_mm else 'none'}"
    openings = _opened(made, "one opening for all parts", f"{count} openings of {opening}, never merged")
    if made.on_panel:
        openings = f"(?:{openings}|opened for all parts of a tape, or for each part: as drawn)"
    yield f"{mask} {text(colour)}; {openings}"
    yield rf"copper {text(copper)} \?m, one layer, {text(finish)}; least spacing {_F}"
    yield rf"base {text(base)}; film {text(film)} thick in all"
    stiffener, adhesive = backings.get("stiffener-bottom"), backings.get("adhesive-bottom")
    where = "under the tapes alone" if made.on_panel else "whole underside"
    yield "stiffener none" if stiffener is None else rf"stiffener {text(stiffener)} mm, {where}"
    if adhesive is not None:
        yield rf"adhesive {text(adhesive)} mm{' under the stiffener' if stiffener else f', {where}'}"
    beside = ["stiffener"] * (stiffener is not None) + ["adhesive"] * (adhesive is not None)
    yield " ".join([*beside, f"part {mask} base"])


def _notes(angles_deg: Sequence[float], mask: str, made: Made, *, dashes: bool) -> Iterator[str]:
    """Patterns of the six notes."""
    yield r"NOTES 1\. The Gerber and drill files rule; this drawing explains them\."
    sense = "clockwise" if PLACEMENTS[made.record.assembly.format].clockwise else "counter-clockwise"
    yield rf"2\. Rotations in the placement file are {sense}, 0 is along x\."
    length, width, _ = made.tape.part.body_mm
    if length != width:
        leans = " or, on turned tapes, ".join(re.escape(lean(angle)) for angle in angles_deg)
        yield f"Seen from above, every part leans like this: {leans}"
    alone, anchored = r"Pads stand alone on purpose\.", rf"pads under the {mask} to hold them: it is no track\."
    if made.on_panel:
        alone = rf"(?:{alone}|Copper runs on from (?:some|the) {anchored})"
    elif made.record.film.anchor is not None:
        alone = f"Copper runs on from the {anchored}"
    yield rf"3\. The parts carry no signal: no nets, no electrical test\. {alone}"
    where = "only in the rails, better none" if made.on_panel else "only within the short dashes, better none"
    number = where if dashes or made.on_panel else "none on the tape"
    yield rf"Either land may be land 1\. 4\. Order numbers and date codes: {number}\."
    yield r"In the field no logo, fiducial, hole, coupon or copper\."
    merged = rf"Openings of the {mask} are not merged\. Ask before a bridge between two of them is changed\."
    some = rf"(?:The {mask} differs from tape to tape, on purpose\. )?" * made.on_panel
    yield r"5\. " + _opened(made, rf"The {mask} has one opening for all parts, on purpose\.", some + merged)
    yield r"6\. Outline and holes: the fab's own tolerances\. Parts: as near to their place as the line can\."
    yield r"A missing, standing or turned part is a fault\."


def lean(rotation_deg: float) -> str:
    """The character that resembles a chip's long axis; of two equally near ones, as `round` decides."""
    return {0: "-", 1: "/", 2: "|", 3: "\\"}[round(rotation_deg % 180.0 / 45.0) % 4]
