"""Placement preview: the first parts enlarged with pads, body, rotation and land 1, to compare with the fab's own viewer.

It is drawn from the bytes of copper, coverlay, component layer and pick-and-place list, as in that viewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from tactape_fab.kit.artifact import AnyArtifact, Artifact
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.read.gerber_file import GerberShapes
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.kit.read.written_gerber import first_body_mm, read_shapes
from tactape_fab.kit.render.colours import BASE_FILM, BODY, COVERLAY_COLOURS, GOLD, TERMINAL
from tactape_fab.texture.frames import FloatArray, board_to_texture
from tactape_fab.texture.shapes import rotate

SHOWN_PITCHES = 3.6
"""Side of the view, as a multiple of the distance to the nearest part: three or four parts along each axis."""
_UNITS_PER_MM = 100.0
"""SVG units per mm: fonts smaller than one unit are drawn badly."""
_BESIDE_MM = 1.0
_TEXT_MM, _MARK_MM = 0.17, 0.07
_TERMINAL_SHARE = 0.2
_INK, _MARK = "#1a1a1a", "#c00000"


def render_placement_preview(artifacts: Sequence[AnyArtifact], fab: FabProfile) -> tuple[Artifact]:
    """The picture of a tape or a panel, from the rendered files."""
    files = {artifact.role: artifact.data for artifact in artifacts if isinstance(artifact, Artifact)}
    cpl = read_cpl(files["cpl"])
    copper, coverlay = read_shapes(files["copper-top"]), read_shapes(files["coverlay-top"])
    # the distance to the nearest part gives the scale, as the files do not contain the pitch; a single part is shown 2 mm wide
    away = np.hypot(*(cpl.xy_mm - cpl.xy_mm[0]).T)
    pitch_mm = float(away[away > 0.0].min(initial=np.inf)) if len(away) > 1 else 2.0
    side_mm = SHOWN_PITCHES * min(pitch_mm, 20.0)
    # the first part is the upper left one, on a turned tape the lower left one: the view extends three quarters of a pitch beyond
    # it to the left, and above or below
    around = cpl.xy_mm - cpl.xy_mm[0]
    rises = around[(np.abs(around) < side_mm).all(axis=1), 1].sum() > 0.0
    low = cpl.xy_mm[0] + np.array([-0.75 * pitch_mm, -0.75 * pitch_mm if rises else 0.75 * pitch_mm - side_mm])
    high = low + side_mm
    # a part whose centre is slightly outside may extend into the view
    shown = np.flatnonzero(((cpl.xy_mm > low - _BESIDE_MM) & (cpl.xy_mm < high + _BESIDE_MM)).all(axis=1))
    body = np.array(first_body_mm(files["components-top"]))
    film, _ = COVERLAY_COLOURS[fab.coverlay_colour]
    lines = [_area(np.array([low, (high[0], low[1]), high, (low[0], high[1])]), film)]
    lines += [_line(stroke, GOLD, width) for stroke, width in _near_lines(copper, low, high)]
    lines += [_area(area, BASE_FILM, opacity=0.75) for area in coverlay.areas_mm]
    lines += [_area(shape, BASE_FILM, opacity=0.75) for shape in _near(coverlay, low, high)]
    lines += [_area(shape, GOLD) for shape in _near(copper, low, high)]
    for part in shown:
        lines += _part(cpl.xy_mm[part], float(cpl.rotation_deg[part]), cpl.designators[part], body)
    first = shown[0]
    lines += _angle(cpl.xy_mm[first], float(cpl.rotation_deg[first]) % 360.0, body)
    text = "\n".join([_head(low, side_mm, cpl.designators[first]), *lines, "</svg>", ""])
    name = next(a.path for a in artifacts if a.role == "kicad-pcb").rsplit("/", 1)[-1].removesuffix(".kicad_pcb")
    return (Artifact(role="placement-preview", path=f"preview/{name}-placements.svg", data=text.encode("utf-8")),)


def _near(content: GerberShapes, low: FloatArray, high: FloatArray) -> list[FloatArray]:
    """Flashed shapes in view."""
    inside = np.flatnonzero(((content.flash_xy_mm > low - _BESIDE_MM) & (content.flash_xy_mm < high + _BESIDE_MM)).all(axis=1))
    return [content.aperture_outlines_mm[content.flash_aperture[i]] + content.flash_xy_mm[i] for i in inside]


def _near_lines(content: GerberShapes, low: FloatArray, high: FloatArray) -> list[tuple[FloatArray, float]]:
    pairs = zip(content.strokes_mm, content.stroke_width_mm, strict=True)
    return [(s, float(w)) for s, w in pairs if ((s > low - _BESIDE_MM) & (s < high + _BESIDE_MM)).all(axis=1).any()]


def _head(low: FloatArray, side_mm: float, first: str) -> str:
    x, y = _units(low + np.array([0.0, side_mm]))
    side = f"{side_mm * _UNITS_PER_MM:.0f}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{side}" height="{side}" viewBox="{x:.2f} {y:.2f} {side} {side}" '
        'font-family="sans-serif">\n'
        f"<title>Placements from {escape(first)} on: pads, bodies, rotation, land 1</title>"
    )


def _units(xy_mm: FloatArray) -> FloatArray:
    """Board points in the picture's units, y down."""
    return board_to_texture(xy_mm, (0.0, 0.0)) * _UNITS_PER_MM


def _points(xy_mm: FloatArray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in _units(xy_mm))


def _area(outline_mm: FloatArray, colour: str, *, opacity: float = 1.0) -> str:
    seen = "" if opacity == 1.0 else f' fill-opacity="{opacity:g}"'
    return f'<polygon points="{_points(outline_mm)}" fill="{colour}"{seen}/>'


def _line(points_mm: FloatArray, colour: str, width_mm: float, dash: str = "") -> str:
    dashed = f' stroke-dasharray="{dash}"' * bool(dash)
    return (
        f'<polyline points="{_points(points_mm)}" fill="none" stroke="{colour}" stroke-width="{width_mm * _UNITS_PER_MM:.2f}" '
        f'stroke-linecap="round"{dashed}/>'
    )


def _words(xy_mm: FloatArray, text: str, colour: str) -> str:
    x, y = _units(xy_mm)
    return (
        f'<text x="{x:.2f}" y="{y:.2f}" font-size="{_TEXT_MM * _UNITS_PER_MM:g}" fill="{colour}" text-anchor="middle" '
        f'dominant-baseline="central">{escape(text)}</text>'
    )


def _part(centre: FloatArray, rotation_deg: float, name: str, body: FloatArray) -> list[str]:
    """A part's body with terminals, a mark on land 1, and the designator."""
    half = body / 2
    corners = np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)]) * half
    inner = half[0] * (1 - 2 * _TERMINAL_SHARE)
    end = np.array([(half[0], -half[1]), (half[0], half[1]), (inner, half[1]), (inner, -half[1])])
    drawn = [_area(rotate(corners, rotation_deg) + centre, BODY)]
    drawn += [_area(rotate(side * end, rotation_deg) + centre, TERMINAL) for side in (1, -1)]
    x, y = _units(rotate([(-half[0] - 1.6 * _MARK_MM, 0.0)], rotation_deg)[0] + centre)
    drawn.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{_MARK_MM * _UNITS_PER_MM:g}" fill="{_MARK}"/>')
    below = rotate([(0.0, -1.0)], rotation_deg)[0] * (half[1] + 1.2 * _TEXT_MM)
    return [*drawn, _words(centre + below, name, _INK)]


def _angle(centre: FloatArray, rotation_deg: float, body: FloatArray) -> list[str]:
    """The first part's axis, the board's x through it, and the angle between them."""
    reach = 0.95 * body[0]
    turned = np.linspace(0.0, rotation_deg, 25)
    arc = centre + 0.8 * reach * np.array([rotate([(1.0, 0.0)], float(t))[0] for t in turned])
    axis = np.array([centre, centre + reach * rotate([(1.0, 0.0)], rotation_deg)[0]])
    along_x = np.array([centre, centre + np.array([reach, 0.0])])
    middle = centre + 1.15 * reach * rotate([(1.0, 0.0)], rotation_deg / 2)[0]
    return [
        *(_line(points, _MARK, 0.018, "6 4") for points in (axis, along_x)),
        _line(arc, _MARK, 0.018),
        _words(middle, f"{rotation_deg:g}°", _MARK),
    ]
