"""Checks of a texture on the user's own part: one closed body, and the symbols recovered from its triangles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tactape_fab.base.errors import Check, SpecError, refuse
from tactape_fab.base.fields import Fields, counted, named
from tactape_fab.solids.elements import reach_mm
from tactape_fab.solids.mesh.stl import MeshError, body_count, mesh_problems, read_stl, stl_problems
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.surface.charts import nearest
from tactape_fab.solids.surface.placements import Placed, PlacementsError, read_placements
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import FloatArray, IntArray, texture_to_board
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.models.raised import bounds_of_groups
from tactape_fab.verify.symbols import check_symbols

_VOLUME_ERROR = 1e-6
_PLACE_ERROR_MM = 1e-3
_TOP_FROM, _BESIDE = 0.6, 1.1
"""Least height of an element's top vertices, as a fraction of its height, and how far they may be from its middle along the
board's axes, as a multiple of its reach: so much farther the surface rises from half the height to 0.55 of it."""
_GRID_SHARE, _GRID_SHARE_OF_PITCH, _GRID_SHARE_UP = 0.1, 4.0, 0.3
"""Largest error of an element's displacement from its grid point, as a fraction of it: on a flat part, for each of the recorded
pitch error, and along the normal. On 98 parts it was at most 2.1 of the pitch error, and 0.06 along the normal."""


def check_embossed(manifest: Mapping[str, Any], stl_bytes: bytes, placements_bytes: bytes) -> list[Check]:
    """Check an embossed model against its manifest.

    manifest: With a ``surface`` table.
    stl_bytes, placements_bytes: The files of the roles ``stl`` and ``placements``.
    Returns: Every line, also when some failed; a file that cannot be read is a failed line.
    """
    try:
        tape = Tape.from_mapping(manifest)
        table = Fields(manifest)
        surface = table.table("surface")
        volume_mm3 = surface.number("volume_mm3", above=0.0, unit="mm3")
        bodies = surface.integer("bodies", low=1, high=1_000_000)
        distortion = surface.table("distortion")
        pitch_error = max(abs(distortion.number(f"pitch_error_{end}", low=-1.0, high=1.0, unit="")) for end in ("min", "max"))
        refuse(table.problems)
    except SpecError as error:
        return [Check(name="manifest", passed=False, message="; ".join(str(error).splitlines()))]
    try:
        mesh = read_stl(stl_bytes)
    except MeshError as error:
        return [Check(name="stl", passed=False, message=str(error))]
    checks = [_check_body(mesh, bodies, stl_problems(stl_bytes)), _check_volume(mesh, volume_mm3)]
    try:
        placed = read_placements(placements_bytes, tape.part_count)
    except PlacementsError as error:
        return [*checks, Check(name="placements", passed=False, message=str(error))]
    checks.append(_check_rows(tape, placed, pitch_error))
    if not checks[-1].passed:
        return checks
    owner, tops = _tops(tape, placed, mesh)
    checks.append(_check_tops(tape, placed, owner, tops))
    board_mm = _board_positions(tape, placed, owner, tops)
    return checks + check_symbols(tape, board_mm, "STL")


def _check_body(mesh: Mesh, bodies: int, file_problems: Sequence[str]) -> Check:
    found = body_count(mesh)
    problems = [*file_problems, *(problem for problem in mesh_problems(mesh) if not problem.endswith(" bodies"))]
    if found != bodies:
        problems.append(f"{counted(found, 'body', 'bodies')} instead of {bodies}")
    shells = "one body" if found == 1 else f"{found} shells"
    message = "; ".join(problems) if problems else f"{len(mesh.faces)} triangles, watertight, {shells}"
    return Check(name="body", passed=not problems, message=message, figure=float(found))


def _check_volume(mesh: Mesh, volume_mm3: float) -> Check:
    found = mesh.volume_mm3
    error = abs(found - volume_mm3) / volume_mm3
    message = f"{found:.4f} mm3, {volume_mm3:.4f} in the manifest"
    return Check(name="volume", passed=error <= _VOLUME_ERROR, message=message, figure=error)


def _check_rows(tape: Tape, placed: Placed, pitch_error: float) -> Check:
    problems = []
    if list(placed.designators) != tape.designators():
        problems.append("its designators are not the tape's")
    if not np.array_equal(placed.cells, tape.cells()):
        problems.append("its columns and rows are not the tape's")
    # |v|^2 - 1 is twice the error of the length; with nine decimals it is some 1e-9
    lengths = np.stack([(v * v).sum(axis=1) - 1 for v in (placed.x_axis, placed.normal)])
    askew = max(float(np.abs(lengths).max()), float(np.abs((placed.x_axis * placed.normal).sum(axis=1)).max()))
    if askew > 1e-6:
        problems.append("its axes are not unit vectors at right angles")
    if not problems:
        moved = _moved(placed)
        wanted = tape.part_xy_mm() - texture_to_board(placed.cells * tape.pitch_mm, tape.board.texture_origin_mm)
        share = np.c_[np.linalg.norm(moved[:, :2] - wanted, axis=1), np.abs(moved[:, 2])] / tape.displacement_mm
        off = np.flatnonzero((share > (_GRID_SHARE + _GRID_SHARE_OF_PITCH * pitch_error, _GRID_SHARE_UP)).any(axis=1))
        if len(off):
            problems.append(f"its grid points of {named([placed.designators[i] for i in off])} are elsewhere")
    message = "; ".join(problems) if problems else f"{len(placed.designators)} elements as in the manifest"
    return Check(name="placements", passed=not problems, message=message, figure=float(len(placed.designators)))


def _tops(tape: Tape, placed: Placed, mesh: Mesh) -> tuple[IntArray, FloatArray]:
    """Vertices of the elements' tops: nearest grid point of each, and coordinates in the frame at that element's place.

    An element is looked for at the places of all symbols, and is where most vertices are.
    """
    # an element is within its cell, whose corner is W / sqrt 2 from the grid point, and within its height
    cell_mm = tape.pitch_mm / 2**0.5 + tape.part.body_mm[2]
    distance, owner = nearest(placed.grid_mm, mesh.vertices_mm, within_mm=cell_mm)
    near = np.isfinite(distance)
    owner = owner[near]
    local = np.einsum("nij,nj->ni", _axes(placed)[owner], mesh.vertices_mm[near] - placed.points_mm[owner])
    # above a foot the part's surface rises by at most half the height (`too_curved`), beside it perhaps higher than the top
    high = local[:, 2] > _TOP_FROM * tape.part.body_mm[2]
    owner, local = owner[high], local[high]
    shifts_mm = DIRECTIONS[tape.directions].xy * (tape.displacement_mm, -tape.displacement_mm)
    places_mm = shifts_mm - shifts_mm[tape.symbols[placed.cells[:, 1], placed.cells[:, 0]], None]
    beside_mm = np.abs(local[:, None, :2] - places_mm[owner])
    over = (beside_mm <= _BESIDE * np.array(reach_mm(tape.part))).all(axis=2)
    vertices = np.zeros(places_mm.shape[:2], dtype=np.int64)
    np.add.at(vertices, owner, over)
    top = over[np.arange(len(owner)), vertices.argmax(axis=1)[owner]]
    return owner[top], local[top]


def _axes(placed: Placed) -> FloatArray:
    """Rows are the axes of every element's frame, so that scalar products with them are coordinates in it; shape (n, 3, 3)."""
    return np.stack([placed.x_axis, np.cross(placed.normal, placed.x_axis), placed.normal], axis=1)


def _moved(placed: Placed) -> FloatArray:
    """Every element's place as seen from its grid point, along the board's x and y axes and its normal; shape (n, 3), mm."""
    return np.asarray(np.einsum("nij,nj->ni", _axes(placed), placed.points_mm - placed.grid_mm))


def _check_tops(tape: Tape, placed: Placed, owner: IntArray, tops: FloatArray) -> Check:
    """Check that the centre of every element's top is above its place, at the element's height."""
    low, high = bounds_of_groups(tape.part_count, owner, tops)
    there = np.isfinite(low[:, 0])
    if not there.all():
        missing = [placed.designators[i] for i in np.flatnonzero(~there)[:5]]
        message = f"{int((~there).sum())} elements are not there, such as {', '.join(missing)}"
        return Check(name="elements", passed=False, message=message, figure=float(there.sum()))
    # middle of the bounds, as vertices of a boolean operation's result are unevenly distributed
    found = np.c_[(low[:, :2] + high[:, :2]) / 2, high[:, 2]]
    error = np.linalg.norm(found - (0.0, 0.0, tape.part.body_mm[2]), axis=1)
    worst = int(error.argmax())
    message = f"{len(error)} elements stand where the placements say, within {error.max() * 1000:.2f} µm"
    if error.max() > _PLACE_ERROR_MM:
        message = f"{placed.designators[worst]} stands {error.max():.4f} mm from its place"
    return Check(name="elements", passed=error.max() <= _PLACE_ERROR_MM, message=message, figure=error.max(), unit="mm")


def _board_positions(tape: Tape, placed: Placed, owner: IntArray, tops: FloatArray) -> FloatArray:
    """Board positions of the elements in the mesh, from their coordinates at their places; shape (m, 2)."""
    low, high = bounds_of_groups(len(placed.cells), owner, tops)
    there = np.isfinite(low[:, 0])
    moved = _moved(placed)[there, :2] + (low[there, :2] + high[there, :2]) / 2
    points = texture_to_board(placed.cells[there] * tape.pitch_mm, tape.board.texture_origin_mm)
    return np.asarray(points + moved, dtype=np.float64)
