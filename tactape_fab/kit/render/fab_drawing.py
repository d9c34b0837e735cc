"""Fab drawing: one page for the people at the fab and at the assembly line, as PDF.

It gives dimensions of the shapes in the Gerber files, and what these do not contain: the layer stack, the area of the texture,
the rotation of the parts, and an enlarged corner to compare with the fab's own preview.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, floor, radians, sin

import numpy as np

from tactape_fab.base.build_date import build_date
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.order_facts import Box, OrderFacts
from tactape_fab.kit.render.pdf_sheet import Sheet, View
from tactape_fab.texture.cpl import PLACEMENTS
from tactape_fab.texture.directions import USUAL_DIRECTIONS
from tactape_fab.texture.frames import FloatArray, texture_to_board
from tactape_fab.texture.shapes import rotate

A4_MM = (297.0, 210.0)
SCALES = (20.0, 10.0, 5.0, 2.5, 2.0, 1.0, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.025, 0.02, 0.01)
"""Recommended scales of ISO 5455, with 2.5:1, 1:2.5, 1:4 and 1:40 in between."""
PREVIEW_POINTS = 4
"""Columns and rows of parts in the enlarged corner."""
_FRAME_MM = 8.0
_OUTLINE_BOX: Box = (27.0, 110.0, 178.0, 183.0)
_CORNER_BOX: Box = (16.0, 15.0, 98.0, 79.0)
_PART_BOX: Box = (112.0, 26.0, 186.0, 76.0)
_TEXT_LEFT_MM, _TEXT_WIDTH_MM = 197.0, 90.0
_MOST_BODIES = 20_000
"""Most bodies that are drawn in the outline; of more, only the field is drawn."""
_SMALL_MM = 2.0
_FIELD_GREY, _COPPER, _BODY, _FILM = 0.94, (0.85, 0.62, 0.35), (0.25, 0.25, 0.28), (0.98, 0.93, 0.80)


def render_fab_drawing(facts: OrderFacts, drawing: Drawing) -> tuple[Artifact]:
    """The drawing of a tape or a panel."""
    sheet = Sheet(A4_MM, f"{drawing.name}: fab drawing")
    sheet.box((_FRAME_MM, _FRAME_MM), (A4_MM[0] - _FRAME_MM, A4_MM[1] - _FRAME_MM), width_mm=0.35)
    sheet.line((192.0, _FRAME_MM), (192.0, A4_MM[1] - _FRAME_MM), 0.25)
    sheet.line((_FRAME_MM, 93.0), (192.0, 93.0), 0.25)
    scale = _outline(sheet, facts, drawing)
    corner_scale = _corner(sheet, facts, drawing)
    _one_part(sheet, facts.fab.mask_name, drawing)
    _texts(sheet, facts, drawing, scale, corner_scale)
    return (Artifact(role="fab-drawing", path=f"{drawing.name}-drawing.pdf", data=sheet.pdf()),)


def _outline(sheet: Sheet, facts: OrderFacts, drawing: Drawing) -> float:
    """Draw the outline with field, legend, holes and dimensions, seen from the parts' side; returns its scale."""
    sheet.text((13.0, 197.0), "OUTLINE, seen from the parts' side", size_mm=3.0, bold=True)
    view = _fitted(drawing.size_mm, _OUTLINE_BOX)
    width, height = drawing.size_mm
    sheet.outlines([view(drawing.outline_mm)], width_mm=0.35, fill=_FILM)
    sheet.outlines([view(slot) for slot in drawing.slots_mm], width_mm=0.18, fill=1.0)
    for number, (field, area) in enumerate(facts.fields_mm, 1):
        sheet.box(view(field[:2]), view(field[2:]), fill=_FIELD_GREY, stroke=0.45, width_mm=0.1, dash=(1.0, 0.6))
        if area is not None:
            sheet.box(view(area[:2]), view(area[2:]), stroke=0.0, width_mm=0.13, dash=(0.5, 0.4))
        if facts.panel is not None:
            middle = ((field[0] + field[2]) / 2, (field[1] + field[3]) / 2)
            sheet.text(view(middle), str(number), size_mm=3.5, bold=True, align="middle")
    if len(drawing.parts_xy_mm) <= _MOST_BODIES and facts.panel is None:
        # one outline at n places, shape (n, k, 2), drawn as one path
        sheet.outlines(view(drawing.parts[0].bodies.outline_mm + drawing.parts_xy_mm[:, None]), fill=_BODY, stroke=None)
    sheet.outlines([view(area) for area in drawing.legend.areas_mm], fill=0.15, stroke=None)
    sheet.strokes([view(stroke) for stroke in drawing.legend.strokes_mm], drawing.legend.line_mm * view.scale)
    for x, y, diameter in drawing.holes:
        sheet.circle(view((x, y)), diameter / 2 * view.scale, fill=1.0)
    if drawing.fiducials is not None:
        for xy in drawing.fiducials.xy_mm:
            sheet.circle(view(xy), drawing.fiducials.copper_mm / 2 * view.scale, fill=_COPPER)
    low, high = view((0.0, 0.0)), view((width, height))
    sheet.dimension(low, np.array([high[0], low[1]]), f"{width:g}", away_mm=-7.0)
    sheet.dimension(low, np.array([low[0], high[1]]), f"{height:g}", away_mm=7.0)
    if facts.panel is None:
        left, top = facts.field_mm[0], facts.field_mm[3]
        sheet.dimension(
            np.array([low[0], high[1]]), np.array([view((left, 0.0))[0], high[1]]), f"{left:g}", away_mm=5.0, size_mm=_SMALL_MM
        )
        start, end = view((left, top)), view((facts.field_mm[2], top))
        sheet.dimension(
            np.array([start[0], high[1]]),
            np.array([end[0], high[1]]),
            f"field {facts.field_mm[2] - left:g}",
            away_mm=10.0,
            size_mm=_SMALL_MM,
        )
        _corner_mark(sheet, facts, view)
    if drawing.corner_radius_mm > 0:
        sheet.text((high[0] + 1.0, high[1] - 1.0), f"radius {drawing.corner_radius_mm:g} (4x)", size_mm=_SMALL_MM)
    sheet.text(
        (13.0, 97.0),
        "Grey: the field of parts. Nothing may be added there."
        + " Short dashes: where a number may be printed." * (facts.panel is None and facts.number_mm is not None),
        size_mm=_SMALL_MM,
    )
    return view.scale


def _corner_mark(sheet: Sheet, facts: OrderFacts, view: View) -> None:
    """Draw a frame around the area of the enlarged corner."""
    low, high = _corner_area(facts)
    sheet.box(view(low), view(high), width_mm=0.25, stroke=(0.75, 0.0, 0.0))
    sheet.text(view((high[0], low[1])) + np.array([0.8, -0.4]), "A", size_mm=3.0, bold=True)


def _corner(sheet: Sheet, facts: OrderFacts, drawing: Drawing) -> float:
    """Draw the first parts on their grid, enlarged: openings, pads, bodies and designators; returns its scale."""
    low, high = _corner_area(facts)
    view = _fitted(tuple(high - low), _CORNER_BOX, origin_mm=tuple(low), exact=True)
    sheet.text((13.0, 88.0), f"A: the first parts, {view.scale:.3g}:1", size_mm=3.0, bold=True)
    first = drawing.parts[0]
    parts = np.flatnonzero(np.all((first.xy_mm > low) & (first.xy_mm < high), axis=1))
    sheet.box(view(low), view(high), fill=_FILM, stroke=0.5, width_mm=0.13)
    _grid(sheet, facts, low, high, view)
    centres = first.xy_mm[parts]
    if first.openings is not None:
        sheet.outlines(view(first.openings.outline_mm + centres[:, None]), stroke=0.3, width_mm=0.1)
    lands = first.pads.xy_mm.reshape(-1, 2, 2)[parts]
    sheet.outlines(view(first.pads.outline_mm + lands.reshape(-1, 1, 2)), fill=_COPPER, stroke=None)
    sheet.outlines(view(first.bodies.outline_mm + centres[:, None]), fill=_BODY, stroke=None)
    # beside the long side of the part: half an opening and 2 mm of paper away
    across = rotate([(0.0, -1.0)], first.rotation_deg)[0] * (0.5 * drawing.outlines.opening_size_mm[1] * view.scale + 2.0)
    for part, centre, (land, _) in zip(parts, centres, lands, strict=True):
        # from the land's middle outward along the part, past the body
        sheet.circle(view(land + 0.3 * (land - centre)), 0.45, fill=1.0, width_mm=0.1)
        sheet.text(view(centre) + across, f"R{part + 1}", size_mm=1.8, align="middle")
    ways = "N, S, E or W" if facts.tape.directions == USUAL_DIRECTIONS else f"in one of {facts.tape.directions} directions"
    words = f"Circle: land 1. Each part stands {facts.tape.displacement_mm:.4g} {ways} of its grid point: do not align them."
    sheet.text((13.0, 11.5), words, size_mm=_SMALL_MM)
    return view.scale


def _grid(sheet: Sheet, facts: OrderFacts, low: FloatArray, high: FloatArray, view: View) -> None:
    """Draw the grid lines in view, with the pitch."""
    size = min(PREVIEW_POINTS, facts.tape.columns), min(PREVIEW_POINTS, facts.tape.rows)
    # on a turned tape the rows are arranged along x
    turned = facts.panel is not None and facts.panel.tapes[0].turned
    points = [_grid_point(facts, *((0, k) if turned else (k, 0))) for k in range(size[turned])]
    for x, _ in points:
        sheet.line(view((x, low[1])), view((x, high[1])), 0.1, stroke=0.55)
    for _, y in (_grid_point(facts, *((k, 0) if turned else (0, k))) for k in range(size[not turned])):
        sheet.line(view((low[0], y)), view((high[0], y)), 0.1, stroke=0.55)
    start, end = sorted((view((point[0], high[1])) for point in points[:2]), key=lambda xy: float(xy[0]))
    sheet.dimension(start, end, f"W {facts.tape.pitch_mm:.4g}", away_mm=3.0, size_mm=_SMALL_MM)


def _corner_area(facts: OrderFacts) -> tuple[FloatArray, FloatArray]:
    """The lower left and upper right corner of the board's area with the first grid points, mm."""
    # 0.65 of a pitch beyond the outermost points: room for displacement and body
    last = min(PREVIEW_POINTS, facts.tape.columns) - 0.35, min(PREVIEW_POINTS, facts.tape.rows) - 0.35
    ends = np.stack([_grid_point(facts, -0.65, last[1]), _grid_point(facts, last[0], -0.65)])
    return ends.min(axis=0), ends.max(axis=0)


def _grid_point(facts: OrderFacts, column: float, row: float) -> FloatArray:
    """A point of the (first) tape's grid, given by column and row, in the drawing's frame, mm."""
    tape = facts.tape
    x, y = texture_to_board(np.array([column, row]) * tape.pitch_mm, tape.board.texture_origin_mm)
    if facts.panel is None:
        return np.array([x, y])
    first = facts.panel.tapes[0]
    # R_ccw(90 deg) of the board, as on the panel
    return np.asarray(np.array([-y, x] if first.turned else [x, y]) + np.array(first.offset_mm))


def _one_part(sheet: Sheet, mask: str, drawing: Drawing) -> None:
    """Draw one part with its pads, opening and angle."""
    sheet.text((104.0, 88.0), "B: one part", size_mm=3.0, bold=True)
    lines, rotation_deg = drawing.outlines, drawing.parts[0].rotation_deg
    low, high = lines.opening.min(axis=0), lines.opening.max(axis=0)
    size = tuple(high - low)
    view = _fitted(size, _PART_BOX, origin_mm=tuple(low), exact=True, fill=0.75)
    if drawing.parts[0].openings is not None:
        sheet.outlines([view(lines.opening)], fill=1.0, stroke=0.3, dash=(1.2, 0.7))
    sheet.outlines([view(lines.pad + xy) for xy in lines.pad_xy], fill=_COPPER, stroke=None)
    sheet.outlines([view(lines.body)], stroke=0.0, width_mm=0.25)
    angle = radians(rotation_deg)
    centre = view((0.0, 0.0))
    axis = np.array([cos(angle), sin(angle)])
    reach = 0.5 * view.scale * lines.opening_size_mm[0] + 6.0
    sheet.line(centre - axis * 4.0, centre + axis * reach, 0.1, dash=(3.0, 0.6, 0.5, 0.6))
    sheet.line(centre, centre + np.array([reach, 0.0]), 0.1, dash=(3.0, 0.6, 0.5, 0.6))
    _angle(sheet, centre, reach * 0.8, angle)
    sheet.circle(view(lines.pad_xy[0]), 1.2, fill=1.0, width_mm=0.13)
    sheet.text(view(lines.pad_xy[0]), "1", size_mm=1.7, align="middle")
    long_side = rotate(
        [
            (-0.5 * drawing.part.body_mm[0], -0.5 * drawing.part.body_mm[1]),
            (0.5 * drawing.part.body_mm[0], -0.5 * drawing.part.body_mm[1]),
        ],
        rotation_deg,
    )
    sheet.dimension(
        view(long_side[0]),
        view(long_side[1]),
        f"{drawing.part.body_mm[0]:g}",
        away_mm=-0.5 * view.scale * lines.opening_size_mm[1] - 2.5,
        size_mm=_SMALL_MM,
    )
    pads, (long_mm, wide_mm) = drawing.part.pads, lines.opening_size_mm
    openings = (
        f"one window in the {mask} for all parts"
        if drawing.parts[0].openings is None
        else f"{mask} opening {long_mm:g} x {wide_mm:g}"
    )
    words = [
        f"Body {' x '.join(f'{side:g}' for side in drawing.part.body_mm)}; {openings};",
        f"lands {pads.size_mm[0]:g} x {pads.size_mm[1]:g}, centres at ±{pads.offset_mm:g} from the part's.",
        _turned(sorted({parts.rotation_deg for parts in drawing.parts})),
    ]
    sheet.lines_of_text((104.0, 22.0), words, size_mm=_SMALL_MM, width_mm=86.0)


def _turned(rotations_deg: Sequence[float]) -> str:
    """Text for the rotation of the parts, with that on turned tapes of a packed panel."""
    all_parts = "All parts" if len(rotations_deg) == 1 else "Parts, tape by tape,"
    return f"{all_parts} turned {' or '.join(f'{rotation_deg:g}°' for rotation_deg in rotations_deg)} counter-clockwise."


def _angle(sheet: Sheet, centre: FloatArray, radius_mm: float, angle_rad: float) -> None:
    """Draw an arc from x to `angle_rad`, with an arrowhead and the angle in degrees."""
    if angle_rad <= 0.0:
        return
    steps = np.linspace(0.0, angle_rad, 25)
    arc = centre + radius_mm * np.stack([np.cos(steps), np.sin(steps)], axis=1)
    sheet.strokes([arc], 0.1)
    # the tangent of the circle at the end of the arc: (-sin, cos)
    sheet.arrow(arc[-1], atan2(cos(angle_rad), -sin(angle_rad)))
    middle = centre + (radius_mm + 3.0) * np.array([cos(angle_rad / 2), sin(angle_rad / 2)])
    sheet.text(middle, f"{np.degrees(angle_rad):g}°", align="middle")


def _texts(sheet: Sheet, facts: OrderFacts, drawing: Drawing, scale: float, corner_scale: float) -> None:
    """Draw the column of tables and notes, and the title block."""
    x, y = _TEXT_LEFT_MM, 197.0
    sheet.text((x, y), "LAYERS, from the top", size_mm=3.0, bold=True)
    y = sheet.table((x, y - 3.0), _layers(facts, drawing), (27.0, _TEXT_WIDTH_MM - 27.0), size_mm=_SMALL_MM) - 5.0
    y = _section(sheet, facts.fab.mask_name, drawing, (x + 6.0, y)) - 6.0
    if drawing.holes:
        sheet.text((x, y), "HOLES, not plated (mm from the lower left corner)", size_mm=3.0, bold=True)
        y = sheet.table((x, y - 3.0), _holes(drawing), (_TEXT_WIDTH_MM / 3,) * 3, size_mm=_SMALL_MM) - 5.0
    sheet.text((x, y), "NOTES", size_mm=3.0, bold=True)
    sheet.lines_of_text((x, y - 4.5), _notes(facts), size_mm=_SMALL_MM, width_mm=_TEXT_WIDTH_MM)
    rows = [
        ("Title", drawing.name),
        ("Texture", _texture(facts)),
        ("Fab profile", f"{facts.fab.name}; assembly format {facts.fab.assembly}"),
        ("Scale", f"outline {_ratio(scale)}, A {corner_scale:.3g}:1; all dimensions in mm"),
        ("Date, tool", f"{build_date():%Y-%m-%d}, tactape-fab {__version__}; sheet 1 of 1, A4"),
    ]
    sheet.table((x, 11.0 + 5.0 * len(rows)), rows, (20.0, _TEXT_WIDTH_MM - 20.0), size_mm=_SMALL_MM)


def _section(sheet: Sheet, mask: str, drawing: Drawing, top_left: tuple[float, float]) -> float:
    """Draw a cross-section through a part, not to scale; returns its lower edge on the sheet, mm."""
    width, left = 60.0, top_left[0]
    middle, y = left + width / 2, top_left[1] - 9.0
    film_top = y
    sheet.box((left, y - 2.5), (left + width, y), fill=(0.93, 0.78, 0.45), width_mm=0.1)  # base
    for side in (-1, 1):
        near, far = sorted((middle + side * 3.0, middle + side * 10.0))
        sheet.box((near, y), (far, y + 1.2), fill=_COPPER, width_mm=0.1)
        sheet.box(
            (near + (1.5 if side > 0 else 0.5), y + 1.2), (far - (0.5 if side > 0 else 1.5), y + 1.9), fill=0.7, width_mm=0.1
        )  # solder
        cover = sorted((middle + side * 13.0, middle + side * width / 2))
        sheet.box((cover[0], y), (cover[1], y + 2.0), fill=(0.98, 0.88, 0.6), width_mm=0.1)
    sheet.box((middle - 7.5, y + 1.9), (middle + 7.5, y + 6.5), fill=_BODY, stroke=None)
    y -= 2.5
    # the adhesive is outermost, as it sticks the tape to an object
    for words, fill in ((drawing.stiffener, 0.6), (drawing.adhesive, 0.85)):
        if words:
            sheet.box((left, y - 2.2), (left + width, y), fill=fill, width_mm=0.1)
            sheet.text((left + width + 1.5, y - 1.1), "adhesive" if fill > 0.8 else "stiffener", size_mm=1.8)
            y -= 2.2
    for words, height in (("part", 5.2), (mask, 1.2), ("base", -1.3)):
        at = (left + width + 1.5, film_top + height)
        sheet.text(at, words, size_mm=1.8)
    sheet.line((middle + 7.5, film_top + 5.2), (left + width + 1.0, film_top + 5.2), 0.08)
    return y


def _layers(facts: OrderFacts, drawing: Drawing) -> list[tuple[str, str]]:
    fab, (long_mm, wide_mm) = facts.fab, facts.opening_mm
    openings = (
        "one opening for all parts"
        if facts.coverlays == ["gang"]
        else "opened for all parts of a tape, or for each part: as drawn"
        if "gang" in facts.coverlays
        else f"{len(drawing.parts_xy_mm)} openings of {long_mm:g} x {wide_mm:g}, never merged"
    )
    material = fab.material
    rows = [
        ("parts", f"{facts.part_count} x {facts.part.footprint or facts.part.name}, height {facts.part.body_mm[2]:g}"),
        (
            "legend",
            f"{fab.legend_colour}, lines of {fab.legend.line_mm:g} or more"
            if drawing.legend.areas_mm or drawing.legend.strokes_mm
            else "none",
        ),
        (fab.mask_name, f"{fab.coverlay_colour}; {openings}"),
        ("copper", f"{material.copper_um:g} µm, one layer, {material.finish}; least spacing {facts.least_gap_mm:.3g}"),
        ("base", f"{material.base}; film {drawing.thickness_mm:g} thick in all"),
    ]
    # rails and tabs of a panel have no backing, as its layers show
    where = "whole underside" if facts.panel is None else "under the tapes alone"
    rows.append(("stiffener", f"{drawing.stiffener} mm, {where}" if drawing.stiffener else "none"))
    under = " under the stiffener" if drawing.stiffener else f", {where}"
    return [*rows, *([("adhesive", f"{drawing.adhesive} mm{under}")] if drawing.adhesive else [])]


def _holes(drawing: Drawing, most: int = 8) -> list[tuple[str, str, str]]:
    rows = [(f"Ø {diameter:g}", f"x {x:.3f}", f"y {y:.3f}") for x, y, diameter in drawing.holes[:most]]
    more = len(drawing.holes) - most
    return [*rows, (f"and {more} more", "in the drill file", "")] if more > 0 else rows


def _notes(facts: OrderFacts) -> list[str]:
    clockwise = "clockwise" if PLACEMENTS[facts.fab.assembly].clockwise else "counter-clockwise"
    leans = f" Seen from above, every part leans like this: {facts.slash}"
    leans += f" or, on turned tapes, {facts.turned_slash}" if facts.turned else ""
    if facts.part.body_mm[0] == facts.part.body_mm[1]:
        leans = ""
    mask = facts.fab.mask_name
    merged = f"Openings of the {mask} are not merged. Ask before a bridge between two of them is changed."
    opened = f"The {mask} has one opening for all parts, on purpose." if facts.coverlays == ["gang"] else merged
    if len(facts.coverlays) > 1:
        opened = f"The {mask} differs from tape to tape, on purpose. {merged}"
    alone = "Pads stand alone on purpose."
    if facts.anchors != "none":
        some = "some" if facts.panel is not None and facts.panel.loose else "the"
        alone = f"Copper runs on from {some} pads under the {mask} to hold them: it is no track."
    number = "only within the short dashes, better none" if facts.number_mm else "none on the tape"
    if facts.panel is not None:
        number = "only in the rails, better none"
    return [
        "1. The Gerber and drill files rule; this drawing explains them.",
        f"2. Rotations in the placement file are {clockwise}, 0 is along x.{leans}",
        f"3. The parts carry no signal: no nets, no electrical test. {alone} Either land may be land 1.",
        f"4. Order numbers and date codes: {number}. In the field no logo, fiducial, hole, coupon or copper.",
        f"5. {opened}",
        "6. Outline and holes: the fab's own tolerances. Parts: as near to their place as the line can. "
        "A missing, standing or turned part is a fault.",
    ]


def _texture(facts: OrderFacts) -> str:
    tape = facts.tape
    grid = f"W {facts.pitch_words}, Δ {facts.displacement_words}"
    if facts.panel is not None:
        return f"{facts.panel.words}; {grid}"
    return f"sector {tape.sector} of {tape.code}; {tape.columns} x {tape.rows} points, {grid}"


def _ratio(scale: float) -> str:
    return f"{scale:g}:1" if scale >= 1.0 else f"1:{1.0 / scale:g}"


def _fitted(
    size_mm: Sequence[float], box: Box, *, origin_mm: Sequence[float] = (0.0, 0.0), exact: bool = False, fill: float = 1.0
) -> View:
    """A view that centres `size_mm` in a box of the sheet, at the largest recommended scale or, if `exact`, at the largest."""
    room = (box[2] - box[0], box[3] - box[1])
    largest = fill * min(room[0] / size_mm[0], room[1] / size_mm[1])
    fitting: Sequence[float] = [scale for scale in SCALES if scale <= largest]
    # an exact scale has one decimal
    scale = floor(largest * 10) / 10 if exact else max(fitting, default=largest)
    at = (box[0] + (room[0] - scale * size_mm[0]) / 2, box[1] + (room[1] - scale * size_mm[1]) / 2)
    return View(scale=float(scale), at_mm=at, origin_mm=(float(origin_mm[0]), float(origin_mm[1])))
