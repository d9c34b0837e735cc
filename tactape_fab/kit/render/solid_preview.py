"""Previews of a texture of solid elements, drawn from the bytes of its STL file: a shaded picture, and a drawing of the feet."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from tactape_fab.kit.artifact import AnyArtifact, Artifact
from tactape_fab.kit.render.colours import MOULD, TEXTURE, Colour, rgb
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.mesh.stl import read_stl
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.picture import png_bytes, shaded
from tactape_fab.solids.wrap import unwrapped, world
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.shapes import area_mm2
from tactape_fab.texture.tape import Tape

WIDTH_PX = 1400
CYLINDER_WIDTH_PX = 900
MARGIN_MM = 2.0
EDGE_MM = 0.1
FOOT_MM = 0.03
_LEVEL_MM = 0.02
"""Tolerance within which a vertex of the single-precision mesh counts as on the surface, mm."""
_ELEMENT = "#59616b"

View = tuple[tuple[float, float, float], tuple[float, float, float]]


def render_solid_preview(models: Iterable[AnyArtifact], tape: Tape, form: SolidForm) -> tuple[Artifact, Artifact]:
    """SVG and PNG pictures of a solid.

    models: The models, of which the bytes of the STL are drawn.
    tape: Gives the files' name, and the elements' height, which distinguishes elements from base.
    form: Form of the surface: flat or on a cylinder, facing up or turned over.
    """
    mesh = read_stl(next(a.data for a in models if a.role == "stl"))
    colour = MOULD if form.negative else TEXTURE
    direction, up = _view(form.cylinder)
    picture = shaded(
        mesh, direction=direction, up=up, width_px=WIDTH_PX if form.cylinder is None else CYLINDER_WIDTH_PX, rgb=rgb(colour)
    )
    return (
        Artifact(role="preview-svg", path=f"preview/{tape.name}.svg", data=_svg(*_drawing(mesh, tape, form), tape.name, colour)),
        Artifact(role="preview-png", path=f"preview/{tape.name}.png", data=png_bytes(picture)),
    )


def _view(cylinder: Cylinder | None) -> View:
    """Direction from which a solid is seen, and the up vector."""
    if cylinder is None:
        return (0.0, -0.5, 1.0), (0.0, 1.0, 0.0)
    return ((-0.45, -0.75, 0.75) if cylinder.around == "x" else (-0.75, -0.45, 0.75)), (0.0, 0.0, 1.0)


# Drawing: feet of elements and outline, developed into the plane


def _drawing(mesh: Mesh, tape: Tape, form: SolidForm) -> tuple[list[FloatArray], list[FloatArray]]:
    """Loops of the outline, with holes, and of the elements' feet as seen from above, y up; mm."""
    height_mm = tape.part.body_mm[2]
    flat = unwrapped(mesh.vertices_mm, tape, form)
    level = flat[:, 2][mesh.faces]
    # level: heights of each triangle's corners over the surface, shape (m, 3). Back and sides of a mould, which is turned over,
    # extend to height + base, and are not elements
    below_base = level.max(axis=1) < height_mm + form.base_mm / 2
    # an element's triangles have a vertex above the surface and none below it, within the rounding of single precision
    element = below_base & (level.max(axis=1) > min(_LEVEL_MM, height_mm / 2)) & (level.min(axis=1) > -_LEVEL_MM)
    low = flat[:, 2] < _LEVEL_MM
    # x and y of the developed surface as seen from above; turning over a mould mirrors them
    seen = flat[:, :2] @ world(form)[:2, :2].T
    feet = [seen[loop] for loop in boundary_loops(mesh.faces[element], low)]
    if form.cylinder is not None:
        (left, bottom), (right, top) = seen.min(axis=0), seen.max(axis=0)
        return [np.array([(left, bottom), (right, bottom), (right, top), (left, top)])], feet
    surface = element | (np.abs(level) < _LEVEL_MM).all(axis=1)
    return sorted((seen[loop] for loop in boundary_loops(mesh.faces[surface], low)), key=area_mm2, reverse=True), feet


def boundary_loops(faces: IntArray, among: BoolArray) -> list[IntArray]:
    """Boundary loops of some faces of a closed mesh, oriented as the faces, along the vertices marked in `among`."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    between = among[start] & among[end]
    start, end = start[between], end[between]
    # an edge as one number, smaller vertex first, so that both directions of an edge are equal
    edge = np.minimum(start, end) << 32 | np.maximum(start, end)
    order = np.argsort(edge)
    # in sorted order an edge is a boundary edge if it differs from both neighbours
    apart = np.concatenate([[True], np.diff(edge[order]) != 0, [True]])
    outer = order[apart[1:] & apart[:-1]]  # edges of one face only
    # faces are consistently oriented, so that each boundary vertex has one successor
    following = dict(zip(start[outer].tolist(), end[outer].tolist(), strict=True))
    loops = []
    while following:
        first, at = following.popitem()
        loop = [first]
        # at a vertex where two loops touch the dictionary keeps one successor only: the loop ends there
        while at != first and at in following:
            loop.append(at)
            at = following.pop(at)
        loops.append(np.array(loop, dtype=np.int64))
    return loops[::-1]


def _path(loop: FloatArray) -> str:
    return ("M%.4f %.4f" + "L%.4f %.4f" * (len(loop) - 1)) % tuple(loop.ravel().tolist()) + "Z"


def _svg(outline: Sequence[FloatArray], feet: Sequence[FloatArray], name: str, colour: Colour) -> bytes:
    down = np.array([1.0, -1.0])
    points = np.concatenate(outline) * down
    low, (width, height) = points.min(axis=0) - MARGIN_MM, np.ptp(points, axis=0) + 2 * MARGIN_MM
    stroke = f'stroke="{_ELEMENT}" stroke-linejoin="round"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="{low[0]:.4f} {low[1]:.4f} {width:.4f} {height:.4f}">',
        f"<title>{name}</title>",
        f'<path id="base" fill="{colour}" fill-rule="evenodd" {stroke} stroke-width="{EDGE_MM}" '
        f'd="{"".join(_path(loop * down) for loop in outline)}"/>',
        f'<g id="elements" fill="#ffffff" fill-opacity="0.35" {stroke} stroke-width="{FOOT_MM}">',
        *(f'<path d="{_path(foot * down)}"/>' for foot in feet),
        "</g>",
        "</svg>\n",
    ]
    return "\n".join(lines).encode("ascii")
