"""Check of the mark in the back of a printed texture: its digits and arrow are read from the mesh."""

from __future__ import annotations

import numpy as np
import shapely

from tactape_fab.base.errors import Check
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mark import back_mm, floor_mm, mark_of, read_raster
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.wrap import unwrapped
from tactape_fab.texture.tape import Tape

_LEVEL_MM, _AREA_SHARE = 0.01, 0.005
_ROWS, _MOST_COLUMNS = 5, 1000


def check_mark(tape: Tape, form: SolidForm, mesh: Mesh) -> Check:
    """Check that the back shows the tape's sector beside an arrow to board +y, read from the engraved cells."""
    mark = mark_of(tape, form)
    if mark is None:
        return Check(name="stl mark", passed=True, message="the back has no place for a mark")
    flat = unwrapped(mesh.vertices_mm, tape, form)
    back, floor = back_mm(tape, form), floor_mm(tape, form, mark)
    # 0 on the back, 1 on the floor of the mark, for texture and mould
    depth = (flat[:, 2] - back)[mesh.faces] / (floor - back)
    sunk = flat[mesh.faces[(np.abs(depth - 1.0) * mark.depth_mm < _LEVEL_MM).all(axis=1)]][..., :2]
    if len(sunk) == 0:
        return Check(name="stl mark", passed=False, message="nothing is sunk into the back")
    area = shapely.union_all(shapely.polygons(sunk))
    figures = shapely.union_all([shapely.Polygon(*figure) for figure in mark.polygons()])
    found, wrong_mm2 = _figures(area, mirrored=mark.mirrored), area.symmetric_difference(figures).area
    problems = []
    if found != tape.sector:
        problems.append(f"the back shows {'no number beside an arrow' if found is None else found}, not sector {tape.sector}")
    if wrong_mm2 > _AREA_SHARE * figures.area:
        problems.append(f"{wrong_mm2:.3f} mm2 are sunk where they should not be, or not sunk")
    right = f"sector {found} and an arrow to board +y are read from the back, {mark.depth_mm:g} mm deep"
    return Check(name="stl mark", passed=not problems, message="; ".join(problems) or right)


def _figures(area: shapely.Geometry, *, mirrored: bool) -> int | None:
    """The number that an engraved area shows, seen from outside; None if it is not a number."""
    left, low, right, high = area.bounds
    # arrow and digits are five cells high, which gives the size of a cell without the manifest
    cell_mm = (high - low) / _ROWS
    columns = round((right - left) / cell_mm)
    if not 1 <= columns <= _MOST_COLUMNS:
        return None
    x, y = np.meshgrid(left + (np.arange(columns) + 0.5) * cell_mm, high - (np.arange(_ROWS) + 0.5) * cell_mm)
    cells = shapely.contains_xy(area, x, y)
    # board x points to the left if the back is seen from below
    return read_raster(cells[:, ::-1] if mirrored else cells)
