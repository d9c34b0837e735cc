"""One watertight mesh of base and elements, built directly without booleans; every edge has exactly two triangles."""

from __future__ import annotations

import numpy as np
import shapely

from tactape_fab.base.errors import RenderError
from tactape_fab.solids.element_lattice import (
    Numbers,
    build_lattice,
    build_rims,
    cell_loops,
    rest_of_board,
    triangulated,
    whole_cells,
)
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mark import back_mm, floor_mm, mark_of
from tactape_fab.solids.mesh.shells import Shell, element_shells
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.wrap import world, wrap_of
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

_SAME_MM = 1e-7
_ITSELF: IntArray = np.array([[0, 1, 2]])


def texture_mesh(tape: Tape, form: SolidForm) -> Mesh:
    """The mesh of a tape's solid: flat or on a cylinder, texture or mould.

    form: `checks.form_problems` must have found nothing.
    Returns: Board frame, mm; z = 0 is the top of the base.
    """
    builder = _Builder(tape, form)
    builder.elements()
    builder.board()
    return builder.mesh()


class _Builder:
    """Collects vertices and triangles: of the lattice first, then of the rest of the top, the back, and the elements."""

    def __init__(self, tape: Tape, form: SolidForm) -> None:
        self._tape, self._form = tape, form
        self._wrap = None if form.cylinder is None else wrap_of(tape, form, form.cylinder)
        self._mark = mark_of(tape, form)
        self._part = tape.part if self._wrap is None else self._wrap.part
        self._lattice = build_lattice(tape, self._wrap)
        self._rims = build_rims(tape, self._lattice, self._wrap)
        lattice = self._lattice
        self._a = lattice.a_fine_mm
        self._lattice_points = len(self._a) * len(lattice.b_mm)
        self._others = Numbers()
        self._faces: list[tuple[IntArray, IntArray]] = []  # vertices of copies (n, m), and triangles (f, 3) as column indices
        self._elements: list[FloatArray] = []
        self._element_count = 0

    # Elements

    def elements(self) -> None:
        """Shells of all elements, and the tops of all whole cells."""
        tape, lattice = self._tape, self._lattice
        whole = whole_cells(tape, lattice, self._wrap)
        self._whole = whole
        cells = tape.cells()
        symbols = tape.symbols[cells[:, 1], cells[:, 0]].astype(np.int64)
        i, j = lattice.cell_of_part.T
        last_i, last_j = len(lattice.a_mm) - 2, len(lattice.b_mm) - 2
        # cells of one symbol are congruent except the outermost ones, which may be narrower: symbol and four flags
        kind = (((symbols * 2 + (i == 0)) * 2 + (i == last_i)) * 2 + (j == 0)) * 2 + (j == last_j)
        alike = [whole[kind[whole] == key] for key in sorted(set(kind[whole].tolist()))]
        sides = [self._sides(int(parts[0])) for parts in alike]
        radius_mm = None if self._wrap is None else self._wrap.radius_mm
        shells = element_shells(self._part, [t[1:-1] for t in sides], radius_mm) if sides else []
        for parts, t, shell in zip(alike, sides, shells, strict=True):
            self._cells_alike(parts, t, shell)
        self._feet: list[FloatArray] = []
        # parts whose cell is cut by a rounded corner or a hole: their feet become holes of the rest of the top
        alone = np.ones(tape.part_count, dtype=bool)
        alone[whole] = False
        for part in np.flatnonzero(alone).tolist():
            (shell,) = element_shells(self._part, [np.empty(0)], None)
            foot = shell.foot + lattice.local_mm[part]
            self._feet.append(foot)
            self._add_shell(shell, np.array([part]), self._top_ids(foot)[None])

    def _sides(self, part: int) -> FloatArray:
        """Tangential offsets from a part of the lattice's lines at and between the sides of its cell."""
        n, i = self._lattice.slices, self._lattice.cell_of_part[part, 0]
        return self._tangential(self._a[i * n : (i + 1) * n + 1] - self._lattice.local_mm[part, 0])

    def _cells_alike(self, parts: IntArray, t: FloatArray, shell: Shell) -> None:
        """Cells of one symbol and size, with one triangulation for all; `t` are the `_sides` of the first."""
        lattice, first = self._lattice, int(parts[0])
        j, b, n = lattice.cell_of_part[first, 1], lattice.local_mm[first, 1], lattice.slices
        low, high = lattice.b_mm[j] - b, lattice.b_mm[j + 1] - b
        # n + 1 vertices along the cell's lower side, then as many along its upper one: the order of `ids` below
        border = np.concatenate([np.column_stack([t, np.full_like(t, low)]), np.column_stack([t, np.full_like(t, high)])])
        numbers = Numbers()
        known = numbers(np.concatenate([border, shell.foot]))
        ring = np.concatenate([border[: n + 1], border[n + 1 :][::-1]])
        region = shapely.Polygon(ring, [shell.foot])
        # (t, b) is the projection along the element's normal: triangles that do not overlap there do not overlap in space
        corners = np.concatenate(list(triangulated(region, t if n > 1 else None)))
        faces = numbers(corners)
        # a vertex that GEOS moved or added would belong to one cell only, with open edges
        if len(numbers.points) != len(known):
            raise RenderError(f"the mesh of a cell with part '{self._part.name}' does not close; use another --rotation")
        ci, cj = lattice.cell_of_part[parts].T
        columns = ci[:, None] * n + np.arange(n + 1)
        # lattice vertices are numbered along b, line by line
        lower = columns * len(lattice.b_mm) + cj[:, None]
        ids = np.concatenate([lower, lower + 1], axis=1)
        self._add_shell(shell, parts, None, ids, faces)

    def _tangential(self, arc_mm: FloatArray) -> FloatArray:
        """Offset along the tangent at an element, for points on the surface at an arc length from it."""
        if self._wrap is None:
            return arc_mm
        return self._wrap.radius_mm * np.sin(arc_mm / self._wrap.radius_mm)

    def _add_shell(
        self,
        shell: Shell,
        parts: IntArray,
        foot_ids: IntArray | None,
        cell_ids: IntArray | None = None,
        cell_faces: IntArray | None = None,
    ) -> None:
        """Add copies of a shell: its faces, and those of its cell, whose indices count the border first, then the foot.

        Foot vertices are the copy's own, unless `foot_ids` names them in the top sheet.
        """
        foot = shell.foot if foot_ids is None else shell.foot[:0]
        own = len(foot) + len(shell.above)
        # the number of the sheet's vertices is not known yet, so -1 - k is the k-th vertex of elements until `mesh`
        first = -1 - self._element_count - np.arange(len(parts))[:, None] * own  # negative: numbered after all others
        self._element_count += len(parts) * own
        own_ids = first - np.arange(own)
        ids = own_ids if foot_ids is None else np.concatenate([foot_ids, own_ids], axis=1)
        self._faces.append((ids, shell.faces))
        if cell_ids is not None and cell_faces is not None:
            ids = np.concatenate([cell_ids, own_ids], axis=1)
            self._faces.append((ids, cell_faces))
        self._elements.append(self._element_points(foot, shell.above, parts))

    def _element_points(self, foot: FloatArray, above: FloatArray, parts: IntArray) -> FloatArray:
        centre = self._lattice.local_mm[parts]
        if self._wrap is None:
            local = np.concatenate([np.column_stack([foot, np.zeros(len(foot))]), above])
            turn = np.diag(world(self._form))  # a half turn or none: signs
            points = local * turn + (np.column_stack([centre, np.zeros(len(parts))]) * turn)[:, None]
            return points.reshape(-1, 3)
        radius_mm = self._wrap.radius_mm
        # (tangential, along, distance from the axis): the foot where the vertical through it meets the cylinder
        on_surface = np.column_stack([foot, np.sqrt(radius_mm**2 - foot[:, 0] ** 2)])
        local = np.concatenate([on_surface, above + np.array([0.0, 0.0, radius_mm])])
        angle = self._wrap.angle_rad(centre[:, 0])
        axis = self._wrap.point(angle, centre[:, 1], 0.0)
        return (axis[:, None] + local @ self._wrap.frames(angle)).reshape(-1, 3)

    # Board

    def board(self) -> None:
        """Add the top outside whole cells, the back, and the walls between them."""
        rims, lattice = self._rims, self._lattice
        cuts = None if self._wrap is None else lattice.a_all_mm
        # vertices of all borders are numbered before the triangulation, as a later one would be on an open edge
        rest = rest_of_board(rims, cell_loops(lattice, self._whole), self._feet)
        known_top = [self._top_ids(rim) for rim in (rims.outline, *rims.holes)]
        back = Numbers()
        known_back = [back(self._joined(rim)) for rim in (rims.outline, *rims.holes)]
        count_top = len(self._others.points)
        top_faces = [self._top_ids(corners) for corners in triangulated(rest, cuts)]
        pockets = self._pockets()
        sunk = Numbers()
        loops = [loop[::-1] for outer, islands in pockets for loop in (outer, *islands)]  # the base on the left
        known_back += [back(loop) for loop in loops]
        known_sunk = [sunk(loop) for loop in loops]
        count_back, count_sunk = len(back.points), len(sunk.points)
        # the back without the mark, and the islands inside its figures, such as that of a 0
        bare = [
            shapely.Polygon(rims.outline, [*rims.holes, *(outer for outer, _ in pockets)]),
            *(shapely.Polygon(island) for _, islands in pockets for island in islands),
        ]
        # triangles are counter-clockwise seen from above, and the back faces down
        back_faces = [back(self._joined(corners))[:, ::-1] for area in bare for corners in triangulated(area, cuts)]
        floors = [sunk(corners)[:, ::-1] for pocket in pockets for corners in triangulated(shapely.Polygon(*pocket), cuts)]
        if (len(self._others.points), len(back.points), len(sunk.points)) != (count_top, count_back, count_sunk):
            raise RenderError("the mesh of the board does not close; use a slightly different --size")
        faces = top_faces
        sunk_first = self._back_first + count_back
        known_top += [ids + sunk_first for ids in known_sunk]
        for rim, top, low in zip((rims.outline, *rims.holes, *loops), known_top, known_back, strict=True):
            steps = np.roll(rim, -1, axis=0) - rim
            # the two ends of a whole shell coincide, without a wall
            seam = (np.abs(steps[:, 0]) <= _SAME_MM) & (rims.closed and rim is rims.outline)
            used = ~seam
            # with the material on the left of p -> q the wall faces right: (p_low, q_low, q), (p_low, q, p)
            p, q = top[used], np.roll(top, -1)[used]
            p_low, q_low = low[used] + self._back_first, np.roll(low, -1)[used] + self._back_first
            faces += [np.stack([p_low, q_low, q], axis=1), np.stack([p_low, q, p], axis=1)]
        faces += [of_back + self._back_first for of_back in back_faces]
        faces += [floor + sunk_first for floor in floors]
        self._faces += [(some, _ITSELF) for some in faces]
        self._back = np.array(back.points)
        self._sunk = np.array(sunk.points).reshape(-1, 2)

    def _pockets(self) -> list[tuple[FloatArray, list[FloatArray]]]:
        """Figures of the mark as outline and islands (a, b), with a vertex wherever a cut crosses them."""
        if self._mark is None:
            return []
        turn = np.eye(2) if self._wrap is None else self._wrap.from_board
        cuts = np.empty(0) if self._wrap is None else self._lattice.a_all_mm

        def cut(loop: FloatArray) -> FloatArray:
            loop = loop @ turn.T
            points = []
            for start, end in zip(loop, np.roll(loop, -1, axis=0), strict=True):
                low, high = min(start[0], end[0]), max(start[0], end[0])
                # sides of the mark's cells are parallel to the board's, so the other coordinate is that of `start`
                inside = cuts[(cuts > low + _SAME_MM) & (cuts < high - _SAME_MM)]
                points += [start, *((x, start[1]) for x in (inside if end[0] > start[0] else inside[::-1]))]
            return np.array(points)

        return [(cut(outer), [cut(island) for island in islands]) for outer, islands in self._mark.polygons()]

    @property
    def _back_first(self) -> int:
        return self._lattice_points + len(self._others.points)

    def _joined(self, points_mm: FloatArray) -> FloatArray:
        """Points in which both ends of a closed shell have the same coordinate."""
        if not self._rims.closed:
            return points_mm
        first, last = self._lattice.a_all_mm[[0, -1]]
        joined = points_mm.copy()
        # otherwise the shell would be open along a seam of duplicate vertices
        joined[np.abs(points_mm[..., 0] - last) < _SAME_MM, 0] = first
        return joined

    def _top_ids(self, points_mm: FloatArray) -> IntArray:
        """Numbers of points of the top: lattice vertices, or new ones."""
        points = self._joined(points_mm).reshape(-1, 2)
        ids = np.full(len(points), -1, dtype=np.int64)
        near = []
        for lines, values in ((self._a, points[:, 0]), (self._lattice.b_mm, points[:, 1])):
            after = np.clip(np.searchsorted(lines, values), 1, len(lines) - 1)
            near.append(np.where(values - lines[after - 1] < lines[after] - values, after - 1, after))
        on = (np.abs(self._a[near[0]] - points[:, 0]) < _SAME_MM) & (
            np.abs(self._lattice.b_mm[near[1]] - points[:, 1]) < _SAME_MM
        )
        ids[on] = near[0][on] * len(self._lattice.b_mm) + near[1][on]
        ids[~on] = self._lattice_points + self._others(points[~on])
        return ids.reshape(points_mm.shape[:-1])

    # All together

    def _placed(self, ab_mm: FloatArray, z_mm: float) -> FloatArray:
        if self._wrap is None:
            return np.column_stack([ab_mm, np.full(len(ab_mm), z_mm)]) @ world(self._form).T
        return self._wrap.point(self._wrap.angle_rad(ab_mm[:, 0]), ab_mm[:, 1], self._wrap.radius_mm + z_mm)

    def mesh(self) -> Mesh:
        """The mesh of all triangles, reversed for a mould, and of the vertices that they use."""
        form, lattice = self._form, self._lattice
        a, b = np.meshgrid(self._a, lattice.b_mm, indexing="ij")
        others = np.array(self._others.points).reshape(-1, 2)
        vertices = np.concatenate(
            [
                self._placed(np.stack([a.ravel(), b.ravel()], axis=1), 0.0),
                self._placed(others, 0.0),
                self._placed(self._back, back_mm(self._tape, form)),
                self._placed(self._sunk, floor_mm(self._tape, form, self._mark)),
                *self._elements,
            ]
        )
        own = self._back_first + len(self._back) + len(self._sunk)
        copies, self._faces, self._elements = self._faces, [], []
        used = np.zeros(len(vertices), dtype=bool)
        for ids, triangles in copies:
            # -1 - k becomes own + k
            np.subtract(own - 1, ids, out=ids, where=ids < 0)
            # lattice points inside cells that are not whole belong to no triangle
            used[ids[:, [*set(triangles.ravel().tolist())]]] = True
        number = np.cumsum(used) - 1
        faces = np.empty((sum(len(ids) * len(triangles) for ids, triangles in copies), 3), dtype=np.int64)
        end = 0
        for ids, triangles in copies:
            begin, end = end, end + len(ids) * len(triangles)
            out = faces[begin:end].reshape(len(ids), *triangles.shape)
            np.take(number[ids], triangles, axis=1, out=out, mode="clip")  # any other mode makes a copy first
        vertices = vertices if used.all() else vertices[used]
        # a mould has the material on the other side of the same surface
        return Mesh(vertices_mm=vertices, faces=faces[:, ::-1] if form.negative else faces)
