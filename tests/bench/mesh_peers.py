"""The texture as a closed mesh by manifold3d, and its files by trimesh and by lib3mf."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import numpy.typing as npt
import trimesh
from lib3mf import Lib3MF, get_wrapper

from tactape_fab import Tape
from tactape_fab.solids.mesh.triangles import Mesh

CORNER_SEGMENTS = 64


def united(tape: Tape, base_mm: float) -> Mesh:
    """One box for each part and the board as one solid, by manifold3d.

    Boxes reach half way into the board, so that no faces lie on each other.
    """
    (length, width, height), (board_x, board_y) = tape.part.body_mm, tape.board.size_mm
    sunk, radius = base_mm / 2, tape.board.corner_radius_mm
    box = manifold3d.Manifold.cube((length, width, height + sunk), True).rotate((0.0, 0.0, tape.part.rotation_deg))
    inner = manifold3d.CrossSection.square((board_x - 2 * radius, board_y - 2 * radius)).translate((radius, radius))
    outline = inner.offset(radius, manifold3d.JoinType.Round, circular_segments=CORNER_SEGMENTS)
    board = manifold3d.Manifold.extrude(outline, base_mm).translate((0.0, 0.0, -base_mm))
    boxes = [box.translate((x, y, (height - sunk) / 2)) for x, y in tape.part_xy_mm().tolist()]
    mesh = manifold3d.Manifold.batch_boolean([board, *boxes], manifold3d.OpType.Add).to_mesh()
    return Mesh(vertices_mm=np.asarray(mesh.vert_properties[:, :3], dtype=np.float64), faces=np.asarray(mesh.tri_verts))


def stl_with_trimesh(mesh: Mesh, path: Path) -> None:
    """A mesh as binary STL."""
    trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).export(path, file_type="stl")


def threemf_with_lib3mf(mesh: Mesh, path: Path) -> None:
    """A mesh as 3MF, by the library of the format's own consortium."""
    wrapper = get_wrapper()
    model = wrapper.CreateModel()
    body = model.AddMeshObject()
    body.SetGeometry(
        _records(Lib3MF.Position, mesh.vertices_mm.astype(np.float32)), _records(Lib3MF.Triangle, mesh.faces.astype(np.uint32))
    )
    model.AddBuildItem(body, wrapper.GetIdentityTransform())
    model.QueryWriter("3mf").WriteToFile(str(path))


def _records(kind: Any, values: npt.NDArray[np.float32] | npt.NDArray[np.uint32]) -> object:
    """Rows of an array as an array of ctypes structures."""
    found: object = (kind * len(values)).from_buffer_copy(values.tobytes())
    return found
