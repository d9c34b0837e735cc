"""The exponential map of a mesh: geodesics from one point in all directions, traced over the triangles simultaneously.

The mesh represents the smooth surface that it approximates. A path runs over the facets, but its direction follows normals
interpolated between the corners, not the unfolding of facet after facet: on a coarse sphere it stays in the plane of a great
circle, where unfolded paths scatter at every corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, radians

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.solids.mesh.triangles import Mesh, face_normals, unit
from tactape_fab.solids.surface.charts import Frames, Placement, board_x, turned
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

CREASE_DEG = 30.0
"""Angle between facets beyond which they belong to two surfaces, so that a texture ends there."""

_USUAL_SHARE = (0.4, 2.5)
"""Range of a facet's area, relative to the mean at a vertex, within which facets have equal weights."""
_LONGEST_STEP_MM = 0.75
_MOST_STEPS = 20_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Facets:
    """A closed mesh with derived data for tracing paths."""

    mesh: Mesh

    @cached_property
    def corners(self) -> FloatArray:
        """Shape (f, 3, 3), mm."""
        return self.mesh.corners_mm

    @cached_property
    def normals(self) -> FloatArray:
        """Normals of the facets; shape (f, 3); zero for a facet without area."""
        return face_normals(self.corners)

    @cached_property
    def gradients(self) -> FloatArray:
        """Gradient of each barycentric coordinate in the facet's plane; shape (f, 3, 3), 1/mm."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        area2 = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        # coordinate i is 1 at corner i and 0 on the opposite edge e; its gradient is n x e / 2A, of length 1 / height
        opposite = np.stack([c - b, a - c, b - a], axis=1)
        inward = np.cross(self.normals[:, None], opposite)
        return inward / np.where(area2 > 0, area2, np.inf)[:, None, None]

    @cached_property
    def neighbours(self) -> tuple[IntArray, IntArray]:
        """Facet across the edge opposite each corner, and its corner opposite that edge; shapes (f, 3)."""
        faces = self.mesh.faces
        start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
        count = len(self.mesh.vertices_mm)
        # in a closed, oriented mesh the neighbour traverses the same edge in reverse: key (end, start)
        order = np.argsort(start * count + end)
        other = order[np.searchsorted(start * count + end, end * count + start, sorter=order)]
        return (other // 3).reshape(-1, 3), (other % 3).reshape(-1, 3)

    @cached_property
    def creased(self) -> BoolArray:
        """Whether the edge opposite each corner is a crease, at which the surface ends; shape (f, 3)."""
        facet, _ = self.neighbours
        turn = np.einsum("ij,ikj->ik", self.normals, self.normals[facet])
        return np.asarray(turn < cos(radians(CREASE_DEG)))

    @cached_property
    def corner_normals(self) -> FloatArray:
        """Smooth normals at the corners of every facet; shape (f, 3, 3).

        The mean over the facets at a vertex within the crease angle of the facet, weighted by their angles there. Facets much
        larger than the mean at the vertex have more weight, and slivers less, so that a large flat face keeps its normal up to
        the narrow facets of a fillet.
        """
        a = self.corners
        forward, backward = unit(np.roll(a, -1, axis=1) - a), unit(np.roll(a, 1, axis=1) - a)
        angle = np.arccos(np.clip(np.einsum("ijk,ijk->ij", forward, backward), -1, 1)).ravel()
        vertex = self.mesh.faces.ravel()
        area = np.repeat(np.linalg.norm(np.cross(a[:, 1] - a[:, 0], a[:, 2] - a[:, 0]), axis=1), 3)
        share = area * (np.bincount(vertex) / np.maximum(np.bincount(vertex, weights=area), 1e-300))[vertex]
        # factor 1 within the range, beyond it the square of the excess
        weight = angle * (share / np.clip(share, *_USUAL_SHARE)) ** 2
        # corners sorted by vertex, so that those of one vertex are a slice of `size` from `first`
        order = np.argsort(vertex, kind="stable")
        first = np.searchsorted(vertex[order], np.arange(len(self.mesh.vertices_mm)))
        size = np.diff(np.append(first, len(order)))
        own = self.normals[np.arange(len(vertex)) // 3]
        total = np.zeros_like(own)
        corner = np.arange(len(vertex))
        for k in range(int(size.max())):  # the k-th facet at every corner's vertex
            corner = corner[size[vertex[corner]] > k]
            other = order[first[vertex[corner]] + k]
            close = np.einsum("ij,ij->i", own[corner], own[other]) > cos(radians(CREASE_DEG))
            total[corner] += np.where(close, weight[other], 0.0)[:, None] * own[other]
        # a facet without area has no normal, so it is not within the angle even of itself
        total = np.where(np.linalg.norm(total, axis=1, keepdims=True) > 0, total, own)
        return unit(total).reshape(-1, 3, 3)

    def barycentric(self, facet: IntArray, points_mm: FloatArray) -> FloatArray:
        """Barycentric coordinates of points projected onto the facets' planes; shape (n, 3)."""
        # coordinate i is 0 at the next corner, so it is the gradient times the offset from there
        from_corner = points_mm[:, None] - np.roll(self.corners[facet], -1, axis=1)
        return np.asarray(np.einsum("ijk,ijk->ij", self.gradients[facet], from_corner))

    def smooth_normals(self, facet: IntArray, weights: FloatArray) -> FloatArray:
        """Normals interpolated between a facet's corners; shape (n, 3)."""
        # at an edge a coordinate may be slightly negative by rounding
        inside = np.clip(weights, 0.0, 1.0)
        return unit(np.einsum("ij,ijk->ik", inside, self.corner_normals[facet]))

    def nearest(self, point_mm: FloatArray) -> tuple[int, FloatArray, float]:
        """Facet nearest to a point, the nearest place on it, and the distance."""
        a = self.corners
        weights = self.barycentric(np.arange(len(a)), np.broadcast_to(point_mm, (len(a), 3)))
        # the projection onto a plane if it is inside the triangle, else the nearest point on an edge
        foot = np.einsum("ij,ijk->ik", weights, a)
        inside = (weights >= 0).all(axis=1) & (np.linalg.norm(self.normals, axis=1) > 0)
        least, best = np.where(inside, np.linalg.norm(foot - point_mm, axis=1), np.inf), foot
        for k in range(3):
            start, along = a[:, k], a[:, (k + 1) % 3] - a[:, k]
            length = np.einsum("ij,ij->i", along, along)
            part = np.clip(np.einsum("ij,ij->i", point_mm - start, along) / np.where(length > 0, length, 1), 0, 1)
            foot = start + part[:, None] * along
            distance = np.linalg.norm(foot - point_mm, axis=1)
            nearer = distance < least
            least, best = np.where(nearer, distance, least), np.where(nearer[:, None], foot, best)
        facet = int(np.argmin(least))
        return facet, best[facet], float(least[facet])

    def top(self) -> FloatArray:
        """The highest surface point vertically above the centroid of the volume; if there is none, the nearest point to it."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        middle = self.mesh.vertices_mm.mean(axis=0)
        volume = np.einsum("ij,ij->i", a - middle, np.cross(b - middle, c - middle))
        # sum of signed tetrahedra; the centroid of each is the mean of its corners
        centroid = middle + ((a + b + c - 3 * middle) / 4 * volume[:, None]).sum(axis=0) / volume.sum()
        xy = [p[:, :2] - centroid[:2] for p in (a, b, c)]
        # in projection from above, twice the areas opposite each corner, all positive if the triangle is above the centroid
        crossed = [p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((xy[1], xy[2]), (xy[2], xy[0]), (xy[0], xy[1]))]
        area2 = sum(crossed)
        scale = 1e-9 * np.ptp(self.mesh.vertices_mm, axis=0).max() ** 2
        over = (np.stack(crossed) >= -scale).all(axis=0) & (area2 > scale)
        if over.any():
            # barycentric coordinates are those areas over their sum
            height = sum(w[over] * p[over, 2] for w, p in zip(crossed, (a, b, c), strict=True)) / area2[over]
            return np.array([centroid[0], centroid[1], height.max()])
        return np.array([centroid[0], centroid[1], self.mesh.vertices_mm[:, 2].max()])


class MeshChart:
    """Chart of a closed mesh, with the texture's middle and up direction.

    mesh: From `closed_mesh`.
    placement: Its `at_mm` must be on the surface.
    Raises SpecError if a face is given, the point is off the surface, or `up` is parallel to the normal.
    """

    def __init__(self, mesh: Mesh, placement: Placement) -> None:
        if placement.face is not None:
            raise SpecError(f"face = {placement.face}: a mesh has no faces to choose from; give --at X,Y,Z, or a STEP file")
        self.facets = Facets(mesh=mesh)
        size = float(np.ptp(mesh.vertices_mm, axis=0).max())
        wanted = self.facets.top() if placement.at_mm is None else np.array(placement.at_mm, dtype=np.float64)
        refuse_no_point(wanted)
        facet, point, distance = self.facets.nearest(wanted)
        if placement.at_mm is not None:
            refuse_off_surface(wanted, point, distance, size)
        # slightly off the facet's edges, so that a path never starts on one
        point = point + (self.facets.corners[facet].mean(axis=0) - point) * 1e-7
        one = np.array([facet])
        normal = self.facets.smooth_normals(one, self.facets.barycentric(one, point[None]))
        self.centre = Frames(
            points_mm=point[None],
            x_axis=board_x(normal[0], placement.up)[None],
            normal=normal,
            facet=one,
            walked_mm=np.zeros(1),
            arrived=np.ones(1, dtype=bool),
        )

    def frames(self, offset_mm: FloatArray) -> Frames:
        """Places of flat board points; see `Chart.frames`."""
        count = len(offset_mm)
        return self.walk(self.centre[np.zeros(count, dtype=np.int64)], offset_mm)

    def feet(self, frames: Frames, outline_mm: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Heights of the surface over tangent planes; see `Chart.feet`."""
        count, points = len(frames.points_mm), len(outline_mm)
        start = frames[np.repeat(np.arange(count), points)]
        end = self.walk(start, np.tile(outline_mm, (count, 1)))
        # a path of the offset's length s ends before the point below it: on a sphere the height is too small by the fraction
        # (s / R)^2 / 3
        height = np.einsum("ij,ij->i", end.points_mm - start.points_mm, start.normal)
        return height.reshape(count, points), end.arrived.reshape(count, points)

    def walk(self, start: Frames, offset_mm: FloatArray) -> Frames:
        """Trace geodesics from places, by offsets along their board axes; shape (n, 2), mm."""
        length = np.hypot(offset_mm[:, 0], offset_mm[:, 1])
        course = offset_mm / np.where(length > 0, length, 1.0)[:, None]
        way = _Way(self.facets, start, course)
        way.trace_to(length)
        return way.frames()


class _Way:
    """Many paths being traced; each has a constant direction relative to its transported axes."""

    def __init__(self, facets: Facets, start: Frames, course: FloatArray) -> None:
        self.facets = facets
        self.course = course
        self.point = start.points_mm.copy()
        self.x = start.x_axis.copy()
        self.normal = start.normal.copy()
        self.facet = start.facet.copy()
        self.entry = np.full(len(self.point), -1)
        self.walked = np.zeros(len(self.point))
        self.blocked = ~start.arrived

    def frames(self) -> Frames:
        return Frames(
            points_mm=self.point,
            x_axis=self.x,
            normal=self.normal,
            facet=self.facet,
            walked_mm=self.walked,
            arrived=~self.blocked,
        )

    def trace_to(self, length_mm: FloatArray) -> None:
        """Trace each path to `length_mm`, or to the end of the surface."""
        for _ in range(_MOST_STEPS):
            # all paths take a step at the same time, each over at most one facet
            under_way = np.flatnonzero(~self.blocked & (length_mm - self.walked > 1e-9))
            if not len(under_way):
                return
            self._step(under_way, length_mm[under_way] - self.walked[under_way])
        raise SpecError(f"SURFACE takes more than {_MOST_STEPS} steps to cross the texture; give a coarser mesh")

    def _turn(self, who: IntArray, weights: FloatArray) -> None:
        normal = self.facets.smooth_normals(self.facet[who], weights)
        self.x[who] = turned(self.x[who], self.normal[who], normal)
        self.normal[who] = normal

    def _step(self, who: IntArray, left_mm: FloatArray) -> None:
        facets, facet = self.facets, self.facet[who]
        weights = facets.barycentric(facet, self.point[who])
        self._turn(who, weights)
        normal, x = self.normal[who], self.x[who]
        # constant components in transported axes, the discrete form of a geodesic
        course = self.course[who, :1] * x + self.course[who, 1:] * np.cross(normal, x)
        plane = facets.normals[facet]
        lean = np.einsum("ij,ij->i", normal, plane)
        # projected into the facet's plane along the smooth normal, along which the path is then straight; bounded for facets
        # that are nearly parallel to the normal
        along = unit(course - normal * (np.einsum("ij,ij->i", course, plane) / np.maximum(lean, 0.2))[:, None])
        # change of each barycentric coordinate per mm: the edge opposite corner i is reached after weight_i / -rate_i
        rate = np.einsum("ijk,ik->ij", facets.gradients[facet], along)
        leaving = rate < 0
        # on the edge just crossed the coordinate is 0 except for rounding, which might lead back at once
        entered = self.entry[who]
        leaving[entered >= 0, entered[entered >= 0]] = False
        exits = np.where(leaving, np.maximum(weights, 0.0) / np.where(leaving, -rate, 1.0), np.inf)
        corner = exits.argmin(axis=1)
        reach = exits[np.arange(len(who)), corner]
        # large facets are crossed in several steps, as normals also vary inside them
        step = np.minimum(np.minimum(reach, left_mm), _LONGEST_STEP_MM)
        self.point[who] += along * step[:, None]
        self.walked[who] += step
        # infinite for a facet without area, whose gradients are 0
        inside = (reach > step) | (reach == np.inf)
        at_edge, corner = who[~inside], corner[~inside]
        ends = facets.creased[self.facet[at_edge], corner]
        self.blocked[at_edge[ends]] = True
        at_edge, corner = at_edge[~ends], corner[~ends]
        other, entry = facets.neighbours
        old = self.facet[at_edge]
        self.facet[at_edge], self.entry[at_edge] = other[old, corner], entry[old, corner]
        # axes at the end of a path, while `_turn` above gave those at the start of its last step
        arrived = who[left_mm - step <= 1e-9]
        self._turn(arrived, facets.barycentric(self.facet[arrived], self.point[arrived]))


def refuse_no_point(point_mm: FloatArray) -> None:
    """Raise SpecError if a point is not three finite numbers."""
    if point_mm.shape != (3,) or not np.isfinite(point_mm).all():
        raise SpecError(f"at = {','.join(str(v) for v in point_mm)} is no point; give X,Y,Z in mm")


def refuse_off_surface(wanted_mm: FloatArray, nearest_mm: FloatArray, distance_mm: float, size_mm: float) -> None:
    """Raise SpecError if a point is farther from the surface than both 0.05 mm and 1e-4 of the model's size."""
    limit_mm = 0.05 + 1e-4 * size_mm
    if distance_mm > limit_mm:
        at, near = (",".join(f"{v:.4g}" for v in p) for p in (wanted_mm, nearest_mm))
        raise SpecError(
            f"at = {at} lies {distance_mm:.3f} mm from the surface, more than {limit_mm:.3f} mm; "
            f"the nearest point of it is {near}"
        )
