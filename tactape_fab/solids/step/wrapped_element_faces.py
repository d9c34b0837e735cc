"""Exact entities of an element on a cylinder, as templates.

The planes of a block's sides intersect the cylinder in ellipses (in circles and lines if they are perpendicular or parallel to
the axis); the foot of a dome is the intersection of sphere or cone with the cylinder, as a spline within 1e-8 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan, hypot, pi

import numpy as np

from tactape_fab.solids.elements import block_corners_mm, sphere_radius_mm
from tactape_fab.solids.rise import foot_loop_mm
from tactape_fab.solids.step.element_faces import ElementTemplate, ElementText, prism_faces
from tactape_fab.solids.step.part21 import index_of, real, reals
from tactape_fab.solids.wrap import Wrap
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

_SPLINE_DEGREE = 5
_SPLINE_SPANS = (24, 48, 96, 192)
_SPLINE_ERROR_MM = 2e-8
_SAMPLES = 512
_SQUARE = 1e-9


def cylinder_element(tape: Tape, wrap: Wrap, *, flip: bool) -> ElementText:
    """The element of a texture on a cylinder, one copy per placed part."""
    ab = tape.part_xy_mm() @ wrap.from_board.T
    angle = wrap.angle_rad(ab[:, 0])
    place = Place(wrap, angle, ab[:, 1])
    if tape.part.shape == "block":
        return _block(wrap, place, flip=flip)
    return _dome(wrap, place, flip=flip)


class Place:
    """Converts points and directions from a part's frame (tangent, axis, normal) to texts for every copy."""

    def __init__(self, wrap: Wrap, angle_rad: FloatArray, b_mm: FloatArray) -> None:
        self._frames = wrap.frames(angle_rad)
        self._on_axis = wrap.point(angle_rad, b_mm, 0.0)
        self.columns: dict[str, FloatArray] = {}

    def point(self, t: ElementTemplate, local: Sequence[float] | FloatArray) -> str:
        """A point at (tangential, along, distance from the axis)."""
        return t.add(f"CARTESIAN_POINT('',{self._texts(self._on_axis + np.asarray(local) @ self._frames)})")

    def direction(self, t: ElementTemplate, local: Sequence[float] | FloatArray) -> str:
        return t.add(f"DIRECTION('',{self._texts(np.asarray(local, dtype=np.float64) @ self._frames)})")

    def _texts(self, xyz: FloatArray) -> str:
        first = len(self.columns)
        for k in range(3):
            self.columns[f"c{first + k}"] = xyz[:, k]
        return "(" + ",".join(f"<c{first + k}>" for k in range(3)) + ")"


def _block(wrap: Wrap, place: Place, *, flip: bool) -> ElementText:
    part, r = wrap.part, wrap.radius_mm
    corners = block_corners_mm(part)
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    t = ElementTemplate(flip=flip)
    up = place.direction(t, (0.0, 0.0, 1.0))
    directions = [place.direction(t, (*d, 0.0)) for d in along]
    vectors = [t.add(f"VECTOR('',{d},1.)") for d in directions]
    up_vector = t.add(f"VECTOR('',{up},1.)")
    # (tangential, along, distance from the axis): the surface is the circle t^2 + u^2 = R^2 in every cross-section
    foot_points = [place.point(t, (x, y, np.sqrt(r**2 - x**2))) for x, y in corners]
    top_points = [place.point(t, (x, y, r + part.body_mm[2])) for x, y in corners]
    foot, top = [t.vertex(p) for p in foot_points], [t.vertex(p) for p in top_points]
    foot_edges = []
    for k in range(4):
        # a side has the direction (c, s) in the tangent plane; its vertical plane intersects the cylinder in an ellipse with the
        # semi-axes R (vertical) and R / |c| (along the side)
        c, s = along[k]
        if abs(c) < _SQUARE:
            curve = t.add(f"LINE('',{foot_points[k]},{vectors[k]})")
        else:
            # the ellipse's centre is where the side's line crosses t = 0, as its plane meets the axis there
            centre = place.point(t, (0.0, corners[k, 1] - corners[k, 0] * s / c, 0.0))
            # the outward normal of side k is direction k - 1; an ellipse from corner k to k + 1 has an inward axis
            axes = t.axes(centre, directions[(k + 1) % 4], directions[(k + 2) % 4])
            curve = t.add(
                f"CIRCLE('',{axes},{real(r)})" if abs(s) < _SQUARE else f"ELLIPSE('',{axes},{real(r / abs(c))},{real(r)})"
            )
        foot_edges.append(t.edge(foot[k], foot[(k + 1) % 4], curve))
    top_edges = [t.line_edge(top[k], top[(k + 1) % 4], top_points[k], vectors[k]) for k in range(4)]
    rise = [t.line_edge(foot[k], top[k], foot_points[k], up_vector) for k in range(4)]
    sides = [t.add(f"PLANE('',{t.axes(top_points[k], directions[k - 1], up)})") for k in range(4)]
    cap = t.add(f"PLANE('',{t.axes(top_points[0], up, directions[0])})")
    bound, faces = prism_faces(t, foot_edges, top_edges, rise, sides, cap)
    return ElementText(template=t, bound=bound, faces=faces, columns={k: reals(v) for k, v in place.columns.items()})


def _dome(wrap: Wrap, place: Place, *, flip: bool) -> ElementText:
    part, r = wrap.part, wrap.radius_mm
    foot_mm, height_mm = part.body_mm[0] / 2, part.body_mm[2]
    t = ElementTemplate(flip=flip)
    up, down = place.direction(t, (0.0, 0.0, 1.0)), place.direction(t, (0.0, 0.0, -1.0))
    east, north = place.direction(t, (1.0, 0.0, 0.0)), place.direction(t, (0.0, 1.0, 0.0))
    # a clamped spline starts at its first control point, at direction 0 on the tangent, where the cone's seam is
    controls, knots, multiplicities = closed_spline(foot_loop_mm(part, r, _SAMPLES))
    names = [place.point(t, point) for point in controls]
    start = t.vertex(names[0])
    # degree, controls, form, closed, not self-intersecting, multiplicities, knots, form of the knots
    spline = t.add(
        f"B_SPLINE_CURVE_WITH_KNOTS('',{_SPLINE_DEGREE},({','.join(names)}),.UNSPECIFIED.,.T.,.F.,"
        f"({','.join(map(str, multiplicities))}),({','.join(map(real, knots))}),.UNSPECIFIED.)"
    )
    foot = t.edge(start, start, spline)
    bound = index_of(t.bound([(foot, False)]))
    if part.top_mm is None:
        sphere_mm = sphere_radius_mm(part)
        centre = t.axes(place.point(t, (0.0, 0.0, r + height_mm - sphere_mm)), north, down)
        # the sphere's poles are along the cylinder and its seam is below, so that the cap contains neither
        faces: tuple[int, ...] = (t.face([(foot, True)], t.add(f"SPHERICAL_SURFACE('',{centre},{real(sphere_mm)})")),)
    else:
        top_mm = part.top_mm / 2
        rim = place.point(t, (top_mm, 0.0, r + height_mm))
        top_vertex = t.vertex(rim)
        middle = place.point(t, (0.0, 0.0, r + height_mm))
        axes = t.axes(middle, up, east)
        top = t.edge(top_vertex, top_vertex, t.add(f"CIRCLE('',{axes},{real(top_mm)})"))
        slant = np.array([top_mm - foot_mm, 0.0, height_mm]) / hypot(top_mm - foot_mm, height_mm)
        seam = t.line_edge(start, top_vertex, names[0], t.add(f"VECTOR('',{place.direction(t, slant)},1.)"))
        angle = real(atan((foot_mm - top_mm) / height_mm))
        cone = t.add(f"CONICAL_SURFACE('',{t.axes(middle, down, east)},{real(top_mm)},{angle})")
        side = t.face([(foot, True), (seam, True), (top, False), (seam, False)], cone)
        faces = (side, t.face([(top, True)], t.add(f"PLANE('',{axes})")))
    return ElementText(template=t, bound=bound, faces=faces, columns={k: reals(v) for k, v in place.columns.items()})


def closed_spline(samples: FloatArray) -> tuple[FloatArray, list[float], list[int]]:
    """A clamped B-spline of degree 5 through a smooth closed curve, with two continuous derivatives where it closes.

    It has the fewest spans with an error below 0.02 nm at their middles, but at most 192, with which the error may be slightly
    larger on the smallest cylinders.

    samples (m, 3): Of the curve at equal steps of its period.
    Returns controls (spans + 5, 3).
    Returns knots.
    Returns multiplicities.
    """
    # degree 5: twice the spans leave a 64th of the error
    for spans in _SPLINE_SPANS:
        controls, error_mm = _interpolated(samples, spans)
        if error_mm < _SPLINE_ERROR_MM:
            break
    multiplicities = [_SPLINE_DEGREE + 1, *[1] * (spans - 1), _SPLINE_DEGREE + 1]
    return controls, [float(k) for k in range(spans + 1)], multiplicities


def _interpolated(samples: FloatArray, spans: int) -> tuple[FloatArray, float]:
    """Control points for a number of spans, and the largest distance from the curve in the middles of the spans."""
    p = _SPLINE_DEGREE
    # clamped, so spans + p functions, and as many conditions: spans + 1 places, and two derivatives at both ends
    knots = np.concatenate([np.zeros(p), np.arange(spans + 1), np.full(p, spans)]).astype(np.float64)
    steps, ends = np.arange(spans + 1, dtype=np.float64), np.array([0.0, float(spans)])
    rows = [_basis(knots, steps, 0), _basis(knots, ends, 1), _basis(knots, ends, 2)]
    values = [_on_curve(samples, places, spans, order) for places, order in ((steps, 0), (ends, 1), (ends, 2))]
    controls: FloatArray = np.linalg.solve(np.vstack(rows), np.vstack(values))
    # exactly equal ends, without rounding, as they are one vertex
    controls[-1] = controls[0]
    middles = steps[:-1] + 0.5
    # the error of an interpolating spline is largest near the middles between its knots
    off = _basis(knots, middles, 0) @ controls - _on_curve(samples, middles, spans, 0)
    return controls, float(np.linalg.norm(off, axis=1).max())


def _on_curve(samples: FloatArray, places: FloatArray, period: float, derivative: int) -> FloatArray:
    """A closed curve through samples at equal steps, or a derivative of it, by its Fourier series; shape (places, 3)."""
    wave = np.fft.rfft(samples, axis=0)
    order = np.arange(len(wave))
    # removes rounding noise, which each derivative would multiply by the order, up to 256
    wave[np.abs(wave).max(axis=1) < 1e-15 * np.abs(wave).max()] = 0.0
    rate = 2j * pi / period
    phase = np.exp(rate * np.outer(places, order))
    # real signal: negative orders double all but the mean (and the highest order, which is negligible for a smooth curve)
    weight = np.where(order == 0, 1.0, 2.0) * (rate * order) ** derivative
    return np.asarray(np.real(phase @ (weight[:, None] * wave)) / len(samples))


def _basis(knots: FloatArray, places: FloatArray, derivative: int, degree: int = _SPLINE_DEGREE) -> FloatArray:
    """B-spline basis functions, or a derivative of them, at places; shape (places, functions) (de Boor)."""
    count = len(knots) - degree - 1
    if derivative:
        lower = _basis(knots, places, derivative - 1, degree - 1)
        i = np.arange(count)
        with np.errstate(divide="ignore", invalid="ignore"):
            a = np.where(knots[i + degree] > knots[i], degree / (knots[i + degree] - knots[i]), 0.0)
            b = np.where(knots[i + degree + 1] > knots[i + 1], degree / (knots[i + degree + 1] - knots[i + 1]), 0.0)
        # N'_i,p = p N_i,p-1 / (u_i+p - u_i) - p N_i+1,p-1 / (u_i+p+1 - u_i+1); terms over an empty span count as 0
        return a * lower[:, :-1] - b * lower[:, 1:]
    if degree == 0:
        inside = (knots[:-1] <= places[:, None]) & (places[:, None] < knots[1:])
        # spans are half-open, except the last, at whose end all functions would be 0 otherwise
        last = int(np.flatnonzero(knots[:-1] < knots[1:])[-1])
        inside[places == knots[-1], last] = True
        return inside.astype(np.float64)
    lower = _basis(knots, places, 0, degree - 1)
    i = np.arange(count)
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.where(knots[i + degree] > knots[i], (places[:, None] - knots[i]) / (knots[i + degree] - knots[i]), 0.0)
        down_span = knots[i + degree + 1] - knots[i + 1]
        down = np.where(down_span > 0, (knots[i + degree + 1] - places[:, None]) / down_span, 0.0)
    # N_i,p = (u - u_i) N_i,p-1 / (u_i+p - u_i) + (u_i+p+1 - u) N_i+1,p-1 / (u_i+p+1 - u_i+1)
    return up * lower[:, :-1] + down * lower[:, 1:]
