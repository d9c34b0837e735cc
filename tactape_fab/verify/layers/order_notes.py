"""Check that the values in the order notes, which are typed into the fab's form, are those of the manifest."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named, shown
from tactape_fab.kit.panel.geometry import CORNER_RADIUS_MM, Panel
from tactape_fab.kit.read.gerber_file import ReadbackError, read_gerber
from tactape_fab.kit.render.order_notes import COPPER_OZ, LAMINATES, in_a_line
from tactape_fab.solids.elements import reach_mm
from tactape_fab.texture.cpl import PLACEMENTS
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly
from tactape_fab.verify.layers.drawing_words import lean
from tactape_fab.verify.layers.film_layers import FilmManifest
from tactape_fab.verify.layers.job_file import FabOrder
from tactape_fab.verify.layers.kicad import Shown, shown_tape
from tactape_fab.verify.layers.lands import between_lands_mm, opening_size_mm
from tactape_fab.verify.layers.legend import inked_or_cut

UPLOADED = ("fab-zip", "cpl", "bom")
_MOST_NAMED = 8
_PATH = re.compile(r"(?<![\w./-])[\w./-]{1,300}\.(?:zip|csv|xyrs|pos|gbr|png|svg)(?!\.?\w)")
_MOST_NOTES_BYTES = 100_000
_NUMBER = r"(-?\d+\.\d)"
_FIGURE = r"(-?\d+(?:\.\d+)?)"
_PRINT_AREA = re.compile(
    rf"^   Order number, [^\n]* only in the strip[^\n]*, x {_NUMBER} to {_NUMBER} mm, y {_NUMBER} to {_NUMBER} mm", re.MULTILINE
)
_FIELD = re.compile(rf"field of parts, x {_NUMBER} to {_NUMBER} mm, y {_NUMBER} to {_NUMBER} mm")

_ROW = re.compile(r"^   (\S(?:[^ \n]| (?! ))*) {2,}(\S[^\n]*)$", re.MULTILINE)
_SPACING = ("least spacing of copper", "Min Track/Spacing")
"""Rows with a length that the manifest does not contain."""
_ASK_FOR_PANEL = "): please panelise it,"
_OUTSIDE = re.compile(rf"outside what the line takes \({_FIGURE} x {_FIGURE} to {_FIGURE} x {_FIGURE} mm\)")
_ROUNDED_MM = 6e-4
_ALWAYS = 8
"""Number of rows that every form has: the first of the expected rows, before those of the backings."""
_BACKINGS = ("stiffener", "adhesive")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ordered:
    """The ordered item: a tape, or a panel, on which the fab may print only in the rails."""

    name: str
    shown: Shown
    panel: Panel | None = None

    @property
    def part_count(self) -> int:
        return len(self.shown.parts_xy_mm)


def check_order_notes(
    files: Mapping[str, WrittenFile], tape: Tape, of: Ordered | None = None, *, film: FilmManifest | None = None
) -> Check:
    """Check that the notes have this tape's name, size, number of parts and files, and leave only free areas for print.

    For a panel, `tape` is the first of its tapes, and `of` the panel. Without `film`, the manifest's record, the rows of the
    forms are not compared.
    """
    if len(files["order-notes"].data) > _MOST_NOTES_BYTES:
        return Check(name="order-notes", passed=False, message=f"they are longer than {_MOST_NOTES_BYTES} bytes")
    of = of or Ordered(name=tape.name, shown=shown_tape(tape, np.empty((0, 2, 2)), 0.0))
    try:
        text = files["order-notes"].data.decode("utf-8")
    except UnicodeDecodeError as error:
        return Check(name="order-notes", passed=False, message=f"they are not UTF-8: {error.reason} at byte {error.start}")
    width, height = map(_length, of.shown.size_mm)
    facts = [f"{of.name} at ", f"{width} x {height} mm", f"{of.part_count} parts"]
    problems = [f"they lack {what!r}" for what in (*facts, *(files[role].path for role in UPLOADED)) if what not in text]
    paths = {file.path for file in files.values()}
    old = text.partition("\n1. FILES\n")[2].partition("\n2. THE BOARD")[0]  # notes of version 0.1.0
    listed = old or text.partition("\nSTEP 1. ")[2].partition("\nSTEP 10. ")[0]
    problems += [f"they name {path}, which is not in the kit" for path in _PATH.findall(listed) if path not in paths]
    if film is not None and film.order is not None and not old:
        problems += _row_problems(text, tape, of, film, film.order, legend="legend-top" in files)
        problems += _wrong_words(text.partition("\nSTEP 10. ")[0], paths, film)
        problems += _remark_problems(text.partition("\nSTEP 10. ")[0], tape, of, film)
        problems += _backing_problems(text, files, film.film.backings)
    found = _PRINT_AREA.findall(text)
    if not found and ("only in the rails" if of.panel else "no room for one") not in text:
        problems.append("they do not say where the fab may print")
    for area in found:
        x0, x1, y0, y1 = map(float, area)
        centres, reach = tape.part_xy_mm(), np.array(reach_mm(tape.part))
        # parts whose centre is in the area widened by a body's reach extend into the area
        near = (centres > np.array([x0, y0]) - reach).all(axis=1) & (centres < np.array([x1, y1]) + reach).all(axis=1)
        legend = None
        with suppress(KeyError, ReadbackError):  # the file is missing, or reported as unreadable elsewhere
            legend = read_gerber(files["legend-top"].data)
        taken = inked_or_cut(legend, tape.board.holes)
        over = near.any() or any((low < (x1, y1)).all() and (high > (x0, y0)).all() for low, high in taken)
        if over or of.panel or not (0.0 <= x0 < x1 <= tape.board.size_mm[0] and 0.0 <= y0 < y1 <= tape.board.size_mm[1]):
            where = f"x {x0:g} to {x1:g} mm, y {y0:g} to {y1:g} mm"
            problems.append(f"they let the fab print at {where}, on parts, ink or holes, or off the board")
    right = "tape, size, parts, files and rows of the forms as the kit has them; not compared: what else they say"
    return Check(name="order-notes", passed=not problems, message="; ".join(problems[:_MOST_NAMED]) or right)


def _row_problems(text: str, tape: Tape, of: Ordered, film: FilmManifest, order: FabOrder, *, legend: bool) -> Iterator[str]:
    """Problems of rows that differ from the manifest, or are missing although every form needs them."""
    # steps 1 to 4 are the board's form, those up to 9 the whole order; the rest is for the user
    form, rest = text.partition("\nSTEP 5. ")[0], text.partition("\nSTEP 10. ")[0]
    expected = _expected_rows(tape, of, film, order, text, legend=legend)
    known = {label: value for labels, value in expected.items() for label in labels}
    rows = _ROW.findall(rest)
    for label, value in rows:
        # prose is free, but a value in a row of a form must be the manifest's
        if label in known and re.fullmatch(known[label], value) is None:
            yield f"{shown(label)} is {shown(value)}, which is not the manifest's"
        figure = re.fullmatch(rf"{_FIGURE} mm", value) if label in _SPACING else None
        if figure is not None and float(figure[1]) > between_lands_mm(film.lands) + _ROUNDED_MM:
            yield f"{shown(label)} is {shown(value)}, more than between the lands of a part"
    yield from (
        f"they ask for {shown(label)} {shown(value)}, which no form of this tool does"
        for label, value in _ROW.findall(form)
        if re.search(r"\d ?mm\b", value) and label not in known and label not in _SPACING
    )
    rows_there, laminated = {label for label, _ in rows}, [f"{backing}-bottom" in film.film.backings for backing in _BACKINGS]
    # forms of rigid boards have no row for a stiffener, which is only in the remark
    asked = [True] * _ALWAYS + [order.flexible and there for there in laminated]
    yield from (
        f"they do not say the {labels[0]}"
        for labels, must in zip(expected, asked, strict=False)
        if must and rows_there.isdisjoint(labels)
    )


def _wrong_words(text: str, paths: Collection[str], film: FilmManifest) -> Iterator[str]:
    """Problems of sentences that ask for what must not be done, outside of names, which may contain any word."""
    prose = text.partition("\n")[2]  # the first line is the name of the tape and that of the fab's profile
    part = film.assembly
    for name in (*sorted(paths, key=len, reverse=True), *map(in_a_line, film.film.broken)):
        prose = prose.replace(name, "")
    for name in filter(None, (part.description, part.footprint, part.value, part.part_number)):
        prose = re.sub(rf"(?<= ){_escaped(name)}(?=[;,\n]|\.$)", "", prose, flags=re.MULTILINE)
    for found in re.finditer(r"\b(merge|align)\b", prose, re.IGNORECASE):
        if not prose.endswith("Do not ", 0, found.start()):
            yield f"they say {found[1]!r} without 'Do not'"


def _remark_problems(text: str, tape: Tape, of: Ordered, film: FilmManifest) -> Iterator[str]:
    """Problems of sentences in the remarks that differ from the manifest."""
    yield from _placement_problems(text, of, film.assembly)
    (width, height), angles_deg = map(_length, of.shown.size_mm), sorted(set(of.shown.rotation_deg.tolist()))
    opening = tuple(map(_length, opening_size_mm(film.lands)))
    (x, y), last = (tuple(map(_length, of.shown.parts_xy_mm[i].tolist())) for i in (0, -1))
    leans = *map(lean, angles_deg), None
    yield from _other_figures(text, rf"one opening of {_FIGURE} x {_FIGURE} mm for both pads", opening)
    yield from _other_figures(text, rf"one board of {_FIGURE} x {_FIGURE} mm", (width, height))
    yield from _other_figures(text, r"\blean(?:s like this:|ing like) (\S)(?: or, on turned tapes, (\S))?", leans[:2])
    yield from _other_figures(text, rf"and R(\d+) at {_FIGURE}, {_FIGURE} mm", (str(of.part_count), *last))
    sentences = {
        rf"turned {_FIGURE} deg": {_length(angle % 360.0) for angle in angles_deg},
        rf"R1 at {_FIGURE},": {x},
        rf"R1 at {x}, {_FIGURE} mm": {y},
        rf"(?<![\d.-]){_FIGURE} parts": {str(of.part_count)},
    }
    if of.panel is not None:
        cut = {"in rails": of.panel.rail_mm, "slots": of.panel.gap_mm, "tabs": of.panel.tab_mm}
        sentences |= {rf"{what} of {_FIGURE} mm": {_length(wide_mm)} for what, wide_mm in cut.items()}
    else:
        sentences[rf"differ by {_FIGURE} mm"] = {f"{tape.displacement_mm:.4g}"}
        sentences[rf"regular grid of {_FIGURE} mm"] = {f"{tape.pitch_mm:.4g}"}
        yield from _other_figures(text, rf"The board alone \({_FIGURE} x {_FIGURE} mm\)", (width, height))
        sides_mm = np.sort(of.shown.size_mm)[::-1]  # the longer one first, as in the fab's limits
        for limits in _OUTSIDE.findall(text):
            least_mm, most_mm = np.array(limits, dtype=float).reshape(2, 2)
            if (least_mm <= sides_mm).all() and (sides_mm <= most_mm).all():
                yield f"they ask for a panel, and the line takes a board of {width} x {height} mm"
        reach = reach_mm(tape.part)
        low, high = (tape.part_xy_mm() - reach).min(axis=0), (tape.part_xy_mm() + reach).max(axis=0)
        for box in _FIELD.findall(text):
            x0, x1, y0, y1 = map(float, box)
            if x0 > low[0] or y0 > low[1] or x1 < high[0] or y1 < high[1]:
                yield f"they protect x {x0:g} to {x1:g} mm, y {y0:g} to {y1:g} mm as the field of parts, and parts lie beyond it"
    for pattern, right in sentences.items():
        # the sentence must occur, and always with the right figure
        if wrong := {*re.findall(pattern, text)} ^ right:
            yield f"they say {named(sorted(wrong))} where {pattern.replace(_FIGURE, ' and '.join(sorted(right)))!r} should stand"


def _backing_problems(text: str, files: Mapping[str, WrittenFile], backings: Mapping[str, str]) -> Iterator[str]:
    """Problems of stiffener and adhesive in the board's remark; no Gerber file contains their thickness."""
    for word in map(str.capitalize, _BACKINGS):
        role = f"{word.lower()}-bottom"
        wanted = [(backings[role], files[role].path)] if role in backings and role in files else []
        found = re.findall(rf"^   {word} ([^\n]{{1,40}}) mm on the underside[^\n]*, where (\S+) has it", text, re.MULTILINE)
        if found != wanted:
            written, right = ([f"{word} {what} mm by {path}" for what, path in rows] or ["nothing"] for rows in (found, wanted))
            yield f"they say {named(written)} of the underside, where {right[0]} should stand"


def _other_figures(text: str, pattern: str, right: tuple[str | None, ...]) -> Iterator[str]:
    """Problems of figures and words in every sentence that matches `pattern`."""
    for found in re.finditer(pattern, text):
        if found.groups() != right:
            written, wanted = (", ".join(filter(None, words)) for words in (found.groups(), right))
            yield f"they say {written} where {wanted} should stand"


def _placement_problems(text: str, of: Ordered, assembly: RecordedAssembly) -> Iterator[str]:
    """Problems of the text for the assembly line: frame, sense of rotation, side, parts and quantity to buy."""
    house = PLACEMENTS[assembly.format]
    sense = "clockwise" if house.clockwise else "counter-clockwise"
    as_listed = (assembly.format, house.unit, sense, "as in the Gerber files")
    yield from _other_figures(
        text, r"Coordinates: (\w+) from the board's (\w+ \w+) corner, y (\w+),", ("millimetres", "lower left", "up")
    )
    yield from _other_figures(text, r" format (\S+): (\w+), ([\w-]+), origin (\S[^\n]*)", as_listed)
    yield from _other_figures(text, r"turned -?[\d.]+ deg ([\w-]*clockwise)", ("counter-clockwise",))
    yield from _other_figures(
        text, r"(\d+) parts (\S[^\n]*), all on ([^,\n]+),", (str(of.part_count), in_a_line(assembly.footprint), "top")
    )
    number = f"number {in_a_line(assembly.part_number)}" if assembly.part_number else "no part number is given"
    bought = (in_a_line(assembly.description), number)
    yield from _other_figures(text, r"(?m)^   (\S[^\n]*?); ((?:no part )?number [^\n]*)\.$", bought)
    for boards, parts in re.findall(r"^   parts for (\d{1,9}) \S+ +(\d{1,9})\b", text, re.MULTILINE):
        if int(parts) < int(boards) * of.part_count:
            yield f"they say {parts} parts for {boards} boards of {of.part_count}"


def _expected_rows(
    tape: Tape, of: Ordered, film: FilmManifest, order: FabOrder, text: str, *, legend: bool
) -> dict[tuple[str, ...], str]:
    """Patterns of values by labels of rows, for the forms of all houses; rows that every form has come first."""
    assembly, backings = film.assembly, film.film.backings
    width, height = map(_length, of.shown.size_mm)
    # version 0.1.0 wrote a panel's tapes' radius, and a colour where nothing is printed
    radii = "|".join(map(_length, {tape.board.corner_radius_mm} | ({CORNER_RADIUS_MM} if of.panel else set())))
    copper = COPPER_OZ.get(order.copper_um, f"{order.copper_um:g} um")
    hole = _length(min((hole[2] for hole in of.shown.holes), default=0.0))
    number, any_part = _escaped(assembly.part_number), _escaped(assembly.description)
    choose = "none is given: choose one of the house's, |choose one in the library: |not given; any maker: "
    stiffener, adhesive = (
        f"{re.escape(backings[role])} mm" if role in backings else "none|Without|No"
        for role in ("stiffener-bottom", "adhesive-bottom")
    )
    return {
        ("thickness", "PCB Thickness", "Thickness"): f"{_length(order.thickness_mm)} mm",
        ("size", "Dimensions", "Size (single)", "Size (panel)"): rf"{width} x {height} mm(, corner radius ({radii}) mm)?",
        ("layers", "Layers"): str(order.layers),
        ("copper", "Outer Copper Weight", "Finished Copper"): re.escape(copper),
        ("surface finish", "Surface Finish"): rf"{_escaped(order.finish)}( \(immersion gold\))?",
        ("board", "Base Material", "Material"): _bases(order),
        ("legend", "Silkscreen"): f"(?i:{re.escape(order.legend_colour)})(, top)?" + "|[Nn]one" * (not legend),
        ("coverlay", "Coverlay", "Coverlay Color", "solder mask", "Solder Mask", "PCB Color"): (
            f"(?i:{re.escape(order.coverlay_colour)})(, cut|, photo-imageable, flexible)?"
        ),
        ("stiffener", "Stiffener"): stiffener,
        ("adhesive", "Adhesive Tape", "3M or tesa Tape"): adhesive,
        ("smallest hole", "Min Hole Size"): f"{hole} mm(, unplated)?" if of.shown.holes else "no holes",
        ("panel", "Delivery Format", "Board Type"): _delivery(of.panel, asked=_ASK_FOR_PANEL in text),
        ("stencil",): ".*" if film.stencil_mm is None else f"{_length(film.stencil_mm)} mm",
        ("Comment in the BOM",): _escaped(assembly.value),
        ("Mark on PCB", "Remove Product No."): "Remove Mark|Yes",  # the house's number would be printed on the tag
        ("parts of a board", "Number of SMD Parts"): str(of.part_count),
        ("joints of a board",): str(2 * of.part_count),
        ("side", "Side(s)", "PCBA Side", "Assembly Side"): "[Tt]op( only| side| Side)?",
        ("kinds of part", "Number of Unique Parts"): "1",
        ("smallest part",): any_part,
        ("part number", "JLCPCB Part #", "Mfg Part # in the BOM"): number or f"none given|(?:{choose}){any_part}",
    }


def _escaped(text: str) -> str:
    """Pattern of a profile's text, as written on one line of the notes."""
    return re.escape(in_a_line(text))


def _delivery(panel: Panel | None, *, asked: bool) -> str:
    """Pattern of the form of delivery; `asked` tells whether the remark of step 8 asks the fab for a panel."""
    if panel is not None:
        return f"(as drawn|Panel by Customer), {re.escape(panel.words)}"
    return r"(by the fab|Panel by \w+), as the remark of step 8 says" if asked else r"[Ss]ingle (pieces|PCB)"


def _bases(order: FabOrder) -> str:
    """Pattern of the base material."""
    base, laminate = _escaped(order.base), _escaped(LAMINATES.get(order.base, order.base))
    if not order.flexible:
        return f"rigid, {base}|{laminate}"
    capital = _escaped(order.base[:1].upper() + order.base[1:])
    return f"flexible, {base}|{'Flex' if order.base == 'polyimide' else f'Flex, {base}'}|{capital} flex"


def _length(value: float) -> str:
    """A length or angle as written in the notes."""
    return f"{round(value, 6):.3f}".rstrip("0").rstrip(".")
