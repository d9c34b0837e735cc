"""A KiCad board (.kicad_pcb, s-expression format 20211014 of KiCad 6) and its project with the fab's limits as design rules.

It is for viewing, reviewing and extending the tape; the Gerber files are what is ordered. KiCad's y points down: the board's
lower-left corner is KiCad's auxiliary origin, the origin of its plots and placement files.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import chain, islice, pairwise
from math import isclose, sqrt

import numpy as np

from tactape_fab.base.build_date import build_date
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import Artifact, LongArtifact
from tactape_fab.kit.film.drawing import Drawing, Parts
from tactape_fab.kit.profiles import FabProfile, LandPattern
from tactape_fab.texture.frames import FloatArray

SHEET_MARGIN_MM = 20.0
_PIECE_LINES = 1000
_EDGE_LINE_MM = 0.05
_FAB_LINE_MM = 0.05
_COURTYARD_LINE_MM = 0.05
_LAYERS = """  (layers
    (0 "F.Cu" signal)
    (31 "B.Cu" signal)
    (34 "B.Paste" user)
    (35 "F.Paste" user)
    (36 "B.SilkS" user "B.Silkscreen")
    (37 "F.SilkS" user "F.Silkscreen")
    (38 "B.Mask" user)
    (39 "F.Mask" user)
    (41 "Cmts.User" user "User.Comments")
    (44 "Edge.Cuts" user)
    (45 "Margin" user)
    (46 "B.CrtYd" user "B.Courtyard")
    (47 "F.CrtYd" user "F.Courtyard")
    (48 "B.Fab" user)
    (49 "F.Fab" user)
  )"""


def render_kicad(drawing: Drawing, fab: FabProfile) -> tuple[LongArtifact, Artifact]:
    """The board and its project, which KiCad opens together."""
    name = drawing.name
    project = json.dumps(_project(name, fab, drawing), indent=1) + "\n"
    return (
        LongArtifact(role="kicad-pcb", path=f"kicad/{name}.kicad_pcb", pieces=partial(_board, drawing)),
        Artifact(role="kicad-project", path=f"kicad/{name}.kicad_pro", data=project.encode("ascii")),
    )


def _board(drawing: Drawing) -> Iterator[bytes]:
    pieces = (_head, _footprints, _marks, _holes, _drawings, _copper)
    lines = chain(*(piece(drawing) for piece in pieces), [")"])
    # in pieces of a thousand lines, so that a board of 200,000 parts is never in memory as a whole
    while some := list(islice(lines, _PIECE_LINES)):
        yield "\n".join([*some, ""]).encode("utf-8")


def origin_mm(drawing: Drawing) -> tuple[float, float]:
    """Place of the board's lower-left corner on KiCad's sheet (y down), mm."""
    return SHEET_MARGIN_MM, SHEET_MARGIN_MM + drawing.size_mm[1]


def _sheet(drawing: Drawing, xy_mm: FloatArray) -> FloatArray:
    """Board frame -> KiCad's sheet."""
    return np.asarray(xy_mm) * (1.0, -1.0) + origin_mm(drawing)


def _text(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _for_format(text: str) -> str:
    return text.replace("%", "%%")


def _number(value: float) -> str:
    return f"{value:.6f}".rstrip("0").rstrip(".")


def _points(drawing: Drawing, xy_mm: FloatArray) -> str:
    return " ".join(f"(xy {x:.6f} {y:.6f})" for x, y in _sheet(drawing, xy_mm).tolist())


def _head(drawing: Drawing) -> list[str]:
    width_mm, height_mm = (side + 2 * SHEET_MARGIN_MM for side in drawing.size_mm)
    x_mm, y_mm = origin_mm(drawing)
    return [
        "(kicad_pcb (version 20211014) (generator tactape-fab)",
        f"  (general (thickness {_number(drawing.thickness_mm)}))",
        f'  (paper "User" {_number(width_mm)} {_number(height_mm)})',
        f"  (title_block (title {_text(drawing.name)}) (date {_text(f'{build_date():%Y-%m-%d}')}) (rev {_text(__version__)}))",
        _LAYERS,
        f"  (setup (pad_to_mask_clearance 0) (aux_axis_origin {_number(x_mm)} {_number(y_mm)}) "
        f"(grid_origin {_number(x_mm)} {_number(y_mm)}))",
        '  (net 0 "")',
    ]


# Parts


def _footprints(drawing: Drawing) -> Iterator[str]:
    """A footprint for each part, in designator order, with the shapes of the unrotated part about its centre."""
    first = 1
    for parts in drawing.parts:
        template = _footprint(drawing, parts)
        at = _sheet(drawing, parts.xy_mm).tolist()
        for n, (x, y) in enumerate(at, start=first):
            yield template % (n, x, y, n)
        first += len(at)


def _footprint(drawing: Drawing, parts: Parts) -> str:
    """Text of a part's footprint in %-format; its arguments are the part's number, its place, and its number again.

    It is repeated for every part. Items that KiCad fills in itself (identifiers of shapes, a font of the hidden
    value) or that the library has (the description) are left out, as they would more than double the file.
    """
    part, turn = drawing.part, _number(parts.rotation_deg)
    body, courtyard = part.body_mm, part.courtyard_mm
    lines = [
        # KiCad needs an identifier for each footprint: the part's number in hexadecimal, so that the file is reproducible
        f'  (footprint {_text(_for_format(f"tactape:{part.footprint}"))} (layer "F.Cu") (tstamp 00000000-0000-4000-8000-%011x0)',
        f"    (at %.10g %.10g {turn}) (attr smd)",
        _hidden_text("reference", "R%d", turn),
        _hidden_text("value", _for_format(part.value), turn),
        _rectangle(body[:2], "F.Fab", _FAB_LINE_MM, "none"),
        _rectangle(courtyard, "F.CrtYd", _COURTYARD_LINE_MM, "none"),
        *(_pad(number, "F.Cu", part.pads, turn, k) for k, number in enumerate("12")),
        # paste as separate pads without number, as its apertures have other sizes and places than the lands
        *(_pad("", "F.Paste", part.paste, turn, k) for k in range(2)),
    ]
    if parts.openings is not None:
        # the mask opening as a rectangle: one for both pads, which a mask margin of the pads cannot express
        lines.append(_rectangle(drawing.outlines.opening_size_mm, "F.Mask", 0.0, "solid"))
    return "\n".join([*lines, "  )"])


def _hidden_text(kind: str, text: str, turn: str) -> str:
    font = " (effects (font (size 0.2 0.2) (thickness 0.03)))" if kind == "reference" else ""
    return f'    (fp_text {kind} {_text(text)} (at 0 0 {turn}) (layer "F.Fab") hide{font})'


def _rectangle(size_mm: tuple[float, float], layer: str, line_mm: float, fill: str) -> str:
    x, y = _number(size_mm[0] / 2), _number(size_mm[1] / 2)
    line = f"(width {_number(line_mm)}) (fill {fill})"
    return f"    (fp_rect (start -{x} -{y}) (end {x} {y}) (layer {_text(layer)}) {line})"


def _pad(number: str, layer: str, land: LandPattern, turn: str, k: int) -> str:
    x = -land.offset_mm if k == 0 else land.offset_mm
    # the corner's radius over the shorter side
    ratio = land.corner_radius_mm / min(land.size_mm)
    # KiCad stores a pad's angle relative to the board, its place relative to the footprint
    shape = f"roundrect (at {_number(x)} 0 {turn})" if ratio > 0 else f"rect (at {_number(x)} 0 {turn})"
    corner = f" (roundrect_rratio {_number(ratio)})" if ratio > 0 else ""
    size = " ".join(_number(side) for side in land.size_mm)
    return f"    (pad {_text(number)} smd {shape} (size {size}) (layers {_text(layer)}){corner})"


def _holes(drawing: Drawing) -> Iterable[str]:
    lines = [
        '  (footprint "tactape:Hole" (layer "F.Cu") (tstamp {stamp:s}0)',
        "    (at {x:.6f} {y:.6f})",
        "    (attr exclude_from_pos_files exclude_from_bom)",
        _hidden_text("reference", "H{n:d}", "0"),
        _hidden_text("value", "{size:s}", "0"),
        '    (pad "" np_thru_hole circle (at 0 0) (size {size:s} {size:s}) (drill {size:s})',
        "      (layers *.Cu *.Mask))",
        "  )",
    ]
    for n, (x_mm, y_mm, diameter_mm) in enumerate(drawing.holes, start=1):
        x, y = _sheet(drawing, np.array([x_mm, y_mm])).tolist()
        yield "\n".join(lines).format(n=n, x=x, y=y, size=_number(diameter_mm), stamp=f"00000000-0000-4000-8001-{n:011x}")


def _marks(drawing: Drawing) -> Iterable[str]:
    """Fiducials of the rails: bare copper in a wider mask opening."""
    if drawing.fiducials is None:
        return
    # the mask margin, which is also the clearance, as no other copper may be in the opening
    margin = _number((drawing.fiducials.opening_mm - drawing.fiducials.copper_mm) / 2)
    lines = [
        '  (footprint "tactape:Fiducial" (layer "F.Cu") (tstamp {stamp:s}0)',
        "    (at {x:.6f} {y:.6f})",
        "    (attr smd exclude_from_pos_files exclude_from_bom)",
        _hidden_text("reference", "FID{n:d}", "0"),
        _hidden_text("value", "Fiducial", "0"),
        '    (pad "" smd circle (at 0 0) (size {size:s} {size:s}) (layers "F.Cu" "F.Mask")',
        "      (solder_mask_margin {margin:s}) (clearance {margin:s}))",
        "  )",
    ]
    size = _number(drawing.fiducials.copper_mm)
    for n, (x, y) in enumerate(_sheet(drawing, drawing.fiducials.xy_mm).tolist(), start=1):
        stamp = f"00000000-0000-4000-8002-{n:011x}"
        yield "\n".join(lines).format(n=n, x=x, y=y, size=size, margin=margin, stamp=stamp)


# Graphics of the board


def _drawings(drawing: Drawing) -> Iterable[str]:
    yield from _edges(drawing)
    for area in drawing.legend.areas_mm:
        yield f'  (gr_poly (pts {_points(drawing, area)}) (layer "F.SilkS") (width 0) (fill solid))'
    for stroke in drawing.legend.strokes_mm:
        for (a, b), (c, d) in pairwise(_sheet(drawing, stroke).tolist()):
            line = _number(drawing.legend.line_mm)
            yield f'  (gr_line (start {a:.6f} {b:.6f}) (end {c:.6f} {d:.6f}) (layer "F.SilkS") (width {line}))'
    for window in drawing.windows_mm:
        yield f'  (gr_poly (pts {_points(drawing, window)}) (layer "F.Mask") (width 0) (fill solid))'
    under = "each tape" if drawing.slots_mm else "it"
    both = (("stiffener", drawing.stiffener), ("adhesive", drawing.adhesive))
    backings = [f"{what} under all of {under}: {of}" for what, of in both if of]
    for k, words in enumerate(backings):
        x, y = _sheet(drawing, np.array([0.0, -3.0 - 2.0 * k])).tolist()
        yield (
            f'  (gr_text {_text(words)} (at {x:.6f} {y:.6f}) (layer "Cmts.User")'
            " (effects (font (size 1 1) (thickness 0.15)) (justify left)))"
        )


def _edges(drawing: Drawing) -> Iterable[str]:
    """The outline as lines and true arcs, and the slots as lines."""
    (width, height), r = drawing.size_mm, drawing.corner_radius_mm
    # the middle of a quarter circle is r (1 - sqrt(1/2)) from the corner along both axes
    middle = r * (1.0 - sqrt(0.5))
    starts = [(r, 0.0), (width, r), (width - r, height), (0.0, height - r)]
    ends = [(width - r, 0.0), (width, height - r), (r, height), (0.0, r)]
    middles = [(width - middle, middle), (width - middle, height - middle), (middle, height - middle), (middle, middle)]
    end = f'(layer "Edge.Cuts") (width {_number(_EDGE_LINE_MM)}))'
    # KiCad 6 defines an arc by start, middle and end; each side is followed by its corner, counter-clockwise
    for k in range(4):
        (a, b), (c, d), (e, f), (g, h) = _sheet(drawing, np.array([starts[k], ends[k], middles[k], starts[(k + 1) % 4]])).tolist()
        if abs(c - a) + abs(d - b) > 1e-6:  # a full-radius end has no side
            yield f"  (gr_line (start {a:.6f} {b:.6f}) (end {c:.6f} {d:.6f}) {end}"
        if not isclose(r, 0.0):
            yield f"  (gr_arc (start {c:.6f} {d:.6f}) (mid {e:.6f} {f:.6f}) (end {g:.6f} {h:.6f}) {end}"
    for slot in drawing.slots_mm:
        for (a, b), (c, d) in pairwise(_sheet(drawing, np.concatenate([slot, slot[:1]])).tolist()):
            yield f"  (gr_line (start {a:.6f} {b:.6f}) (end {c:.6f} {d:.6f}) {end}"


def _copper(drawing: Drawing) -> Iterable[str]:
    if drawing.anchors is None:
        return
    web = _number(drawing.anchors.web_mm)
    for a, b, c, d in _sheet(drawing, drawing.anchors.lines_mm).reshape(-1, 4).tolist():
        yield f'  (segment (start {a:.6f} {b:.6f}) (end {c:.6f} {d:.6f}) (width {web}) (layer "F.Cu") (net 0))'


# The project


def _project(name: str, fab: FabProfile, drawing: Drawing) -> dict[str, object]:
    """The fab's limits as KiCad's design rules (KiCad 6, board.design_settings.rules and net_settings)."""

    def limit(rule: str) -> float:
        return fab.limits[rule].value_mm

    gap_mm = limit("pad-pad")
    track_mm = drawing.anchors.web_mm if drawing.anchors is not None else gap_mm
    return {
        "board": {
            "design_settings": {
                "rules": {
                    "min_clearance": gap_mm,
                    "min_copper_edge_clearance": limit("pad-edge"),
                    "min_hole_clearance": limit("hole-copper"),
                    "min_hole_to_hole": limit("hole-hole"),
                    "min_through_hole_diameter": limit("hole-size"),
                    "min_silk_clearance": 0.0,
                    "min_track_width": track_mm,
                },
                "rule_severities": {} if drawing.anchors is None else {"track_dangling": "ignore"},  # spurs end in the open
            }
        },
        "meta": {"filename": f"{name}.kicad_pro", "version": 1},
        "net_settings": {
            "classes": [
                {
                    "clearance": gap_mm,
                    "name": "Default",
                    "nets": [],
                    "track_width": track_mm,
                    "via_diameter": 0.6,
                    "via_drill": 0.3,
                }
            ],
            "meta": {"version": 2},
        },
    }
